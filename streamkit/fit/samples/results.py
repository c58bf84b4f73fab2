"""The results of a run: its samples, and tables of the parameters and the mass profile."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from streamkit.components import DO_NOT, FINE, ChainSampler, Component, LiveStripping, Verdict
from streamkit.errors import ChainError, OutOfDomain, nearest
from streamkit.fit.directory.integrity import judged_spec, load_spec, read_stored
from streamkit.fit.directory.manifest import manifest
from streamkit.fit.judge.goodness import Goodness, Sampled, goodness
from streamkit.fit.judge.predictive import Predictive
from streamkit.fit.judge.verdicts import overall, verdicts
from streamkit.fit.samples.chain import ChainDraws
from streamkit.fit.samples.conversion import arviz_tree, replicates, sample_columns
from streamkit.fit.samples.draws import Draws
from streamkit.fit.samples.left_out import left_out_table
from streamkit.fit.samples.members import members_table
from streamkit.fit.samples.predictions import predictive
from streamkit.fit.samples.tables import (
    goodness_table,
    intervals,
    predictions_table,
    printable,
    radii_in_kpc,
    stream_table,
)
from streamkit.fit.samples.weighted import WeightedDraws
from streamkit.model import Host, Observation
from streamkit.runfile import Prior, Spec
from streamkit.sample import Chain, Posterior, Weighted
from streamkit.stream import Array, IntArray, Prediction, Stream

if TYPE_CHECKING:
    import pandas as pd
    from xarray import DataTree

MAX_MODELS = 5000  # largest number of samples for a mass profile


class Results:
    """A finished, interrupted or running run: `streamkit.load_results` reads one, `streamkit.run` returns one.

    Attributes
    ----------
    spec, directory
        The run and its directory; None for a run in memory.
    draws
        The samples, which describe and judge themselves.
    names
        The free parameters.
    chain, log_prob
        (steps, walkers, d) samples and (steps, walkers) ln posterior, burn-in included. Weighted samples have the form
        of a chain with one walker: samples of equal weight, as many as the effective number, drawn with the run's seed.
    discard
        Number of steps left out: the steps of learning, then three times the longest autocorrelation time, at most
        half.
    kept, samples
        (steps, walkers, d) the chain after burn-in, and (n, d) the same without regard to walkers.
    tau, ess
        (d,) Autocorrelation times in steps of the chain after learning, NaN without an estimate; and effective numbers
        of independent samples after burn-in.
    r_hat
        (d,) Rank-normalised split R-hat after burn-in, each walker a chain; NaN for weighted samples.
    stuck
        (n,) Numbers of the walkers that are stuck far below the others.
    acceptance
        Fraction of the proposals that were accepted, those of the steps of learning left out.
    calls, search_calls
        Evaluations of the posterior while sampling, and while looking for a start.
    reasons
        Rejected proposals of the sampler by reason.
    facts
        Short texts of the sampler by name, such as the number of points that its surrogate has learned from.
    status
        Why the sampling ended: "converged", "steps", "time", "few" (effective samples), or "unfinished".
    quick
        Whether it is a coarse look.
    weighted
        The weighted samples of a sampler that yields such, with the evidence; None for a chain.
    failed
        Pictures that could not be drawn, with the reason.
    """

    def __init__(self, spec: Spec, draws: Draws, directory: Path | None = None) -> None:
        self.names, d = spec.names, draws.chain.shape[2]
        if d != len(self.names):
            raise ChainError(
                f"the chain has {d} parameters and the run file {len(self.names)} free ones: "
                "they belong to different runs"
            )
        self.spec, self.draws, self.directory = spec, draws, directory
        self.chain, self.log_prob, self.blobs = draws.chain, draws.log_prob, draws.blobs
        self.discard, self.kept, self.samples = draws.discard, draws.kept, draws.kept.reshape(-1, d)
        self.tau, self.ess, self.r_hat, self.stuck = draws.tau, draws.ess, draws.r_hat, draws.stuck
        self.calls, self.search_calls, self.reasons = draws.calls, draws.search_calls, draws.reasons
        self.facts, self.status, self.quick = draws.facts, draws.status, draws.quick
        self.weighted, self.acceptance = draws.weighted, draws.acceptance
        self.failed: dict[str, str] = {}
        self._profiles: dict[float, tuple[Array, Array]] = {}

    def __repr__(self) -> str:
        number = self.draws.headline.partition(",")[0]
        return f"<Results: {number}, {len(self.names)} parameters, {self.verdict}>"

    def _repr_html_(self) -> str:
        return f"<p>{escape(self.note())}</p>{self.summary()._repr_html_()}"

    def __getitem__(self, name: str) -> Array:
        """(n,) Samples after burn-in of the parameter with this name, such as ``results["potential.v0"]``."""
        path = self.spec.path_of(name)
        if path not in self.names:
            names = ", ".join(self.names)
            raise KeyError(f"no free parameter is called {name!r}.{nearest(name, self.names)} Known: {names}")
        return self.samples[:, self.names.index(path)]

    def some(self, most: int) -> Array:
        """(n, d) At most so many of the samples after burn-in, evenly spaced."""
        n = len(self.samples)
        return np.asarray(self.samples[np.linspace(0, n - 1, min(n, most)).astype(int)])

    def to_pandas(self) -> pd.DataFrame:
        """Return the samples after burn-in as a pandas DataFrame: walker, step, the parameters, ln posterior."""
        import pandas as pd  # slow to load

        return pd.DataFrame(sample_columns(self.spec, self.draws))

    def to_arviz(self) -> DataTree:
        """Return the samples after burn-in as ArviZ reads them: an xarray DataTree, each walker a chain.

        Groups: ``posterior`` (the parameters, with units), ``sample_stats`` (``lp``, ln posterior, and ln likelihood),
        ``predictions`` (mean and variance of each datum), ``constant_data`` (value and error of each datum);
        ``observed_data`` and ``posterior_predictive`` (new data of at most 500 samples) by measured quantity, and
        ``log_likelihood`` (of each datum at these samples): ``plot_ppc_dist`` and ``loo`` read them. For ArviZ before
        1.0, whose ``plot_ppc`` and ``loo`` do, ``arviz.InferenceData.from_datatree`` takes the tree.
        """
        sampled = self._sampled()
        drawn = None if sampled is None else replicates(sampled)
        tree = arviz_tree(self.spec, self.draws, Posterior(self.spec).data, drawn)
        tree.attrs.update({"note": self.note(), "verdict": self.verdict, "converged": int(self.converged)})
        return tree

    def best(self) -> dict[str, float]:
        """Return the parameters of the highest ln posterior."""
        return dict(zip(self.names, self.draws.best.tolist(), strict=True))

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
        """Whether the percentiles can be trusted: the rule of the sampler is met, and no check says "do not use"."""
        return not self.quick and not self.draws.lacks and self.verdict != DO_NOT

    def note(self) -> str:
        """Return whether the percentiles are reliable, and what is missing: the verdict of all checks."""
        own, (level, sentence) = self.draws.note(), overall(self.verdicts)
        return own if level == FINE or self.quick else f"{sentence} {own}"

    def summary(self) -> QTable:
        """Return one row per parameter.

        Columns: name, median, 68 % interval, unit, best sample, autocorrelation time, effective samples,
        rank-normalised R-hat, 95 % interval.
        """
        levels = intervals(self.samples)
        # A narrow terminal leaves out columns in the middle: with this order it still shows medians and intervals.
        table = QTable({"parameter": list(self.names), "median": levels[""], "lo68": levels["lo68"]})
        table["hi68"] = levels["hi68"]
        table["unit"] = [unit or "1" for unit in self.spec.units]
        table["best"] = list(self.best().values())
        table["autocorrelation_time"], table["effective_samples"], table["r_hat"] = self.tau, self.ess, self.r_hat
        table["lo95"], table["hi95"] = levels["lo95"], levels["hi95"]
        return self.with_provenance(printable(table))

    @cached_property
    def fit(self) -> Goodness | None:
        """The goodness of fit; None if nothing can be judged, or the best sample has no predictions."""
        sampled = self._sampled()
        return None if sampled is None else goodness(sampled)

    @cached_property
    def unmeasured(self) -> str:
        """The reason why the stream at the best sample has no predictions; "" where it has them.

        At an emulated sample there may be no measurable stream. At the edge of measurable streams the rounding of
        another machine may decide.
        """
        try:
            predictions = self.best_observation.predictions
        except OutOfDomain as error:
            return str(error)
        return next((each.why_not for each in predictions.values() if each.why_not), "")

    @cached_property
    def predictive(self) -> Predictive | None:
        """The data and the predictions of the posterior for them; None if the run stored no predictions."""
        return predictive(self.spec, self.draws, None if self.unmeasured else self.best_observation)

    @property
    def emulated(self) -> bool:
        """Whether the predictions of the samples are those of an emulator, and not of calls."""
        return bool(self.spec.sampler.emulates)

    @property
    def uncertified(self) -> bool:
        """Whether an emulator's predictions have not passed its own test."""
        return self.emulated and bool(self.draws.lacks)

    @property
    def noisy(self) -> Predictive | None:
        """The predictions, where their noise is judged: an emulator averages the noise of its calls."""
        return None if self.emulated else self.predictive

    @property
    def priors(self) -> tuple[Prior, ...]:
        """(d,) The priors of the free parameters."""
        return tuple(self.spec.priors)

    @property
    def bound_shares(self) -> dict[str, float]:
        """The share of its mass that is bound today, of each live progenitor of the best sample by its stream."""
        sections = self.spec.sections.streams.items()
        live = {name for name, each in sections if isinstance(each.stripping.centre, LiveStripping)}
        streams = {} if self.unmeasured or not live else self.best_observation.streams
        return {name: stream.bound_share for name, stream in streams.items() if name in live}

    @property
    def own_verdicts(self) -> list[Verdict]:
        """The outcomes of the checks that belong to the sampler."""
        return self.draws.verdicts()

    @cached_property
    def verdicts(self) -> list[Verdict]:
        """The outcome of every check that the run allows, in the order of the page."""
        return verdicts(self)

    @property
    def verdict(self) -> str:
        """The worst outcome of all checks: "fine", "look here" or "do not use"."""
        return overall(self.verdicts)[0]

    def _sampled(self) -> Sampled | None:
        """Return the samples with their predictions; None if the best sample has none."""
        if self.unmeasured:
            return None
        blobs = None if self.draws.predictions is None else self.draws.predictions.ravel()
        return Sampled(self.spec, self.best(), self.best_observation.predictions, self.samples, blobs)

    def goodness(self) -> QTable:
        """Return one row per measured quantity and one for all data: how well the model fits the data.

        Columns: quantity, number of data, chi^2 at the best sample, its posterior predictive p-value, the worst datum,
        its residual (data minus model, in standard deviations of the likelihood), and the probability of such a
        residual.
        """
        return self.with_provenance(goodness_table(self.fit))

    def members(self) -> QTable:
        """Return one row per star of the observable `stars`: how likely it is a member of its stream.

        Columns: stream, ra, dec, phi1 and what is compared; p_member, the mean over at most 100 samples, with its
        scatter p_member_sd; and p_cocoon, the part of it that is of the cocoon. No rows without such stars.
        """
        return self.with_provenance(self._members)

    @cached_property
    def _members(self) -> QTable:
        return members_table(self._sampled())

    def streams(self) -> QTable:
        """Return one row per stream of several, and one for the data of the host: how well the model fits its data.

        Columns: stream, those of `goodness`, and what the sampler says of the stream, such as its calls.
        """
        return self.with_provenance(stream_table(self.fit, self.facts))

    def left_out(self) -> QTable:
        """Return what several streams say of the host without each of them in turn; the first row is the fit to all.

        Columns: the stream that is left out; M20 and M50, the masses inside 20 and 50 kpc with 68 % intervals; for each
        parameter that streams share, the change of its mean in standard deviations of the fit to all, in coordinates in
        which its prior is Gaussian; p, the chance of a change as large if the stream agrees with the others; the same
        for the number of streams; ln of the density of its data, given all others; and why there are no numbers. From
        at most 2000 samples and their predictions.
        """
        return self.with_provenance(self._left_out)

    @cached_property
    def _left_out(self) -> QTable:
        return left_out_table(self._sampled())

    def predictions(self) -> QTable:
        """Return one row per datum: its error, and median and intervals of the predictions of the samples."""
        return self.with_provenance(predictions_table(self.predictive))

    def mass_profile(self, radii: Any) -> QTable:
        """Return the mass inside radii (kpc, or a Quantity), and the circular velocity there.

        Median with 68 % and 95 % intervals, today, for the sum of all potentials of the host; from at most
        5000 of the samples, evenly spaced. Raises ValueError for radii that are not positive.
        """
        r = radii_in_kpc(radii)
        mass, v_c = self.profiles(r)
        table = QTable({"r": r * u.kpc})
        for name, values, unit in (("M", mass, u.Msun), ("v_c", v_c, u.km / u.s)):
            for level, column in intervals(values).items():
                table[f"{name}_{level}".rstrip("_")] = column * unit
        return self.with_provenance(printable(table), {"samples used": len(mass)})

    def diagnostics(self) -> QTable:
        """Return the sampler's calls, the rejected ones by reason, and how many walkers are stuck."""
        rows = [("evaluated proposals", self.calls, self.calls)]
        rows += [(f"rejected: {reason}", n, self.calls) for reason, n in Counter(self.reasons).most_common()]
        if self.weighted is None:  # weighted samples have no walkers that could be stuck
            rows.append(("stuck walkers", len(self.stuck), self.chain.shape[1]))
        table = QTable(
            rows=[(what, n, n / whole if whole else np.nan) for what, n, whole in rows],
            names=("what", "count", "fraction"),
        )
        return self.with_provenance(printable(table))

    def profiles(self, radii: Array) -> tuple[Array, Array]:
        """Return M (n, nr) in Msun and v_c (n, nr) in km/s of at most 5000 samples at radii (nr,) in kpc.

        Each radius is cached. A call goes through all samples, so give many radii in one call.
        """
        new = np.array([r for r in np.unique(radii) if r not in self._profiles])
        if len(new):
            mass, v_c = self._make_profiles(new)
            self._profiles |= {r: (mass[:, i], v_c[:, i]) for i, r in enumerate(new.tolist())}
        columns = [self._profiles[r] for r in radii.tolist()]
        return np.stack([m for m, _ in columns], axis=1), np.stack([v for _, v in columns], axis=1)

    @cached_property
    def _hosts(self) -> tuple[list[Host], IntArray]:
        """The hosts of at most 5000 samples without repetitions, and the number of each sample's host."""
        distinct, where = np.unique(self.some(MAX_MODELS), axis=0, return_inverse=True)
        return [Host(self.spec.host(theta)) for theta in distinct], where.ravel()

    def _make_profiles(self, radii: Array) -> tuple[Array, Array]:
        hosts, where = self._hosts
        mass = np.reshape([host.mass_inside(radii) for host in hosts], (-1, len(radii)))
        v_c = np.reshape([host.circular_velocity(radii) for host in hosts], (-1, len(radii)))
        return mass[where], v_c[where]

    def with_provenance(self, table: QTable, more: dict[str, Any] | None = None) -> QTable:
        """Return a table with notes of its origin and its reliability."""
        about = {"note": self.note(), "quick": self.quick, "digest": self.spec.digest()}
        table.meta.update(about | self.draws.provenance() | (more or {}))
        return table


