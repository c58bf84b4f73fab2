"""Calls with a time limit, in any process and thread."""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Callable
from time import monotonic
from typing import Any, TypeVar

NO_ANSWER = "no answer in time"  # returned in place of the result of a call that took too long
AGAIN = 1.0  # seconds after which a call that caught the interruption is interrupted again
Result = TypeVar("Result")


class _Over(BaseException):
    """Interrupts a call. It does not derive from Exception, so that a component's ``except`` does not catch it."""


def call_with_timeout(limit: float, function: Callable[..., Result], *args: Any) -> Result | str:
    """Return the result of a call, or `NO_ANSWER` if it takes longer than ``limit`` seconds.

    In the main thread a timer interrupts Python code; compiled code returns first. In other threads, as in Dask's
    workers, a call cannot be interrupted: the excess is detected when it ends. A timer of the caller is set again.
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
    except BaseException:  # a component may have raised another error from the interruption
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
