"""Worker processes that evaluate the posterior: given the specs once, every call and rejection counted."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Protocol

from streamkit.errors import StreamkitError
from streamkit.sample.posterior import Evaluation
from streamkit.stream import Array

Row = tuple[float, float, Array, Array]


class Evaluates(Protocol):
    """What a `Workers` needs of a posterior: `Posterior` has it, and so has any toy that a test writes."""

    def evaluate(self, theta: Array) -> Evaluation:
        """Evaluate at theta (d,)."""


class Stoppable(Protocol):
    """What a signal can stop: `Workers`, or any loop that looks at its own ``stop``."""

    stop: int


class Stopped(Exception):  # noqa: N818  a request, not a fault
    """Raised between two evaluations after a signal asked for an end. ``signum`` says which."""

    def __init__(self, signum: int) -> None:
        super().__init__(signum)
        self.signum = signum


class Workers:
    """Evaluates one of several posteriors ("full", "cheap") on many points, in this or in other processes.

    Use as a context manager.

    Attributes
    ----------
    calls
        Evaluations so far, by posterior.
    reasons
        Rejections so far, by posterior and reason: of proposals too, which emcee forgets.
    stop
        Number of the signal that asked for an end, or 0.
    """

    def __init__(self, posteriors: Mapping[str, Evaluates], count: int = 1) -> None:
        self._posteriors = dict(posteriors)
        self._count = count
        self._executor: ProcessPoolExecutor | None = None
        self.calls: Counter[str] = Counter()
        self.reasons: dict[str, Counter[str]] = {name: Counter() for name in posteriors}
        self.stop = 0

    def __enter__(self) -> Workers:
        if self._count > 1:
            self._executor = pool(self._count, self._posteriors)
        return self

    def __exit__(self, *_: object) -> None:
        if self._executor is not None:
            self._executor.shutdown(wait=True, cancel_futures=True)

    def evaluate(self, points: Array, which: str = "full") -> list[Evaluation]:
        """Evaluate at points (n, d), in order.

        Raises
        ------
        Stopped
            As soon as ``stop`` is set.
        ComponentError
            If a component fails.
        StreamkitError
            If a worker process dies.
        """
        results: list[Evaluation] = []
        try:
            for result in self._results(points, which):
                self.calls[which] += 1
                if result.reason:
                    self.reasons[which][result.reason] += 1
                results.append(result)
                if self.stop:
                    raise Stopped(self.stop)
        except BrokenProcessPool:
            raise StreamkitError(
                "a worker process died (killed, or out of memory): try fewer workers, or fewer particles"
            ) from None
        return results

    def _results(self, points: Array, which: str) -> Iterator[Evaluation]:
        if self._executor is None:
            return (self._posteriors[which].evaluate(point) for point in points)
        # Calls differ in cost by the look-back time: small chunks keep every core busy to the end.
        chunk = max(len(points) // (16 * self._count), 1)
        return self._executor.map(_evaluate, [which] * len(points), points, chunksize=chunk)


class Signals:
    """While active, SIGINT and SIGTERM set ``target.stop`` to their number instead of tearing a write apart.

    Python allows handlers in the main thread only; elsewhere (a notebook's thread) nothing is changed.
    """

    def __init__(self, target: Stoppable) -> None:
        self._target = target
        self._before: dict[int, Any] = {}

    def __enter__(self) -> None:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._handle)

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _handle(self, signum: int, _frame: object) -> None:
        self._target.stop = signum


def pool(count: int, posteriors: Mapping[str, Evaluates] | None = None) -> ProcessPoolExecutor:
    """Return worker processes that leave signals to their parent, end with it, and hold the posteriors."""
    method = "fork" if "fork" in multiprocessing.get_all_start_methods() else "spawn"
    context = multiprocessing.get_context(method)
    return ProcessPoolExecutor(count, mp_context=context, initializer=_prepare, initargs=(posteriors or {},))


_POSTERIORS: dict[str, Evaluates] = {}
"""The posteriors of this worker process, set once by its initializer: the one state that a module keeps."""


def _prepare(posteriors: Mapping[str, Evaluates]) -> None:
    """Start a worker: the parent alone answers signals, and the worker ends with it, killed or not."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    _POSTERIORS.update(posteriors)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(1)


def _evaluate(which: str, point: Array) -> Evaluation:
    return _POSTERIORS[which].evaluate(point)
