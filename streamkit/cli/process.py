"""The process of a command: streams that are there whatever is closed, and an end for which no thread is waited."""

from __future__ import annotations

import os
import sys
import threading
from contextlib import suppress
from time import sleep
from typing import NoReturn

import click

PATIENCE = 10.0  # seconds that threads other than the main one have to end, once the command has


def keep_streams() -> None:
    """Make sure that there is somewhere to write to.

    Descriptors that the shell closed lead nowhere, so that no other file is opened in their place. What is printed goes
    through copies of them: a plugin that closes the originals does no harm.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # it gets the lowest number, which is this one
    for number, name in ((1, "stdout"), (2, "stderr")):
        stream = getattr(sys, name)
        at_once = number == 2 or os.isatty(number)
        copy = os.fdopen(
            os.dup(number), "w", buffering=1 if at_once else -1,
            encoding=getattr(stream, "encoding", "utf-8"), errors=getattr(stream, "errors", "backslashreplace"),
        )  # fmt: skip
        setattr(sys, name, copy)


def leave(status: int) -> NoReturn:
    """End the process with a status; threads that a plugin left and that are no daemons have `PATIENCE`.

    What cannot be printed, as nobody reads it any more or a plugin closed it, does not change the status.
    """
    for name in ("stdout", "stderr"):
        try:
            getattr(sys, name).flush()
        except (OSError, ValueError):
            setattr(sys, name, None)
    if _others():
        threading.Thread(target=_end, args=(status,), daemon=True).start()
    sys.exit(status)


def _others() -> list[str]:
    """Return the names of the threads that the interpreter waits for."""
    main = threading.main_thread()
    return [each.name for each in threading.enumerate() if each is not main and not each.daemon]


def _end(status: int) -> None:
    sleep(PATIENCE)
    if left := _others():
        with suppress(OSError, ValueError):
            click.echo(f"streamkit: ended, though a thread goes on that a plugin left ({left[0]})", err=True)
            sys.stdout.flush()
        os._exit(status)
