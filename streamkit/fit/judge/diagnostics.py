"""Diagnostics of a fit: predictions against data, and posterior against prior."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from astropy.table import Column, QTable
from numpy.typing import NDArray

from streamkit.components import Measurement
from streamkit.fit.samples.results import Results
from streamkit.fit.samples.tables import intervals, printable
from streamkit.observe import scatter_of
from streamkit.runfile import Prior
from streamkit.sample import Posterior
from streamkit.stream import Array, Data

MOST = 2000  # samples that a prediction is compared with the data for
COMPARED = 5  # samples whose ln likelihood is compared with that of a Gaussian
SIGMA = "standard deviations of the likelihood: the error, an extra dispersion, the debris about a single star"
EDGE = 0.02  # the outermost fraction of a prior, at either end, that counts as its edge


def prior_fractions(prior: Prior, values: Array) -> Array:
    """(n,) Fraction of the prior below each value: uniform on [0, 1] if the posterior is the prior."""
    u = np.linspace(1e-6, 1 - 1e-6, 20001)
    return np.asarray(np.interp(values, prior.ppf(u), u))


def contraction(fractions: Array) -> float:
    """Return the posterior's spread over the prior's, both in fractions of the prior: 1 if the data say nothing."""
    return float(np.sqrt(12) * fractions.std())


@dataclass(frozen=True)
class Predictive:
    """The data and what the posterior predicts for them."""

    # (m,) of the data that are there.
    names: tuple[str, ...]
    data: Array
    errors: Array
    # (n, m) predictions of the samples, and the variance of each estimate.
    mean: Array
    variance: Array
    add_noise: bool = False  # whether the likelihood adds that variance to the errors
    gaussian: bool = True  # whether the likelihood is the Gaussian of these data, and no observable has one of its own
    # (m,) standard deviations of the data about the best sample's predictions; None: their errors.
    scatter: Array | None = None

    @property
    def sigma(self) -> Array:
        """(m,) The unit of deviations."""
        return self.errors if self.scatter is None else self.scatter

    @property
    def total(self) -> Array:
        """(n, m) Variances that the likelihood compares with, correlations left aside."""
        return self.errors**2 + (self.variance if self.add_noise else np.zeros_like(self.variance))

    @property
    def deviations(self) -> Array:
        """(m,) Datum minus median prediction, in `sigma`."""
        return np.asarray((self.data - np.median(self.mean, axis=0)) / self.sigma)

    @property
    def noise(self) -> Array:
        """(m,) The model's own noise over `sigma`, median over the samples."""
        return np.asarray(np.sqrt(np.median(self.variance, axis=0)) / self.sigma)


def predicted_intervals(results: Results, stream: str) -> dict[str, Array]:
    """Return the 95 % and 68 % intervals (2, m) of what the model predicts of one stream; none if it was not kept."""
    kept = _predictions(results)
    if kept is None or stream not in (best := results.best_observation.predictions):
        return {}
    start = sum(len(best[name].names) for name in list(best)[: list(best).index(stream)])
    mean = kept["mean"][:, start : start + len(best[stream].names)]
    finite = mean[np.isfinite(mean).all(axis=1)]
    if not len(finite):
        return {}
    return {name: np.percentile(finite, ends, axis=0) for name, ends in (("95 %", (2.5, 97.5)), ("68 %", (16, 84)))}


def _predictions(results: Results) -> NDArray[Any] | None:
    """(n,) What was predicted at some of the samples, mean and variance; None if the run kept no predictions."""
    if results.draws.predictions is None:
        return None
    kept = results.draws.predictions.ravel()
    return np.asarray(kept[np.linspace(0, len(kept) - 1, min(len(kept), MOST)).astype(int)])


def predictive(results: Results) -> Predictive | None:
    """Return data and predictions of a run; None if the run kept no predictions."""
    kept = _predictions(results)
    if kept is None:
        return None
    data = Posterior(results.spec).data
    used = np.isfinite(data.values)
    kept = kept[np.isfinite(kept["mean"][:, used]).all(axis=1) & np.isfinite(kept["variance"][:, used]).all(axis=1)]
    if not len(kept):
        return None
    some = kept[:COMPARED]
    expected = [data.gaussian(row["mean"], row["variance"]) for row in some]
    names, scatter = _at_best(results, data)
    return Predictive(
        tuple(name for name, there in zip(names, used, strict=True) if there),
        data.values[used],
        data.errors[used],
        kept["mean"][:, used],
        kept["variance"][:, used],
        data.add_noise,
        bool(np.allclose(some["ln_likelihood"], expected, rtol=1e-6)),
        scatter[used],
    )


def predictions_table(seen: Predictive | None) -> QTable:
    """Return one row per datum: its error, and median and intervals of what the samples predict; none without any.

    Data have different units, so the numbers stand in plain columns: those of the run file's data.
    """
    if seen is None:
        return QTable({"datum": Column([], dtype=str)})
    levels = intervals(seen.mean)
    table = QTable({"datum": list(seen.names), "value": seen.data, "error": seen.errors, "median": levels.pop("")})
    for name, column in levels.items():
        table[name] = column
    table["deviation"] = Column(seen.deviations, description=f"datum minus median prediction, in {SIGMA}")
    table["noise"] = Column(seen.noise, description=f"the model's own noise over {SIGMA}")
    return printable(table)


def _at_best(results: Results, data: Data) -> tuple[tuple[str, ...], Array]:
    """(m,) The names of all data, and their standard deviations about the best sample's predictions."""
    if results.unmeasured:
        return tuple(f"datum {i + 1}" for i in range(len(data.values))), data.errors
    best = results.best_observation
    bound = results.spec.bind_all(results.best())
    measured: dict[str, list[Measurement]] = {
        name: list(inputs.observables.values()) for name, inputs in bound.streams.items()
    }
    measured |= {f"data.{name}": [datum] for name, datum in bound.data.items()}
    scatter = [scatter_of(measured[name], prediction) for name, prediction in best.predictions.items()]
    return best.prediction.names, np.concatenate(scatter)
