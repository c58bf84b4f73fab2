"""The process of a command: valid standard streams, and an exit that does not wait for threads of plugins."""

from __future__ import annotations

import gc
import io
import os
import sys
import threading
from contextlib import suppress
from time import sleep
from typing import NoReturn

import click

PATIENCE = 10.0  # seconds that other threads have to end after the command
# New objects after which Python searches for cycles that nothing refers to, in place of 700. Imports and compilations
# make some 200 000 objects that stay, and the searches among them took a tenth of a command's time. Calls of a model
# make no cycles.
NEW_OBJECTS = 20_000
WRITTEN = io.TextIOWrapper, io.BufferedWriter, io.BufferedRandom  # files whose last text may be in memory only


def collect_rarely() -> None:
    """Let the process search for garbage in cycles more rarely. All other garbage is freed at once, as always."""
    gc.set_threshold(NEW_OBJECTS)


def keep_streams() -> None:
    """Give the process valid standard streams.

    Descriptors that the shell closed are opened on the null device: otherwise the next file would get their number, and
    prints would go into it. Output goes through copies, which stay open if a plugin closes the originals. A letter that
    the terminal's encoding lacks is replaced.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # it gets the lowest number, which is this one
    for number, name, errors in ((1, "stdout", "replace"), (2, "stderr", "backslashreplace")):
        stream = getattr(sys, name)
        at_once = number == 2 or os.isatty(number)
        copy = os.fdopen(
            os.dup(number), "w", buffering=1 if at_once else -1,
            encoding=getattr(stream, "encoding", "utf-8"), errors=errors,
        )  # fmt: skip
        setattr(sys, name, copy)


def leave(status: int) -> NoReturn:
    """End the process with a status. Threads of plugins that are no daemons have `PATIENCE` seconds to end.

    Output that cannot be printed, to a closed pipe or stream, does not change the status. Cycles are not taken apart
    any more, which took half a second, as the end of the process frees all memory; files that plugins left open in
    them are written before.
    """
    for name in ("stdout", "stderr"):
        try:
            getattr(sys, name).flush()
        except (OSError, ValueError):
            setattr(sys, name, None)
    for thing in gc.get_objects():
        if issubclass(type(thing), WRITTEN):
            with suppress(OSError, ValueError):
                thing.flush()
    if _others():
        threading.Thread(target=_end, args=(status,), daemon=True).start()
    gc.freeze()
    sys.exit(status)


def _others() -> list[str]:
    """Return the names of the threads that the interpreter would wait for."""
    main = threading.main_thread()
    return [each.name for each in threading.enumerate() if each is not main and not each.daemon]


def _end(status: int) -> None:
    sleep(PATIENCE)
    if left := _others():
        with suppress(OSError, ValueError):
            click.echo(f"streamkit: ended, though a thread of a plugin is still running ({left[0]})", err=True)
            sys.stdout.flush()
        os._exit(status)
