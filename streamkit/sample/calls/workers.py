"""Workers that evaluate the posterior. They receive the posteriors once, and count calls and rejections."""

from __future__ import annotations

import math
import pickle
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from time import monotonic
from typing import Any

import numpy as np

from streamkit.sample.calls.engines import slots
from streamkit.sample.calls.processes import POLL, CallTimeout, WorkerDied
from streamkit.sample.calls.serving import Answers, Evaluates, evaluate_held, evaluate_sent, pool
from streamkit.sample.calls.signals import Stopped
from streamkit.sample.calls.timeout import NO_ANSWER, Result, call_with_timeout
from streamkit.sample.evaluation import Evaluation
from streamkit.stream import Array

OVERTIME = "the call took too long"
COMPILING = 300.0  # additional seconds for the first call of a remote worker, which compiles
FOREIGN = 8  # assumed number of points that a given executor evaluates at a time


class Workers:
    """Evaluates one of several posteriors ("full", "cheap") on many points, in this or in other processes.

    Use as a context manager, entered before any thread is started: the processes are forked then.

    A call may take ``limit`` seconds. After this time a worker process is killed. In this process and on MPI ranks,
    Python code is interrupted; compiled code ends first. With Dask or a given executor, a longer call is detected when
    it ends. If no call ends within the limit, a `CallTimeout` is raised.
    """

    def __init__(
        self,
        posteriors: Mapping[str, Evaluates],  # by name; for an executor of your own they must pickle
        workers: int | Executor = 1,  # a number of processes; or any executor, MPI's and Dask's too, left running
        limit: float = math.inf,
        reject: bool = False,  # whether a longer call counts as a rejection; else `CallTimeout` is raised
    ) -> None:
        self._limit, self._reject = limit, reject
        self._posteriors = dict(posteriors)
        self._workers = workers
        self._slots = slots(workers) if isinstance(workers, Executor) else workers
        self._executor: Executor | None = None
        self._sent, self._active_at = b"", monotonic()
        self.calls: Counter[str] = Counter()  # evaluations so far, by posterior
        # Rejections so far, by posterior and reason. Rejected proposals count too.
        self.reasons: dict[str, Counter[str]] = {name: Counter() for name in posteriors}
        self.stop = 0  # number of the signal that requested an end

    @property
    def at_a_time(self) -> int:
        """Points that are evaluated at a time; a constant for a given executor, so that no sample depends on it."""
        return FOREIGN if isinstance(self._workers, Executor) else self._workers

    @property
    def processes(self) -> int:
        """Processes of this machine that a run may use; 1 beside a given executor."""
        return 1 if isinstance(self._workers, Executor) else self._workers

    def forget(self, which: str) -> None:
        """Count the calls and rejections of a posterior from now on."""
        self.calls[which] = 0
        self.reasons[which].clear()

    def __enter__(self) -> Workers:
        if isinstance(self._workers, Executor):
            self._executor, self._sent = self._workers, pickle.dumps(self._posteriors)
        elif self._workers > 1:
            self._executor = pool(self._workers, self._posteriors, self._limit)
        return self

    def __exit__(self, *_: object) -> None:
        if self._executor is not None and not isinstance(self._workers, Executor):
            self._executor.shutdown(wait=True, cancel_futures=True)

    def evaluate(self, points: Array, which: str = "full") -> list[Evaluation]:
        """Evaluate at points (n, d), in order: see `each`."""
        return list(self.each(points, which))

    def each(self, points: Array, which: str = "full") -> Iterator[Evaluation]:
        """Yield the evaluation at each of the points (n, d), in order, as soon as it is known.

        Raises `Stopped` soon after ``stop`` is set, ComponentError if a component fails, StreamkitError if worker
        processes die again and again.
        """
        yield from self.each_of([(which, points)])

    def each_of(self, batches: Sequence[tuple[str, Array]]) -> Iterator[Evaluation]:
        """Yield the evaluations of several posteriors, each at points (n, d) of its own, from one queue: see `each`."""
        for which, result in self._results(batches):
            self.calls[which] += 1
            if result.reason:
                self.reasons[which][result.reason] += 1
            yield result
            if self.stop:
                raise Stopped(self.stop)

    def _results(self, batches: Sequence[tuple[str, Array]]) -> Iterator[tuple[str, Evaluation]]:
        executor = self._executor
        if executor is None:
            for which, points in batches:
                for point in points:
                    one = call_with_timeout(self._limit, self._posteriors[which].evaluate, point)
                    yield which, self._overtime(point, which) if isinstance(one, str) else one
            return
        parts = [(which, part) for which, points in batches for part in self._parts(points)]
        self._note_activity()
        futures = [self._submit(executor, part, which) for which, part in parts]
        try:
            for (which, part), future in zip(parts, futures, strict=True):
                try:
                    answers = self._wait(future, len(part))
                except CallTimeout:
                    if isinstance(self._workers, Executor):
                        raise
                    answers = [NO_ANSWER] * len(part)  # worker processes get one point at a time
                for point, each in zip(part, answers, strict=True):
                    yield which, self._overtime(point, which) if isinstance(each, str) else each
        except Exception as error:
            if isinstance(error, BrokenExecutor | CancelledError) or type(error).__name__ == "KilledWorker":  # Dask's
                raise WorkerDied(f"the workers of the executor died ({error})") from None
            raise
        finally:
            for future in futures:
                future.cancel()

    def _submit(self, executor: Executor, part: Array, which: str) -> Future[Answers]:
        if isinstance(self._workers, Executor):
            future: Future[Answers] = executor.submit(evaluate_sent, self._sent, which, part, self._limit)
            future.add_done_callback(self._note_activity)
            return future
        return executor.submit(evaluate_held, which, part)

    def _note_activity(self, _: object = None) -> None:
        self._active_at = monotonic()

    def _parts(self, points: Array) -> list[Array]:
        """Split the points into parts, each sent as one message.

        The cost of calls varies with the look-back time: parts of one point keep every core busy to the end. Given
        executors need several milliseconds for each part, so their parts are larger.
        """
        each = len(points) // (4 * self._slots) if isinstance(self._workers, Executor) else 1
        return np.array_split(points, -(-len(points) // max(each, 1))) if len(points) else []

    def _overtime(self, point: Array, which: str) -> Evaluation:
        """Return the evaluation of a call that took too long, or raise `CallTimeout`."""
        if self._reject:
            return self._posteriors[which].rejected(OVERTIME)
        raise CallTimeout(
            f"a call took longer than sampler.call_limit = {self._limit:g} s, at the parameters "
            f'{", ".join(f"{value:.6g}" for value in point)}; sampler.over_limit = "reject" would continue'
        )

    def _wait(self, future: Future[Answers], calls: int) -> Answers:
        while True:
            try:
                return future.result(POLL)
            except TimeoutError:
                if future.done():
                    raise
                if self.stop:
                    raise Stopped(self.stop) from None
                idle = monotonic() - self._active_at
                if isinstance(self._workers, Executor) and idle > self._limit * calls + COMPILING:
                    raise CallTimeout(
                        f"{calls} call{'s' * (calls > 1)} did not end within sampler.call_limit = {self._limit:g} s "
                        'each, and this engine cannot end one: the engine "processes" can'
                    ) from None


def first_call(limit: float, function: Callable[..., Result], *args: Any) -> Result:
    """Return the result of a call in this process, which may compile; CallTimeout after `COMPILING` and the limit."""
    result = call_with_timeout(limit + COMPILING, function, *args)
    if isinstance(result, str):
        raise CallTimeout(
            f"the first call took longer than sampler.call_limit = {limit:g} s and the {COMPILING:g} s for compiling"
        )
    return result
