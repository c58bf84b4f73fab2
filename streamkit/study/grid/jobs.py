"""The jobs of a grid, run in this process or in others. An early end keeps the finished jobs."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from typing import TypeVar

from streamkit.errors import Interrupted, StreamkitError
from streamkit.sample import POLL, WorkerDied, pool

# Reasons of an early end, by signal: Ctrl-C and SIGTERM.
REASONS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
DIED = str(WorkerDied())


Key = TypeVar("Key", bound=Hashable)
Job = TypeVar("Job")
Result = TypeVar("Result")


def run_jobs(
    work: Callable[[Job], Result], jobs: Mapping[Key, Job], workers: int = 1, done: Callable[[], object] = lambda: None
) -> tuple[dict[Key, Result], str]:
    """Return the result of ``work`` for each job, and the reason of missing ones: of `REASONS`, `DIED`, or empty.

    Jobs are independent of each other: with several workers ``work`` and the jobs are pickled. ``done`` is
    called after each. Ctrl-C and SIGTERM end the work; an exception of ``work`` comes through.
    """
    results: dict[Key, Result] = {}
    stopped = ""
    try:
        with _terminable() as signals:
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
    except KeyboardInterrupt:
        stopped = REASONS[signals[-1]]
    except Interrupted as stop:  # from a fit, which takes the signal first
        stopped = REASONS[signal.Signals(stop.exit_status - 128)]
    return results, stopped


def ended_before(source: str, stopped: str, what: str) -> StreamkitError:
    """Return the error of a study that ``stopped`` before it had a result: `Interrupted` after Ctrl-C and SIGTERM."""
    message = f"{source}: {stopped} before {what}"
    return Interrupted(message, signum) if (signum := signal_of(stopped)) else StreamkitError(message)


def signal_of(stopped: str) -> int:
    """Return the number of the signal that ended a study for this reason; 0 if none did."""
    return next((int(signum) for signum, reason in REASONS.items() if reason == stopped), 0)


def exit_status(stopped: str) -> int:
    """Return the exit status of a study that ended early for this reason."""
    return 128 + signum if (signum := signal_of(stopped)) else 2


@contextmanager
def _terminable() -> Iterator[list[signal.Signals]]:
    """Make SIGTERM raise KeyboardInterrupt, as Ctrl-C does; yield a list whose last entry is the signal.

    Python allows handlers in the main thread only.
    """
    seen = [signal.SIGINT]
    if threading.current_thread() is not threading.main_thread():
        yield seen
        return

    def terminate(*_: object) -> None:
        seen.append(signal.SIGTERM)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, terminate)
    try:
        yield seen
    finally:
        signal.signal(signal.SIGTERM, before)
