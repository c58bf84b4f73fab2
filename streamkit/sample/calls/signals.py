"""Signals as requests: SIGINT and SIGTERM end a loop between two of its calls, and interrupt no write."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol


class Stoppable(Protocol):
    """An object that a signal can stop: `Workers`, or any loop that reads its ``stop``."""

    stop: int


class Stopped(Exception):  # noqa: N818  a request, not a fault
    """Raised between two evaluations after the signal ``signum``."""

    def __init__(self, signum: int) -> None:
        super().__init__(signum)
        self.signum = signum


@contextmanager
def stopped_by_signals(target: Stoppable) -> Iterator[None]:
    """Let SIGINT and SIGTERM set ``target.stop`` to their number, so that they do not interrupt a write.

    Python allows handlers in the main thread only; elsewhere (a notebook's thread) nothing is changed.
    """

    def handle(signum: int, _frame: object) -> None:
        target.stop = signum

    numbers = (signal.SIGINT, signal.SIGTERM) if threading.current_thread() is threading.main_thread() else ()
    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
