"""The jobs of a grid, run in this process or in others. An early end keeps the finished jobs."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from typing import TypeVar

from streamkit.errors import Interrupted, StreamkitError
from streamkit.sample import POLL, WorkerDied, pool

INTERRUPTED = "interrupted"
DIED = str(WorkerDied())


Key = TypeVar("Key", bound=Hashable)
Job = TypeVar("Job")
Result = TypeVar("Result")


def run_jobs(
    work: Callable[[Job], Result], jobs: Mapping[Key, Job], workers: int = 1, done: Callable[[], object] = lambda: None
) -> tuple[dict[Key, Result], str]:
    """Return the result of ``work`` for each job, and the reason of missing ones: `INTERRUPTED`, `DIED`, or empty.

    Jobs are independent of each other: with several workers ``work`` and the jobs are pickled. ``done`` is
    called after each. Ctrl-C and SIGTERM end the work; an exception of ``work`` comes through.
    """
    results: dict[Key, Result] = {}
    stopped = ""
    try:
        with _terminable():
            if workers == 1:
                for key, job in jobs.items():
                    results[key] = work(job)
                    done()
                return results, ""
            executor = pool(workers)
            try:
                left = {key: executor.submit(work, job) for key, job in jobs.items()}
                while left:
                    executor.work(lambda: any(future.done() for future in left.values()), POLL)
                    for key in [key for key, future in left.items() if future.done()]:
                        try:
                            results[key] = left.pop(key).result()
                        except WorkerDied:  # the other jobs continue
                            stopped = DIED
                        done()
            finally:
                executor.shutdown(cancel_futures=True)
    except (KeyboardInterrupt, Interrupted):  # the latter from a fit, which takes the signal first
        stopped = INTERRUPTED
    return results, stopped


def ended_before(source: str, stopped: str, what: str) -> StreamkitError:
    """Return the error of a study that ``stopped`` before it had a result: `Interrupted` after Ctrl-C and SIGTERM."""
    kind = Interrupted if stopped == INTERRUPTED else StreamkitError
    return kind(f"{source}: {stopped} before {what}")


@contextmanager
def _terminable() -> Iterator[None]:
    """Make SIGTERM raise KeyboardInterrupt, as Ctrl-C does; Python allows handlers in the main thread only."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
