"""Workers that evaluate the posterior: given the posteriors once, every call and rejection counted."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from typing import Any, Protocol

from streamkit.errors import PluginError, StreamkitError
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

    Use as a context manager, entered before any thread is started: the processes are forked then.

    Parameters
    ----------
    posteriors
        By name; for an executor of your own they must pickle.
    workers
        A number of processes; or any `concurrent.futures.Executor` (MPI's and Dask's among them), left running.

    Attributes
    ----------
    calls
        Evaluations so far, by posterior.
    reasons
        Rejections so far, by posterior and reason: of proposals too, which emcee forgets.
    stop
        Number of the signal that asked for an end, or 0.
    """

    def __init__(self, posteriors: Mapping[str, Evaluates], workers: int | Executor = 1) -> None:
        self._posteriors = dict(posteriors)
        self._workers = workers
        self._executor: Executor | None = None
        self._sent = b""
        self.calls: Counter[str] = Counter()
        self.reasons: dict[str, Counter[str]] = {name: Counter() for name in posteriors}
        self.stop = 0

    def __enter__(self) -> Workers:
        if isinstance(self._workers, Executor):
            self._executor, self._sent = self._workers, pickle.dumps(self._posteriors)
        elif self._workers > 1:
            self._executor = pool(self._workers, self._posteriors)
        return self

    def __exit__(self, *_: object) -> None:
        if self._executor is not None and not isinstance(self._workers, Executor):
            self._executor.shutdown(wait=True, cancel_futures=True)

    def evaluate(self, points: Array, which: str = "full") -> list[Evaluation]:
        """Evaluate at points (n, d), in order.

        Raises `Stopped` as soon as ``stop`` is set, ComponentError if a component fails, and StreamkitError if a
        worker process dies.
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
        except BrokenExecutor:
            raise StreamkitError(
                "a worker process died (killed, or out of memory): try fewer workers, or fewer particles"
            ) from None
        return results

    def _results(self, points: Array, which: str) -> Iterator[Evaluation]:
        if self._executor is None:
            return (self._posteriors[which].evaluate(point) for point in points)
        if isinstance(self._workers, Executor):
            n = len(points)
            return self._executor.map(_evaluate_sent, [self._sent] * n, [which] * n, points)
        # Calls differ in cost by the look-back time: small chunks keep every core busy to the end.
        chunk = max(len(points) // (16 * self._workers), 1)
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
    """Return worker processes that leave signals to their parent, end with it, and hold the posteriors.

    They are forked here and now, where that exists: this takes milliseconds, and asks nothing of the caller's main
    module. Later, threads (a progress bar's) might hold locks that a forked process would wait for in vain.
    """
    method = "fork" if "fork" in multiprocessing.get_all_start_methods() else "spawn"
    context = multiprocessing.get_context(method)
    executor = ProcessPoolExecutor(count, mp_context=context, initializer=_prepare, initargs=(posteriors or {},))
    with warnings.catch_warnings():
        # from Python 3.12 on, threads of numpy's linear algebra are warned of too; these survive a fork
        warnings.filterwarnings("ignore", message=".*fork", category=DeprecationWarning)
        executor.submit(os.getpid)  # the first task forks all of them
    return executor


_POSTERIORS: dict[str, Evaluates] = {}
"""The posteriors of this worker process, set once by its initializer."""
_SENT: dict[bytes, dict[str, Evaluates]] = {}
"""The posteriors that a worker of somebody else's executor was sent last, by their pickle."""


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


def _evaluate_sent(sent: bytes, which: str, point: Array) -> Evaluation:
    if sent not in _SENT:
        _SENT.clear()
        try:
            _SENT[sent] = pickle.loads(sent)  # noqa: S301  our own
        except (AttributeError, ImportError) as error:
            raise PluginError(
                f"a worker cannot find what the run needs ({error}). A class given in Python must be in a module that "
                "every worker can import; or put it in a file and name that under plugins in the run file."
            ) from error
    return _SENT[sent][which].evaluate(point)
