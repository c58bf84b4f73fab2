"""One draw: parameters from the prior, their streams, what is measured of them, and the noise of the data."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from streamkit import Array, BoolArray, Data, Model, OutOfDomain, Spec, Stream, StreamkitError
from streamkit.model import Observation
from streamkit.observe import join_data, new_data
from streamkit.runfile import ModelInputs
from streamkit.sample import Evaluation

PURPOSE = 11  # in the seed of a draw: no other study of the same run file has its random numbers
PARTICLE = ("x", "y", "z", "vx", "vy", "vz", "weight")  # columns of a particle


class Simulator:
    """The draws of a run file by their number. `Workers` hold one; its pickle only has the spec.

    Random numbers of the particles differ between draws. Where there is no stream, a draw has its parameters and the
    reason.

    Parameters
    ----------
    spec
        The run file.
    noise
        Whether the noise of the data is added to what is measured.
    particles
        Whether a draw has the particles too.
    """

    def __init__(self, spec: Spec, noise: bool = True, particles: bool = False) -> None:
        self.spec, self.noise, self.particles = spec, noise, particles
        self.model = Model(spec, fresh=True)
        data = [one.data for one in self.model.measured(spec.bind_all())]
        self.data = join_data(data) if data else Data(np.empty(0), np.empty(0))

    def __reduce__(self) -> tuple[Any, ...]:
        return Simulator, (self.spec, self.noise, self.particles)

    @cached_property
    def measured(self) -> BoolArray:
        """(all,) Which numbers of a prediction have a datum: the others are not simulated."""
        return np.asarray(np.isfinite(self.data.values))

    def parameters(self, index: int) -> Array:
        """(d,) Return the parameters of a draw."""
        return self._drawn(index)[0]

    def evaluate(self, point: Array) -> Evaluation:
        """Make the draw whose number is ``point`` (1,).

        ``mean`` (m,) are the numbers that are measured, ``details`` the same with noise, then the particles of each
        stream, row by row. NaN and a ``reason`` where there is no stream or nothing to measure.
        """
        theta, rng = self._drawn(int(point[0]))
        try:
            bound = self.spec.bind_all(theta)
            observation = self.model.observe_all(bound)
        except OutOfDomain as error:
            return self.rejected(error.reason)
        prediction = observation.prediction
        if prediction.why_not:
            return self.rejected(prediction.why_not)
        mean = prediction.mean[self.measured]
        noisy = self._noisy(bound, observation, rng)[self.measured] if self.noise else mean
        particles = [as_rows(stream).ravel() for stream in observation.streams.values()] if self.particles else []
        return Evaluation(
            0.0, 0.0, mean, prediction.variance[self.measured], details=np.concatenate([noisy, *particles])
        )

    def rejected(self, reason: str) -> Evaluation:
        """Return a draw without a stream."""
        nothing = np.full(self.measured.sum(), np.nan)
        return Evaluation(-np.inf, -np.inf, nothing, nothing, reason)

    def first(self, tries: int = 1000) -> tuple[int, Observation]:
        """Return the number of the first draw with a measured stream, and its observation.

        Raises StreamkitError if none of the first ``tries`` has one: with the commonest reason.
        """
        reasons: dict[str, int] = {}
        for index in range(tries):
            try:
                observation = self.model.observe_all(self.spec.bind_all(self.parameters(index)))
                reason = observation.prediction.why_not
            except OutOfDomain as error:
                reason = error.reason
            else:
                if not reason:
                    return index, observation
            reasons[reason] = reasons.get(reason, 0) + 1
        worst = max(reasons, key=lambda each: reasons[each])
        raise StreamkitError(
            f"{self.spec.source}: none of {tries} draws of the priors has a stream that can be measured; most often: "
            f"{worst} ({reasons[worst]} draws)"
        )

    def _drawn(self, index: int) -> tuple[Array, np.random.Generator]:
        rng = np.random.default_rng([self.spec.seed, PURPOSE, index])
        shares = rng.random(len(self.spec.priors)).tolist()
        # one by one: a quantile of an array may differ in its last bit
        values = [float(prior.ppf(np.array(u))) for prior, u in zip(self.spec.priors, shares, strict=True)]
        return np.array(values), rng

    def _noisy(self, bound: ModelInputs, observation: Observation, rng: np.random.Generator) -> Array:
        """(all,) Return new data about the predictions. The particles' own noise is in these already."""
        drawn = [np.empty(0)]
        for one in self.model.measured(bound):
            data = replace(one.data, add_noise=False)
            values = new_data(one.measurement, observation.prediction_of(one), data, rng)
            if values is None:
                where = ".".join(filter(None, (one.stream, one.name)))
                raise StreamkitError(
                    f"{self.spec.source}: {where}: {one.measurement.kind} has a likelihood of its own and makes no "
                    "mock data, so its noise is not known; --no-noise leaves it out"
                )
            drawn.append(values)
        return np.concatenate(drawn)


def as_rows(stream: Stream) -> Array:
    """(n, 7) Return the particles today: places in kpc, velocities in km/s, and weights, 0 for bound ones."""
    return np.column_stack([stream.q.T, stream.v.T, np.where(stream.bound, 0.0, stream.weight)])
