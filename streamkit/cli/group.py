"""The group of commands, streamkit's and those of other packages. Each reports an error as one paragraph.

A package brings a command by an entry point of the group ``streamkit.commands``: its name, and a click command::

    [project.entry-points."streamkit.commands"]
    nbody = "streamkit_nbody.cli:nbody"
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import click

from streamkit import components
from streamkit.cli.options import INTERRUPTED, INVALID
from streamkit.cli.process import collect_rarely, keep_streams, leave
from streamkit.distribution import foreign_files
from streamkit.errors import PluginError, StreamkitError, message_of, nearest, printable

GROUP = "streamkit.commands"
PLAIN = {"integer": "a whole number", "float": "a number"}  # click's words for the values of options
# Commands by the words of other programs, whose spelling is too different for a search of similar names.
MEANT = {
    "fit": "run", "sample": "run", "mcmc": "run", "resume": "run", "quick": "run", "validate": "check", "test": "check",
    "simulate": "stream", "make": "stream", "plot": "stream", "track": "stream", "compare": "ablate", "mass": "host",
    "potential": "host", "progress": "status", "results": "report", "page": "report", "save": "export",
    "bibtex": "cite", "help": "reference", "list": "plugins", "template": "init", "example": "init",
}  # fmt: skip


class PluginCommand(click.Command):
    """A command of another package, which is imported when the command or its help is called."""

    def __init__(self, name: str, points: Sequence[EntryPoint]) -> None:
        super().__init__(name)
        self._points = points

    def get_short_help_str(self, limit: int = 45) -> str:
        """Return the summary of the package, so that a list of commands imports no package."""
        dist = self._points[0].dist
        return f"{dist.metadata['Summary']} ({dist.name})" if dist else ""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """Make the context of the command itself."""
        return self._load().make_context(info_name, args, parent, **extra)

    def _load(self) -> click.Command:
        suppliers = [f"{point.dist.name} {point.dist.version}" if point.dist else point.value for point in self._points]
        if len(suppliers) > 1:
            raise PluginError(
                f"the command {self.name!r} comes from two packages, {' and '.join(sorted(suppliers))}: "
                "uninstall one of them"
            )
        try:
            command = self._points[0].load()
        except (Exception, SystemExit) as error:
            reason = f"{type(error).__name__}: {message_of(error)}"
            raise PluginError(f"the command {self.name!r} of {suppliers[0]} cannot be imported ({reason})") from error
        if not isinstance(command, click.Command):
            raise PluginError(f"the command {self.name!r} of {suppliers[0]} is no click command: {command!r}")
        return command


class Commands(click.Group):
    """The group: an error that is explained, or a wrong argument, is one paragraph and status 2.

    Its own commands come before those of other packages, in the list and where two have one name.
    """

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
        alone = args is None  # the process is this command's
        if alone:
            keep_streams()
            collect_rarely()
        try:
            status = super().main(args, prog_name, complete_var, standalone_mode=False, **extra)
        except StreamkitError as error:
            status = _failed(str(error), getattr(error, "exit_status", INVALID))  # an interrupted run brings its own
        except click.ClickException as error:
            status = _failed(_explain(error), INVALID)
        except OSError as error:  # no permission, a full disk, a directory where a file should be
            where = f"{error.filename}: " if error.filename else ""
            status = _failed(f"{where}cannot be read or written: {error.strerror or error}", INVALID)
        except click.Abort:
            status = _failed("interrupted", INTERRUPTED)
        except (ImportError, AttributeError):
            if not foreign_files():
                raise
            status = INVALID  # a module of this package belongs to another project: the sentence below says so
        if sentence := foreign_files():
            _failed(sentence, INVALID)
        status = status if isinstance(status, int) else 0
        if alone:
            leave(status)
        sys.exit(status)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names: its own commands, then those of other packages."""
        return [*super().list_commands(ctx), *sorted({point.name for point in _points()} - self.commands.keys())]

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """Find a command; name the nearest one if there is none."""
        command = super().get_command(ctx, name)
        if command is None and (points := [point for point in _points() if point.name == name]):
            command = PluginCommand(name, points)
        if command is None and not ctx.resilient_parsing:
            names = self.list_commands(ctx)
            meant = MEANT.get(name.lower())
            guess = f" Did you mean {meant!r}?" if meant else nearest(name, names)
            hint = components.where_to_find(name) or guess
            raise click.UsageError(f"no command is called {name!r}.{hint} Known: {', '.join(names)}", ctx)
        return command


def _points() -> list[EntryPoint]:
    """Return the entry points of commands, but for those that are switched off by name."""
    off = components.switched_off()
    return [point for point in entry_points(group=GROUP) if point.name not in off]


def _failed(message: str, status: int) -> int:
    with suppress(OSError, ValueError):  # standard error is closed: only the exit status is left
        lines = [printable(line) for line in message.split("\n")]  # it may quote a file that came from elsewhere
        click.echo("streamkit: " + "\n".join(lines), err=True)
    return status


def _explain(error: click.ClickException) -> str:
    message = error.format_message()
    message = message[:1].lower() + message[1:]
    message = re.sub(r"a valid (integer|float)( range)?", lambda kind: PLAIN[kind[1]], message)
    if isinstance(error, click.UsageError) and error.ctx is not None:
        end = "" if message.endswith("?") else "."
        message = f"{message.rstrip('.')}{end} See '{error.ctx.command_path} --help'."
    return message
