"""What a sampler that emulates predictions asks of its target: factors, calls of several of them, comparisons."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from typing import TypeVar

import numpy as np

from streamkit.components import TargetFactor
from streamkit.errors import ComponentError
from streamkit.sample.calls.comparison import Comparison
from streamkit.sample.calls.forks import in_forks
from streamkit.sample.calls.signals import Stopped
from streamkit.sample.calls.workers import Workers
from streamkit.sample.progress import SamplingProgress
from streamkit.sample.store.storage import Storage
from streamkit.stream import Array, BoolArray

T = TypeVar("T")

PART = 256  # points sent to the workers at a time


class Emulating:
    """The part of `PosteriorTarget` for samplers that emulate predictions."""

    storage: Storage
    display: SamplingProgress
    factors: tuple[TargetFactor, ...]
    _calls: Workers
    _comparison: Comparison | None
    _which: tuple[str, str]

    def call_factors(self, points: Mapping[str, Array]) -> None:
        """Call several factors by name at points (n, p), from one queue: their `predictions` then cost nothing."""
        targets = {each.name: each.target for each in self.factors if isinstance(each.target, Emulating)}
        queue = [(targets[name], point) for name, some in points.items() for point in targets[name]._missing(some)]
        for begin in range(0, len(queue), PART):
            part = queue[begin : begin + PART]
            batches = [(target._which[0], np.array([point for _, point in some]))
                       for target, some in groupby(part, key=_target)]  # fmt: skip
            for (target, point), evaluation in zip(part, self._calls.each_of(batches), strict=True):
                target.storage.evaluations.add(point, evaluation)
                target.storage.evaluations.write(at_once=False)
                target.show(1)

    def at_once(self, tasks: Sequence[Callable[[], T]], /) -> list[T]:
        """Run tasks in forks of this process: see `streamkit.Target`."""
        return in_forks(tasks, self._calls.processes, self._at_work)

    def _missing(self, points: Array) -> list[Array]:
        """Return those of points (n, d) that have not been evaluated with all particles, here or in an earlier run."""
        points = np.ascontiguousarray(points, dtype=float)
        return [each for each in self.storage.evaluations.missing(points) if each not in self.storage.earlier]

    @property
    def coordinates(self) -> BoolArray:
        """(d,) Whether the predictions depend on a parameter; the others enter the likelihood alone."""
        return self._compared().coordinates

    @property
    def undeclared(self) -> Sequence[str]:
        """The measurements that `compare` cannot compare: role and kind."""
        return self._compared().undeclared

    def compare(self, points: Array, mean: Array, variance: Array, details: Array) -> Array:
        """Return ln likelihood (n,) at points (n, d) for given predictions."""
        comparison = self._compared()
        if not comparison.knows_shapes:
            stores = (self.storage.evaluations, self.storage.earlier, self.storage.small)
            place = next((found for each in stores if (found := each.any_good()) is not None), None)
            if place is None:
                raise ComponentError("Target.compare: no point has been evaluated before, with a likelihood")
            comparison.read_shapes(place)
        self._at_work()
        return comparison.ln_likelihood(points, mean, variance, details)

    def _at_work(self) -> None:
        """Show that the sampler is at work, which may be for minutes between two calls; raise `Stopped` if asked to."""
        if self._calls.stop:
            raise Stopped(self._calls.stop)
        if self.display.waits:
            self.show(0, self.display.starts)

    def _compared(self) -> Comparison:
        if self._comparison is None:
            raise ComponentError("Target.compare: is for samplers with `emulates = True`, and this one has not")
        return self._comparison

    def show(self, more: int, small: bool = False) -> None:
        """Show ``more`` calls, those with few particles apart, or steps of a chain."""
        made = sum(count for name, count in self._calls.calls.items() if name.startswith("full"))  # of all factors
        self.display.update(more, made, self.storage, small)


def _target(queued: tuple[Emulating, Array]) -> Emulating:
    return queued[0]
