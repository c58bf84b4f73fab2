"""The results of a run: its samples, and what they say about the parameters and the mass profile."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from streamkit.errors import ChainError
from streamkit.model import Host
from streamkit.sample import (
    Chain,
    Posterior,
    autocorrelation_times,
    burn_in,
    effective_samples,
    learning_steps,
    split_r_hat,
    stuck_walkers,
)
from streamkit.spec import Spec, load
from streamkit.stream import Array, IntArray, Prediction, Stream
from streamkit.study.fit.directory import RUN_FILE, manifest, read_chain
from streamkit.study.fit.tables import LEVELS

if TYPE_CHECKING:
    from astropy.table import QTable
    from emcee.backends import Backend

MAX_MODELS = 5000
"""Samples that a mass profile is computed for."""
TRUSTED = 50.0
"""Autocorrelation times that a chain must span before its percentiles are called converged."""


class Results:
    """A finished, interrupted or running run.

    Parameters
    ----------
    directory
        The run's output directory.

    Attributes
    ----------
    spec
        The run.
    chain, log_prob
        (steps, walkers, d) samples and (steps, walkers) ln posterior, burn-in included.
    discard
        Steps of burn-in that `samples` leaves out.
    acceptance
        Fraction of the proposals that were accepted, those of the steps of learning left out.
    calls, search_calls
        Evaluations of the posterior while sampling, and while looking for a start.
    reasons
        Rejected proposals of the sampler by reason.
    status
        Why the sampling ended: "converged", "steps", "time", or "unfinished".
    quick
        Whether it is a coarse look.

    Raises
    ------
    ChainError
        If there is no readable run in the directory.
    """

    def __init__(self, directory: str | Path) -> None:
        where = Path(directory)
        if not where.is_dir():
            raise ChainError(f"{where}: there is no such directory")
        options = manifest(where).get("options", {})
        found = read_chain(where)
        counts = found.attributes.get("counts", {})
        quick = bool(options.get("quick", False))
        status = str(found.attributes.get("status", "unfinished"))
        self._fill(load(where / RUN_FILE), found, counts, status, quick)
        self.directory: Path | None = where

    @classmethod
    def in_memory(cls, spec: Spec, backend: Backend, counts: dict[str, Any], status: str, quick: bool) -> Results:
        """Return the results of a run that was kept in memory."""
        if backend.iteration == 0:
            raise ChainError("the run ended before its first step: there are no samples")
        found = Chain(backend.get_chain(), backend.get_log_prob(), backend.get_blobs(), backend.accepted, {})
        self = cls.__new__(cls)
        self._fill(spec, found, counts, status, quick)
        self.directory = None
        return self

    def _fill(self, spec: Spec, found: Chain, counts: dict[str, Any], status: str, quick: bool) -> None:
        self.spec = spec
        self.chain, self.log_prob, self.blobs = found.chain, found.log_prob, found.blobs
        self.calls, self.search_calls = int(counts.get("calls", 0)), int(counts.get("search_calls", 0))
        self.reasons: dict[str, int] = counts.get("reasons", {})
        self.status, self.quick = status, quick
        if len(self.chain) and self.chain.shape[2] != len(spec.names):
            raise ChainError(
                f"the chain has {self.chain.shape[2]} parameters and the run file {len(spec.names)} free ones: "
                "they belong to different runs"
            )
        if not len(self.chain):
            raise ChainError("the run ended before its first step: there are no samples")
        moved = np.diff(self.chain[self.learned :], axis=0).any(axis=2)
        self.acceptance = float(moved.mean() if moved.size else np.mean(found.accepted) / len(self.chain))

    @property
    def names(self) -> tuple[str, ...]:
        """The free parameters."""
        return self.spec.names

    @cached_property
    def discard(self) -> int:
        """Steps left out: those of learning, then three times the longest autocorrelation time, at most half."""
        return len(self.chain) // 2 if self.quick else self.learned + burn_in(self.chain[self.learned :])

    @property
    def learned(self) -> int:
        """Steps at the beginning in which the moves still learned, at most half of the chain."""
        return min(learning_steps(self.spec.sampler.moves), len(self.chain) // 2)

    @property
    def kept(self) -> Array:
        """(steps, walkers, d) The chain after burn-in."""
        return self.chain[self.discard :]

    @property
    def samples(self) -> Array:
        """(n, d) Samples after burn-in."""
        return self.kept.reshape(-1, self.chain.shape[2])

    @cached_property
    def tau(self) -> Array:
        """(d,) Autocorrelation times in steps, of the chain after learning; NaN where there is no estimate."""
        return autocorrelation_times(self.chain[self.learned :])

    @cached_property
    def ess(self) -> Array:
        """(d,) Effective number of independent samples after burn-in."""
        return effective_samples(self.kept, self.tau)

    @cached_property
    def r_hat(self) -> Array:
        """(d,) Split R-hat after burn-in, over the halves of all walkers."""
        return split_r_hat(self.kept)

    @cached_property
    def stranded(self) -> IntArray:
        """(n,) Numbers of the walkers that are stuck far below the others."""
        return stuck_walkers(self.chain, self.log_prob)

    @property
    def span(self) -> float:
        """Length of the chain, after learning, in units of its longest autocorrelation time."""
        return float((len(self.chain) - self.learned) / np.max(self.tau))

    def best(self) -> dict[str, float]:
        """Return the parameters of the highest ln posterior."""
        step, walker = np.unravel_index(np.argmax(self.log_prob), self.log_prob.shape)
        return dict(zip(self.names, self.chain[step, walker].tolist(), strict=True))

    @cached_property
    def best_stream(self) -> tuple[Stream, Prediction]:
        """The stream at the best sample, and what the observable says of it. Raises OutOfDomain if there is none."""
        return Posterior(self.spec).predict(np.array(list(self.best().values())))

    @property
    def converged(self) -> bool:
        """Whether the chain spans enough autocorrelation times for its percentiles to be trusted."""
        return not self.quick and bool(self.span >= TRUSTED)

    def note(self) -> str:
        """Say in one sentence how far the percentiles can be trusted."""
        steps = len(self.chain)
        if self.quick:
            return f"QUICK LOOK, {steps} steps: few particles, not converged, not for science."
        if not np.isfinite(self.span):
            return f"Not converged: {steps} steps are too few to estimate the autocorrelation time."
        length = f"{steps} steps are {self.span:.0f} autocorrelation times"
        if not self.converged:
            return f"Not converged: {length}, and {TRUSTED:.0f} are wanted."
        return f"{length[0].upper()}{length[1:]}."

    def summary(self) -> QTable:
        """Return one row per parameter.

        Columns: name, unit, median, 68 % and 95 % intervals, the best sample, autocorrelation time, effective
        samples, split R-hat. Parameters have different units, so the numbers stand in a plain column beside
        the column ``unit``.
        """
        from astropy.table import QTable

        table = QTable()
        table["parameter"] = list(self.names)
        table["unit"] = [unit.replace(" ", "") or "1" for unit in self.spec.units]
        values = np.percentile(self.samples, list(LEVELS.values()), axis=0)
        by_level = dict(zip(LEVELS, values, strict=True))
        for level in ("median", "lo68", "hi68", "lo95", "hi95"):
            table[level] = by_level[level]
        table["best"] = list(self.best().values())
        table["autocorrelation_time"] = self.tau
        table["effective_samples"] = self.ess
        table["split_r_hat"] = self.r_hat
        table.meta.update(self._meta())
        return table

    def mass_profile(self, radii: Any) -> QTable:
        """Return the mass inside radii (kpc, or a Quantity), and the circular velocity there.

        Median with 68 % and 95 % intervals, today, for the sum of all potentials of the host; from at most
        5000 of the samples, evenly spaced.
        """
        from astropy import units as u
        from astropy.table import QTable

        r = np.atleast_1d(u.Quantity(radii, u.kpc).value).astype(float)
        mass, v_c = self.profiles(r)
        table = QTable()
        table["r"] = r * u.kpc
        for name, values, unit in (("M", mass, u.Msun), ("v_c", v_c, u.km / u.s)):
            levels = dict(zip(LEVELS, np.percentile(values, list(LEVELS.values()), axis=0), strict=True))
            for level in ("median", "lo68", "hi68", "lo95", "hi95"):
                table[name if level == "median" else f"{name}_{level}"] = levels[level] * unit
        table.meta.update(self._meta() | {"samples used": len(mass)})
        return table

    def profiles(self, radii: Array) -> tuple[Array, Array]:
        """Return M (n, nr) in Msun and v_c (n, nr) in km/s of at most 5000 samples at radii (nr,) in kpc."""
        samples = self.samples
        if len(samples) > MAX_MODELS:
            samples = samples[np.linspace(0, len(samples) - 1, MAX_MODELS).astype(int)]
        distinct, where = np.unique(samples, axis=0, return_inverse=True)
        hosts = [Host(self.spec.bind(theta).potentials) for theta in distinct]
        mass = np.reshape([host.mass_inside(radii) for host in hosts], (-1, len(radii)))
        v_c = np.reshape([host.circular_velocity(radii) for host in hosts], (-1, len(radii)))
        return mass[where.ravel()], v_c[where.ravel()]

    def diagnostics(self) -> QTable:
        """Return the sampler's calls, the rejected ones by reason, and how many walkers are stranded."""
        from astropy.table import QTable

        rejected = sorted(self.reasons.items(), key=lambda item: -item[1])
        rows = [("evaluated proposals", self.calls, self.calls)]
        rows += [(f"rejected: {reason}", n, self.calls) for reason, n in rejected]
        rows += [("stranded walkers", len(self.stranded), self.chain.shape[1])]
        table = QTable()
        table["what"] = [name for name, _, _ in rows]
        table["count"] = [count for _, count, _ in rows]
        table["fraction"] = [count / whole if whole else np.nan for _, count, whole in rows]
        table.meta.update(self._meta())
        return table

    def _meta(self) -> dict[str, Any]:
        steps, walkers, _ = self.chain.shape
        return {
            "note": self.note(),
            "quick": self.quick,
            "status": self.status,
            "steps": steps,
            "walkers": walkers,
            "burn-in": self.discard,
            "acceptance": round(self.acceptance, 4),
            "calls": self.calls,
            "calls of the search": self.search_calls,
            "digest": self.spec.digest(),
        }
