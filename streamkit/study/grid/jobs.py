"""Run the jobs of a grid, in this process or in others; whatever ends them early, what is finished is kept."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from streamkit.sample import pool

INTERRUPTED = "interrupted"
DIED = "a worker process died (killed, or out of memory): try fewer workers, or fewer particles"


Key = TypeVar("Key", bound=Hashable)
Job = TypeVar("Job")
Result = TypeVar("Result")


def run_jobs(
    work: Callable[[Job], Result], jobs: Mapping[Key, Job], workers: int = 1, done: Callable[[], object] = lambda: None
) -> tuple[dict[Key, Result], str]:
    """Return what ``work`` makes of each job, and why some are missing: `INTERRUPTED`, `DIED`, or empty.

    Every job stands for itself, in any process: with several workers ``work`` and the jobs are pickled. ``done`` is
    called after each. Ctrl-C and SIGTERM end the work; an exception of ``work`` comes through.
    """
    found: dict[Key, Result] = {}
    stopped = ""
    try:
        with _terminable():
            if workers == 1:
                for key, job in jobs.items():
                    found[key] = work(job)
                    done()
                return found, ""
            executor = pool(workers)
            try:
                futures = {executor.submit(work, job): key for key, job in jobs.items()}
                for future in as_completed(futures):
                    try:
                        found[futures[future]] = future.result()
                    except BrokenProcessPool:  # which breaks all that are left; others may be finished
                        stopped = DIED
                    done()
            finally:
                executor.shutdown(wait=True, cancel_futures=True)
    except KeyboardInterrupt:
        stopped = INTERRUPTED
    return found, stopped


@contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM end the work as Ctrl-C does; Python allows handlers in the main thread only."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
