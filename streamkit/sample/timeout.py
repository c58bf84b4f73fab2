"""A call within a time limit, in whatever process and thread it is made."""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Callable
from time import monotonic
from typing import Any, TypeVar

NO_ANSWER = "no answer in time"  # what stands for the result of a call that took too long
Result = TypeVar("Result")


AGAIN = 1.0  # seconds after which a call that goes on is ended again


class _Over(BaseException):
    """Ends a call; no Exception, so that a component which catches those does not catch it."""


def call_with_timeout(limit: float, function: Callable[..., Result], *args: Any) -> Result | str:
    """Return what the function gives, or `NO_ANSWER` if that takes longer than ``limit`` seconds.

    In the main thread a timer ends the call as soon as Python code runs in it, compiled code only when it returns.
    Elsewhere, as in Dask's workers, nothing can end it: it is noticed when it is over. A timer of the caller's goes on.
    """
    timed = threading.current_thread() is threading.main_thread() and hasattr(signal, "setitimer") and limit < math.inf
    begin = monotonic()
    if not timed:
        result = function(*args)
        return result if monotonic() - begin <= limit else NO_ANSWER
    running, over = [True], []

    def end(*_: object) -> None:
        over.append(True)
        if running:
            raise _Over

    theirs, again = signal.getitimer(signal.ITIMER_REAL)
    before = signal.signal(signal.SIGALRM, end)
    try:
        try:
            signal.setitimer(signal.ITIMER_REAL, limit, AGAIN)
            result = function(*args)
        finally:
            running.clear()
    except BaseException:  # a component may have made something else of the end
        if not over:
            raise
        return NO_ANSWER
    finally:
        running.clear()
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        if theirs:
            signal.setitimer(signal.ITIMER_REAL, max(theirs - (monotonic() - begin), 0.001), again)
    return NO_ANSWER if over else result
