"""The results of a run: its samples, and what they say about the parameters and the mass profile."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from streamkit.components import Component
from streamkit.errors import ChainError, nearest
from streamkit.model import Host, Observation
from streamkit.runfile import Spec
from streamkit.sample import (
    Chain,
    Convergence,
    Posterior,
    Stopping,
    Weighted,
    effective_samples,
    learning_steps,
    rank_r_hat,
    stuck_walkers,
)
from streamkit.stream import Array, IntArray, Prediction, Stream
from streamkit.study.fit.conversion import arviz_tree, sample_frame
from streamkit.study.fit.integrity import load_spec, read_chain, read_samples
from streamkit.study.fit.manifest import manifest
from streamkit.study.fit.tables import diagnostics_table, profile_table, summary_table

if TYPE_CHECKING:
    import pandas as pd
    from astropy.table import QTable
    from emcee.backends import Backend
    from xarray import DataTree

MAX_MODELS = 5000  # samples that a mass profile is computed for


class Results:
    """A finished, interrupted or running run.

    Parameters
    ----------
    directory
        The run's output directory.
    components
        The component classes that were given in Python to the run.
    trust
        Whether the plugin files in the directory may be run.

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
    surrogate
        What the surrogate of the moves was learned of: "the observables", "ln likelihood" where these do not explain
        it, or "none" where nothing could be learned; empty where none was asked for, or not yet learned.
    status
        Why the sampling ended: "converged", "steps", "time", "few" (effective samples), or "unfinished".
    quick
        Whether it is a coarse look.
    directory
        Where it is, or None for one in memory.
    weighted
        The weighted samples of a sampler that gives such, with the evidence; None for a chain. `chain` then holds as
        many samples of equal weight as they are worth, drawn with the seed of the run, as one walker.
    failed
        Pictures that could not be drawn, with the reason.

    Raises ChainError if there is no readable run in the directory, or it has plugin files that nobody trusts.
    """

    def __init__(self, directory: str | Path, components: Iterable[type[Component]] = (), trust: bool = False) -> None:
        where = Path(directory)
        if not where.is_dir():
            raise ChainError(f"{where}: there is no such directory")
        options = manifest(where).get("options", {})
        weighted = read_samples(where)
        found = _as_chain(weighted, int(manifest(where).get("seed", 0))) if weighted is not None else read_chain(where)
        counts = found.attributes.get("counts", {})
        quick = bool(options.get("quick", False))
        status = str(found.attributes.get("status", "unfinished"))
        spec = load_spec(where, components, trust)
        self._fill(spec, found, counts, status, quick, weighted)
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

    @classmethod
    def of_weighted(cls, spec: Spec, found: Weighted, quick: bool) -> Results:
        """Return the results of a run with weighted samples that was kept in memory."""
        self = cls.__new__(cls)
        notes = found.attributes
        self._fill(spec, _as_chain(found, spec.seed), notes["counts"], notes["status"], quick, found)
        self.directory = None
        return self

    def _fill(
        self,
        spec: Spec,
        found: Chain,
        counts: dict[str, Any],
        status: str,
        quick: bool,
        weighted: Weighted | None = None,
    ) -> None:
        self.spec, self.weighted = spec, weighted
        self.chain, self.log_prob, self.blobs = found.chain, found.log_prob, found.blobs
        self.calls, self.search_calls = int(counts.get("calls", 0)), int(counts.get("search_calls", 0))
        self.reasons: dict[str, int] = counts.get("reasons", {})
        self.surrogate = str(counts.get("surrogate", ""))
        self.status, self.quick = status, quick
        self.failed: dict[str, str] = {}
        self._profiles: dict[float, tuple[Array, Array]] = {}
        if not len(self.chain):
            raise ChainError("the run ended before its first step: there are no samples")
        if self.chain.shape[2] != len(spec.names):
            raise ChainError(
                f"the chain has {self.chain.shape[2]} parameters and the run file {len(spec.names)} free ones: "
                "they belong to different runs"
            )
        self.convergence: Convergence | Stopping
        if weighted is not None:
            self.convergence, self.acceptance = Stopping(weighted), float(weighted.ess / max(self.calls, 1))
            return
        sampler: Any = spec.sampler
        learning = learning_steps(sampler.moves, self.chain)
        self.convergence = Convergence(self.chain, learning, sampler.tau_factor, sampler.r_hat)
        moved = np.diff(self.chain[self.convergence.learned :], axis=0).any(axis=2)
        self.acceptance = float(moved.mean() if moved.size else np.mean(found.accepted) / len(self.chain))

    @property
    def names(self) -> tuple[str, ...]:
        """The free parameters."""
        return self.spec.names

    def __repr__(self) -> str:
        steps, walkers, d = self.chain.shape
        if self.weighted is not None:
            return f"<Results: {len(self.weighted.points)} weighted samples, {d} parameters, {self.note()}>"
        trust = "converged" if self.converged else "not converged"
        return f"<Results: {steps} steps of {walkers} walkers, {d} parameters, {trust}>"

    def _repr_html_(self) -> str:
        return f"<p>{escape(self.note())}</p>{self.summary()._repr_html_()}"

    @property
    def discard(self) -> int:
        """Steps left out: those of learning, then three times the longest autocorrelation time, at most half."""
        return len(self.chain) // 2 if self.quick and self.weighted is None else self.convergence.discard

    @property
    def kept(self) -> Array:
        """(steps, walkers, d) The chain after burn-in."""
        return self.chain[self.discard :]

    @property
    def samples(self) -> Array:
        """(n, d) Samples after burn-in."""
        return self.kept.reshape(-1, self.chain.shape[2])

    @property
    def tau(self) -> Array:
        """(d,) Autocorrelation times in steps, of the chain after learning; NaN where there is no estimate."""
        return self.convergence.tau

    @property
    def ess(self) -> Array:
        """(d,) Effective number of independent samples after burn-in."""
        if self.weighted is not None:
            return np.full(len(self.names), self.weighted.ess)
        return effective_samples(self.kept, self.tau)

    @cached_property
    def r_hat(self) -> Array:
        """(d,) Rank-normalised split R-hat after burn-in, each walker a chain."""
        return rank_r_hat(self.kept) if self.quick and self.weighted is None else self.convergence.r_hat

    @cached_property
    def stuck(self) -> IntArray:
        """(n,) Numbers of the walkers that are stuck far below the others."""
        return stuck_walkers(self.chain, self.log_prob) if self.weighted is None else np.empty(0, dtype=np.int64)

    def __getitem__(self, name: str) -> Array:
        """(n,) Samples after burn-in of the parameter with this name, such as ``results["potential.v0"]``."""
        if name not in self.names:
            known = ", ".join(self.names)
            raise KeyError(f"no free parameter is called {name!r}.{nearest(name, self.names)} Known: {known}")
        return self.samples[:, self.names.index(name)]

    def to_pandas(self) -> pd.DataFrame:
        """Return the samples after burn-in as a pandas DataFrame: walker, step, the parameters, ln posterior.

        Raises StreamkitError without pandas: it comes with ``streamkit[export]``.
        """
        return sample_frame(self.names, self.kept, self.log_prob, self.discard)

    def to_arviz(self) -> DataTree:
        """Return the samples after burn-in as ArviZ wants them: an xarray DataTree, each walker a chain.

        Groups: ``posterior`` (the parameters, with units), ``sample_stats`` (``lp``, ln posterior, and ln likelihood),
        ``predictions`` (mean and variance for each datum) and ``observed_data``. For ArviZ before 1.0,
        ``arviz.InferenceData.from_datatree`` takes it.

        Raises StreamkitError without arviz-base: it comes with ``streamkit[export]``.
        """
        attributes: dict[str, str | int | float] = {
            "created_by": f"streamkit {version('streamkit')}",
            "digest": self.spec.digest(),
            "note": self.note(),
            "converged": int(self.converged),
            "burn_in": self.discard,
        }
        blobs = None if self.blobs is None else self.blobs[self.discard :]
        kept, log_prob = self.kept, self.log_prob[self.discard :]
        data = Posterior(self.spec).data
        return arviz_tree(self.names, self.spec.units, kept, log_prob, blobs, data, attributes)

    def best(self) -> dict[str, float]:
        """Return the parameters of the highest ln posterior."""
        if self.weighted is not None:
            return dict(zip(self.names, self.weighted.points[np.argmax(self.weighted.log_prob)].tolist(), strict=True))
        step, walker = np.unravel_index(np.argmax(self.log_prob), self.log_prob.shape)
        return dict(zip(self.names, self.chain[step, walker].tolist(), strict=True))

    @cached_property
    def best_observation(self) -> Observation:
        """All streams at the best sample, and what is predicted of them. Raises OutOfDomain if there are none."""
        return Posterior(self.spec).observe(np.array(list(self.best().values())))

    @property
    def best_stream(self) -> tuple[Stream, Prediction]:
        """The only stream at the best sample, and what its observables say. Raises OutOfDomain if there is none."""
        name, best = self.spec.stream_name(), self.best_observation
        return best.streams[name], best.predictions[name]

    @property
    def converged(self) -> bool:
        """Whether the percentiles can be trusted: `streamkit.sample.Convergence`, as the run file sets it."""
        return not self.quick and bool(self.convergence)

    def note(self) -> str:
        """Say in one sentence how far the percentiles can be trusted, and what is missing."""
        steps = len(self.chain)
        if self.weighted is not None:
            return self._weighted_note(self.weighted)
        if self.quick:
            return f"QUICK LOOK, {steps} steps: few particles, not converged, not for science."
        if missing := self.convergence.missing(self.names):
            return f"Not converged: {missing}."
        span, r_hat = self.convergence.span, self.r_hat.max()
        return f"{steps} steps are {span:.0f} autocorrelation times, and R-hat is {r_hat:.3f} at most."

    def _weighted_note(self, found: Weighted) -> str:
        if self.quick:
            return f"QUICK LOOK, {self.calls} calls: few particles, not converged, not for science."
        if missing := self.convergence.missing(self.names):
            return f"Not converged: {missing}."
        met = f"The rule of {self.spec.sampler.kind} is met"
        return f"{met}, with {found.ess:.0f} effective samples; {evidence_text(found)}."

    def summary(self) -> QTable:
        """Return one row per parameter.

        Columns: name, median, 68 % interval, unit, best sample, autocorrelation time, effective samples,
        rank-normalised R-hat, 95 % interval.
        """
        judged = {
            "best": np.array(list(self.best().values())),
            "autocorrelation_time": self.tau,
            "effective_samples": self.ess,
            "r_hat": self.r_hat,
        }
        return self.with_provenance(summary_table(self.names, self.spec.units, self.samples, judged))

    def mass_profile(self, radii: Any) -> QTable:
        """Return the mass inside radii (kpc, or a Quantity), and the circular velocity there.

        Median with 68 % and 95 % intervals, today, for the sum of all potentials of the host; from at most
        5000 of the samples, evenly spaced.
        """
        from astropy import units as u

        r = np.atleast_1d(u.Quantity(radii, u.kpc).value).astype(float)
        mass, v_c = self.profiles(r)
        return self.with_provenance(profile_table(r, mass, v_c), {"samples used": len(mass)})

    def diagnostics(self) -> QTable:
        """Return the sampler's calls, the rejected ones by reason, and how many walkers are stuck."""
        walkers = self.chain.shape[1] if self.weighted is None else 0
        return self.with_provenance(diagnostics_table(self.calls, self.reasons, len(self.stuck), walkers))

    def profiles(self, radii: Array) -> tuple[Array, Array]:
        """Return M (n, nr) in Msun and v_c (n, nr) in km/s of at most 5000 samples at radii (nr,) in kpc.

        Kept for every radius, since each call goes through all samples: ask for many radii at once.
        """
        new = np.array([r for r in np.unique(radii) if r not in self._profiles])
        if len(new):
            mass, v_c = self._make_profiles(new)
            self._profiles |= {r: (mass[:, i], v_c[:, i]) for i, r in enumerate(new.tolist())}
        columns = [self._profiles[r] for r in radii.tolist()]
        return np.stack([m for m, _ in columns], axis=1), np.stack([v for _, v in columns], axis=1)

    def _make_profiles(self, radii: Array) -> tuple[Array, Array]:
        samples = self.samples
        if len(samples) > MAX_MODELS:
            samples = samples[np.linspace(0, len(samples) - 1, MAX_MODELS).astype(int)]
        distinct, where = np.unique(samples, axis=0, return_inverse=True)
        hosts = [Host(self.spec.bind_all(theta).potentials) for theta in distinct]
        mass = np.reshape([host.mass_inside(radii) for host in hosts], (-1, len(radii)))
        v_c = np.reshape([host.circular_velocity(radii) for host in hosts], (-1, len(radii)))
        return mass[where.ravel()], v_c[where.ravel()]

    def with_provenance(self, table: QTable, more: dict[str, Any] | None = None) -> QTable:
        """Say in a table what it comes from, and how far it can be trusted."""
        steps, walkers, _ = self.chain.shape
        table.meta.update(
            {
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
            | ({} if self.weighted is None else _told(self.weighted))
            | (more or {})
        )
        return table


def evidence_text(found: Weighted) -> str:
    """Return "ln evidence -12.3 +- 0.1"."""
    if not np.isfinite(found.ln_evidence):
        return "no evidence"
    return f"ln evidence {found.ln_evidence:.2f} +- {found.ln_evidence_error:.2f}"


def _told(found: Weighted) -> dict[str, Any]:
    """Return what a table of weighted samples says of them."""
    return {
        "samples": f"{len(found.points)} weighted ones, here as {round(found.ess)} of equal weight",
        "ln evidence": found.ln_evidence,
        "error of ln evidence": found.ln_evidence_error,
    }


def _as_chain(found: Weighted, seed: int) -> Chain:
    """Return samples of equal weight in the form of a chain of one walker."""
    chosen = found.drawn(seed)
    blobs = found.blobs[chosen][:, None]
    notes = found.attributes
    return Chain(found.points[chosen][:, None], found.log_prob[chosen][:, None], blobs, np.ones(1), notes)


def load_results(directory: str | Path, components: Iterable[type[Component]] = (), trust: bool = False) -> Results:
    """Return the results of the run in a directory, which may have ended, been interrupted, or be going on.

    Its arguments are those of `Results`. Raises ChainError if there is no readable run in the directory.
    """
    return Results(directory, components, trust)
