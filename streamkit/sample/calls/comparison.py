"""The comparison of many predictions with the data at once: the observables' own likelihoods, exactly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from streamkit.components import Measurement
from streamkit.model import Measured, Model, Observation
from streamkit.observe import read_data
from streamkit.stream import Array, BoolArray, IntArray, Prediction


@dataclass(frozen=True)
class Part:
    """One observable, or data of the host, among all."""

    measured: Measured  # at the centre of the priors
    rows: slice  # where its data are among all
    reads: tuple[str, ...]  # the details that its likelihood reads
    free: dict[str, int]  # the parameters that are fields of it, by field


class Comparison:
    """The ln likelihood of predictions of a model's observables that are given, at many points at once."""

    def __init__(self, model: Model) -> None:
        self._model, self._spec = model, model.spec
        spec = model.spec
        self._parts: list[Part] = []
        self._shapes: list[tuple[int, ...]] = []
        # The measurements that cannot be compared at many points: those with a likelihood of their own that do not
        # declare what it reads, and those whose data depend on a parameter.
        self.undeclared: list[str] = []
        self._likelihood_only = np.zeros(len(spec.names), dtype=bool)
        for measured in model.measured(spec.bind_all()):
            streams, data = spec.sections.streams, spec.sections.data
            sections = streams[measured.stream].observables if measured.stream else data
            self._add(measured, sections[measured.name])

    def _add(self, measured: Measured, section: Any) -> None:
        """Add one measurement, and its section of the run file, behind those before it."""
        measurement = measured.measurement
        has_likelihood = type(measurement).ln_likelihood is not Measurement.ln_likelihood
        if (has_likelihood and measurement.likelihood_details is None) or self._is_bent(section):
            self.undeclared.append(f"{measurement.role} {measurement.kind}")
        reads = tuple(measurement.likelihood_details or ()) if has_likelihood else ()
        index = {name: i for i, name in enumerate(self._spec.names)}
        free = {field: index[f"{section.path}.{field}"] for field in section.priors}
        for field in set(measurement.likelihood_fields()) & free.keys():
            self._likelihood_only[free[field]] = True
        start = self._parts[-1].rows.stop if self._parts else 0
        rows = slice(start, start + len(measured.data.values))
        self._parts.append(Part(measured, rows, reads, free))

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
    def knows_shapes(self) -> bool:
        """Whether the shapes of the details are known: `details` or `read_shapes` has been called."""
        return bool(self._shapes) or not any(part.reads for part in self._parts)

    @property
    def details_size(self) -> int:
        """How many details a prediction has, as far as shapes are known."""
        return sum(int(np.prod(shape)) for shape in self._shapes)

    def read_shapes(self, theta: Array) -> None:
        """Make the streams at theta (d,), where there is a prediction, and note the shapes of their details."""
        self.details(self._model.observe_all(self._spec.bind_all(theta)))

    @property
    def coordinates(self) -> BoolArray:
        """(d,) Whether predictions depend on a parameter: the others enter the likelihood alone."""
        return ~self._likelihood_only

    def details(self, observation: Observation) -> Array:
        """(k,) Return the details that the likelihoods read. The first observation decides their shapes."""
        details = [(observation.prediction_of(part.measured).details, part.reads) for part in self._parts]
        arrays = [np.asarray(each[name]) for each, reads in details for name in reads]
        self._shapes = self._shapes or [array.shape for array in arrays]
        return np.concatenate([np.empty(0), *(array.ravel() for array in arrays)])

    def _places(self) -> Iterator[tuple[Part, dict[str, tuple[slice, tuple[int, ...]]]]]:
        """Yield each part, and where its details are among all and their shapes, by name."""
        start, shapes = 0, iter(self._shapes)
        for part in self._parts:
            places = {}
            for name in part.reads:
                shape = next(shapes)
                places[name] = slice(start, start := start + int(np.prod(shape))), shape
            yield part, places

    def details_of_rows(self, rows: IntArray) -> IntArray:
        """Return which details are left with some of the data: those of these data, and those of no datum."""
        every, left = np.arange(self.details_size), [np.empty(0, dtype=int)]
        for part, places in self._places():
            own = rows[(rows >= part.rows.start) & (rows < part.rows.stop)] - part.rows.start
            for where, shape in places.values():
                index, is_of_data = every[where].reshape(shape), shape[:1] == (part.rows.stop - part.rows.start,)
                left.append((index[own] if is_of_data else index).ravel())
        return np.concatenate(left)

    def ln_likelihood(self, points: Array, mean: Array, variance: Array, details: Array) -> Array:
        """(n,) Return ln likelihood at points (n, d) for predictions (n, m), their variances and details (n, k).

        The variances are added to those of the data, whatever the run file says of the model's own noise.
        """
        total = np.zeros(len(points))
        for part, places in self._places():
            arrays = {name: details[:, where].reshape(len(points), *shape) for name, (where, shape) in places.items()}
            names = tuple(str(i) for i in range(len(part.measured.data.values)))
            prediction = Prediction(names, mean[:, part.rows], variance[:, part.rows], details=arrays)
            total += _compare(part, points, prediction)
        return total


def _compare(part: Part, points: Array, prediction: Prediction) -> Array:
    """(n,) Return the ln likelihood of one measurement."""
    measurement, data = part.measured.measurement, part.measured.data
    if part.free:
        measurement = measurement.model_copy(update={name: points[:, [i]] for name, i in part.free.items()})
    value = measurement.ln_likelihood(prediction, True)
    return data.gaussian_of_many(prediction.mean, prediction.variance) if value is None else np.asarray(value)