def draws_of(stored: Chain | Weighted, spec: Spec, quick: bool) -> Draws:
    """Return the stored samples of a run as a chain or as weighted samples, by their sampler."""
    if isinstance(stored, Weighted):
        return WeightedDraws(stored, spec.sampler.kind, spec.seed, quick, spec.sampler.emulates)
    if not isinstance(spec.sampler, ChainSampler):
        raise ChainError(f"there is a chain, and the sampler {spec.sampler.kind!r} of the run file makes none")
    return ChainDraws(stored, spec.sampler, spec.names, quick)


def load_results(directory: str | Path, components: Iterable[type[Component]] = (), trust: bool = False) -> Results:
    """Return the results of the run in a directory, which may have ended, been interrupted, or be active.

    Parameters
    ----------
    directory
        The run's output directory.
    components
        The component classes that were given in Python to the run.
    trust
        Whether the plugin files in the directory may be run.

    Raises ChainError if there is no readable run in the directory, or it has plugin files that are not trusted.
    """
    where = Path(directory)
    notes = manifest(where)
    spec = load_spec(where, components, trust)
    stored = read_stored(where, spec)
    quick = notes["options"]["quick"] or bool(stored.attributes.get("quick"))
    return Results(spec, draws_of(stored, judged_spec(where, spec), quick), where)
