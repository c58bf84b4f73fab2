"""Tasks that several processes do at a time; and works that each go on with the result of a task."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import Any, Protocol, TypeVar

T = TypeVar("T")
# It yields tasks, is sent the result of each, and returns what it has made.
Work = Generator[Callable[[], Any], Any, T]


class AtOnce(Protocol):
    """Runs tasks, each perhaps in a process of its own, and returns their results in order."""

    def __call__(self, tasks: Sequence[Callable[[], T]], /) -> list[T]:
        """Run them."""


def in_turn(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Run tasks one after another."""
    return [task() for task in tasks]


def side_by_side(works: Sequence[Work[T]], at_once: AtOnce) -> list[T]:
    """Return what works make, of which the next tasks are run at a time."""
    made: dict[int, T] = {}
    results: dict[int, Any] = dict.fromkeys(range(len(works)))
    while results:
        tasks = {}
        for i, result in results.items():
            try:
                tasks[i] = works[i].send(result)
            except StopIteration as end:
                made[i] = end.value
        results = dict(zip(tasks, at_once(list(tasks.values())), strict=True))
    return [made[i] for i in range(len(works))]
