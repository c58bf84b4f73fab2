"""A call within a time limit, in whatever process and thread it is made."""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Callable
from time import monotonic
from typing import Any, TypeVar

NO_ANSWER = "no answer in time"
"""What stands for the result of a call that took too long."""
Result = TypeVar("Result")


class _Over(BaseException):
    """Ends a call; no Exception, so that a component which catches those does not catch it."""


def within(limit: float, function: Callable[..., Result], *args: Any) -> Result | str:
    """Return what the function gives, or `NO_ANSWER` if that takes longer than ``limit`` seconds.

    In the main thread a timer ends the call as soon as Python code runs in it. Elsewhere, as in Dask's workers, nothing
    can end it: it is noticed when it is over.
    """
    timed = threading.current_thread() is threading.main_thread() and hasattr(signal, "setitimer") and limit < math.inf
    begin = monotonic()
    if not timed:
        result = function(*args)
        return result if monotonic() - begin <= limit else NO_ANSWER

    def end(*_: object) -> None:
        raise _Over

    before = signal.signal(signal.SIGALRM, end)
    try:
        signal.setitimer(signal.ITIMER_REAL, limit)
        try:
            return function(*args)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
    except _Over:
        return NO_ANSWER
    finally:
        signal.signal(signal.SIGALRM, before)
