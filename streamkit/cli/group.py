"""The group of commands: an error that streamkit explains, or a wrong argument, is one paragraph."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import click

from streamkit.cli.options import INTERRUPTED, INVALID
from streamkit.errors import StreamkitError, nearest


class Commands(click.Group):
    """The group: an error that streamkit explains, or a wrong argument, is one paragraph and status 2."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Run a command and leave the process with its status."""
        if not standalone_mode:
            return super().main(args, prog_name, complete_var, standalone_mode=False, **extra)
        try:
            status = super().main(args, prog_name, complete_var, standalone_mode=False, **extra)
        except StreamkitError as error:
            _fail(str(error), getattr(error, "exit_status", INVALID))  # an interrupted run brings its own
        except click.ClickException as error:
            _fail(_explain(error), INVALID)
        except OSError as error:  # no permission, a full disk, a directory where a file should be
            where = f"{error.filename}: " if error.filename else ""
            _fail(f"{where}cannot be read or written: {error.strerror or error}", INVALID)
        except click.Abort:
            _fail("interrupted", INTERRUPTED)
        sys.exit(status if isinstance(status, int) else 0)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """Find a command; name the nearest one if there is none."""
        command = super().get_command(ctx, name)
        if command is None and not ctx.resilient_parsing:
            known = self.list_commands(ctx)
            raise click.UsageError(
                f"no command is called {name!r}.{nearest(name, known)} Known: {', '.join(known)}", ctx
            )
        return command


def _fail(message: str, status: int) -> None:
    click.echo(f"streamkit: {message}", err=True)
    sys.exit(status)


def _explain(error: click.ClickException) -> str:
    message = error.format_message()
    message = message[:1].lower() + message[1:]
    if isinstance(error, click.UsageError) and error.ctx is not None:
        message = f"{message.rstrip('.')}. See '{error.ctx.command_path} --help'."
    return message
