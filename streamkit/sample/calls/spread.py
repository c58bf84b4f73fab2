"""Several functions evaluated at a time, by this process and by forks of it.

A sampler that emulates the predictions of twelve streams evaluates twelve functions at every step, and no stream is
made. The workers of `Workers` cannot do this: they were forked before the emulators were learned.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from statistics import median
from time import perf_counter

from streamkit.sample.calls.processes import Processes
from streamkit.stream import Array

Function = Callable[[Array], Array]

# Times between evaluations that are measured before this process gives away some of its share.
MEASURED = 15

_HELD: list[Function] = []  # the functions of this forked process, set once by its initializer


class Spread:
    """Functions as one: of an argument for each, it returns the result of each.

    The first evaluation is made in this process, and measures how long each takes. It decides which process evaluates
    which; no result depends on that. Some evaluations later this process gives away as much as it has to do between
    them. Processes are forked after the first one, and end with this object. They hold the functions as they were then.
    Without fork, everything is evaluated here.
    """

    def __init__(self, functions: Sequence[Function], processes: int) -> None:  # with this process
        self._functions = list(functions)
        self._count = min(processes, len(functions)) if "fork" in multiprocessing.get_all_start_methods() else 1
        self._shares: list[list[int]] = []
        self._seconds: list[float] = []  # of each function, for one row
        self._between: list[float] = []  # seconds, for a row of the evaluation after them
        self._ended = 0.0
        self._forks: Processes | None = None

    def __call__(self, arguments: Sequence[Array]) -> list[Array]:
        """Return the results for these arguments, in order."""
        if self._count > 1 and not self._shares:
            return self._first(arguments)
        if self._count < 2:
            return [function(each) for function, each in zip(self._functions, arguments, strict=True)]
        if self._forks is None:
            self._forks = Processes(self._count - 1, _hold, (self._functions,))
        if len(self._between) < MEASURED:
            self._between.append((perf_counter() - self._ended) / max(len(arguments[0]), 1))
            if len(self._between) == MEASURED:
                self._share(median(self._between))
        mine, *others = self._shares
        futures = [self._forks.submit(_evaluated, share, [arguments[i] for i in share]) for share in others]
        found = {i: self._functions[i](arguments[i]) for i in mine}
        for share, future in zip(others, futures, strict=True):
            found.update(zip(share, future.result(), strict=True))
        self._ended = perf_counter()
        return [found[i] for i in range(len(arguments))]

    def _first(self, arguments: Sequence[Array]) -> list[Array]:
        """Evaluate here, and give each process about as much to do."""
        found = []
        for function, each in zip(self._functions, arguments, strict=True):
            begun = perf_counter()
            found.append(function(each))
            self._seconds.append((perf_counter() - begun) / max(len(each), 1))
        self._share(0.0)
        self._ended = perf_counter()
        return found

    def _share(self, besides: float) -> None:
        """Share the functions, the slowest first, with what this process has to do ``besides`` them (seconds a row)."""
        self._shares, work = [[] for _ in range(self._count)], [besides, *[0.0] * (self._count - 1)]
        for i in sorted(range(len(self._seconds)), key=lambda i: -self._seconds[i]):
            least = work.index(min(work))
            self._shares[least].append(i)
            work[least] += self._seconds[i]


def _hold(functions: Sequence[Function]) -> None:
    _HELD[:] = functions


def _evaluated(share: Sequence[int], arguments: Sequence[Array]) -> list[Array]:
    return [_HELD[i](each) for i, each in zip(share, arguments, strict=True)]
