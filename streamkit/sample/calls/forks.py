"""Tasks in forks of this process, which hold all that it holds: what a sampler has learned, and no model is called."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from streamkit.sample.calls.processes import POLL, Processes

T = TypeVar("T")

_HELD: list[Callable[[], Any]] = []  # the tasks of this forked process, set once by its initializer


def in_forks(tasks: Sequence[Callable[[], T]], processes: int, meanwhile: Callable[[], None]) -> list[T]:
    """Run tasks in so many forks; return their results, in order, which are pickled.

    ``meanwhile`` is called every second; what it raises ends the forks. With one process or one task, and where the
    platform has no fork, the tasks run here, one after another.
    """
    count = min(processes, len(tasks)) if "fork" in multiprocessing.get_all_start_methods() else 1
    if count < 2:
        return [task() for task in tasks]
    forks = Processes(count, _hold, (list(tasks),))
    try:
        futures = [forks.submit(_run, i) for i in range(len(tasks))]
        while not all(each.done() for each in futures):
            forks.work(lambda: all(each.done() for each in futures), POLL)
            meanwhile()
        return [each.result() for each in futures]
    finally:
        forks.shutdown(cancel_futures=True)


def _hold(tasks: Sequence[Callable[[], Any]]) -> None:
    _HELD[:] = tasks


def _run(which: int) -> Any:
    return _HELD[which]()
