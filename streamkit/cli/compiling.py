"""A message while machine code is compiled, which takes a minute or two on a new machine."""

from __future__ import annotations

import mmap
from typing import Any

import click

SENTENCE = (
    "compiling machine code, once for these components on this machine: seconds, and a minute or two for the "
    "first of all"
)


def announce_compilation() -> None:
    """Announce compilation once in the rest of this command, including the processes that it forks."""
    from numba.core import event  # heavy, and wanted by commands that compute only

    announced = mmap.mmap(-1, 1)  # forked processes share it

    class Listener(event.Listener):  # type: ignore[misc]  # numba is untyped here
        """Announces the first compilation; machine code that is read from the cache is not compiled."""

        def on_start(self, event: Any) -> None:
            if not announced[0]:
                announced[0] = 1
                click.echo(f"streamkit: {SENTENCE}", err=True)

        def on_end(self, event: Any) -> None:
            pass

    listener = Listener()
    event.register("numba:compile", listener)
    click.get_current_context().find_root().call_on_close(lambda: event.unregister("numba:compile", listener))
