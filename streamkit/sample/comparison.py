"""The comparison of many predictions with the data at once: the observables' own likelihoods, exactly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from streamkit.components import Measurement
from streamkit.model import Observation
from streamkit.observe import Data, parts_of, read_data
from streamkit.sample.posterior import Posterior
from streamkit.stream import Array, BoolArray, Prediction


@dataclass(frozen=True)
class Part:
    """One observable, or data of the host, among all.

    Attributes
    ----------
    measurement
        At the centre of the priors.
    data
        What it is compared with.
    rows, reads
        Where its data are among all, and where the details that its likelihood reads are among all of those.
    shapes
        The shapes of these details, by name.
    free
        The parameters that are fields of it, by field.
    """

    measurement: Measurement
    data: Data
    rows: slice
    reads: slice
    shapes: dict[str, tuple[int, ...]]
    free: dict[str, int]


class Comparison:
    """The ln likelihood of predictions that are given, at many points at once.

    Parameters
    ----------
    posterior
        Whose observables are meant.
    observation
        What was observed at any one point: it gives the shapes of the details.

    Attributes
    ----------
    undeclared
        The measurements that cannot be compared at many points: those with a likelihood of their own that do not
        declare what it reads, and those whose data depend on a parameter.
    """

    def __init__(self, posterior: Posterior, observation: Observation) -> None:
        self._spec, self._model = posterior.spec, posterior.model
        self.size = posterior.size
        self._parts: list[Part] = []
        self.undeclared: list[str] = []
        self.details_size = 0
        self._likelihood_only = np.zeros(len(self._spec.names), dtype=bool)
        start = 0
        for section, prediction, data in self._sections(observation):
            start += self._add(section, prediction, data, start)

    def _sections(self, observation: Observation) -> list[tuple[Any, Prediction, Data]]:
        """Return section, prediction and data of every measurement, in the order of the joint prediction."""
        bound, sections_of = self._spec.bind_all(), self._spec.sections
        sections: list[tuple[Any, Prediction, Data]] = []
        for name, inputs in bound.streams.items():
            predictions, data = parts_of(observation.predictions[name]), self._model.data(inputs)
            sections += [(s, predictions[key], data[key]) for key, s in sections_of.streams[name].observables.items()]
        for name, section in sections_of.data.items():
            prediction = observation.predictions[f"data.{name}"]
            sections.append((section, prediction, self._model.known("data", name, bound.data[name])))
        return sections

    def _add(self, section: Any, prediction: Prediction, data: Data, start: int) -> int:
        """Add one measurement whose data begin at ``start``; return how many they are."""
        measurement, m = section.centre, len(data.values)
        own = type(measurement).ln_likelihood is not Measurement.ln_likelihood
        if (own and measurement.likelihood_details is None) or self._is_bent(section):
            self.undeclared.append(f"{measurement.role} {measurement.kind}")
        names = (measurement.likelihood_details or ()) if own else ()
        shapes = {name: np.shape(prediction.details[name]) for name in names}
        size = sum(int(np.prod(shape)) for shape in shapes.values())
        index = {name: i for i, name in enumerate(self._spec.names)}
        free = {field: index[f"{section.path}.{field}"] for field in section.priors}
        for field in set(measurement.likelihood_fields()) & free.keys():
            self._likelihood_only[free[field]] = True
        reads = slice(self.details_size, self.details_size + size)
        self._parts.append(Part(measurement, data, slice(start, start + m), reads, shapes, free))
        self.details_size += size
        return m

    def _is_bent(self, section: Any) -> bool:
        """Say whether the data of a measurement depend on a parameter, or numbers in a list of its fields are free."""
        if not section.priors:
            return False
        if any("." in field for field in section.priors):
            return True
        names, priors = self._spec.names, self._spec.priors
        low, high = (
            read_data(section.build({n: float(p.ppf(np.array(u))) for n, p in zip(names, priors, strict=True)}))
            for u in (0.25, 0.75)
        )
        same = [np.array_equal(getattr(low, n), getattr(high, n), equal_nan=True) for n in ("values", "errors")]
        if low.covariance is not None and high.covariance is not None:
            same.append(np.array_equal(low.covariance, high.covariance, equal_nan=True))
        return not all(same)

    @property
    def coordinates(self) -> BoolArray:
        """(d,) Whether predictions depend on a parameter: the others enter the likelihood alone."""
        return ~self._likelihood_only

    def details(self, observation: Observation) -> Array:
        """(k,) Return the details that the likelihoods read."""
        found = [prediction for _, prediction, _ in self._sections(observation)]
        arrays = [
            np.ravel(prediction.details[name])
            for part, prediction in zip(self._parts, found, strict=True)
            for name in part.shapes
        ]
        return np.concatenate([np.empty(0), *arrays])

    def ln_likelihood(self, points: Array, mean: Array, variance: Array, details: Array) -> Array:
        """(n,) Return ln likelihood at points (n, d) for predictions (n, m), their variances and details (n, k).

        The variances are added to those of the data, whatever the run file says of the model's own noise.
        """
        return np.asarray(sum(self._compare(part, points, mean, variance, details) for part in self._parts))

    def _compare(self, part: Part, points: Array, mean: Array, variance: Array, details: Array) -> Array:
        names, measurement = tuple(str(i) for i in range(part.rows.stop - part.rows.start)), part.measurement
        read, start = details[:, part.reads], 0
        arrays = {}
        for name, shape in part.shapes.items():
            stop = start + int(np.prod(shape))
            arrays[name], start = read[:, start:stop].reshape(len(points), *shape), stop
        if part.free:
            measurement = measurement.model_copy(update={name: points[:, [i]] for name, i in part.free.items()})
        prediction = Prediction(names, mean[:, part.rows], variance[:, part.rows], details=arrays)
        own = measurement.ln_likelihood(prediction, True)
        return gaussians(prediction.mean, prediction.variance, part.data) if own is None else np.asarray(own)


def gaussians(mean: Array, variance: Array, data: Data) -> Array:
    """(n,) Return the ln likelihood of Gaussian errors for predictions (n, m), their variances (n, m) added."""
    used = np.isfinite(data.values)
    away, noise = data.values[used] - mean[:, used], variance[:, used]
    if data.covariance is None:
        total = data.errors[used] ** 2 + noise
        return np.asarray(-0.5 * np.sum(away**2 / total + np.log(2 * np.pi * total), axis=1))
    covariance = data.covariance[np.ix_(used, used)]
    if not noise.any():
        root = cholesky(covariance, lower=True)
        white = solve_triangular(root, away.T, lower=True)
        spread = np.log(np.diag(root)).sum()
        return np.asarray(-0.5 * (white**2).sum(axis=0) - spread - 0.5 * len(root) * np.log(2 * np.pi))
    roots = np.linalg.cholesky(covariance + noise[:, :, None] * np.eye(used.sum()))
    white = np.linalg.solve(roots, away[:, :, None])[:, :, 0]
    spread = np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
    return np.asarray(-0.5 * (white**2).sum(axis=1) - spread - 0.5 * used.sum() * np.log(2 * np.pi))
