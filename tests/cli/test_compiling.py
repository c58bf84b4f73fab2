"""The sentence that stands for a minute of silence."""

from __future__ import annotations

from pathlib import Path

import click
from click.testing import CliRunner
from numba import njit
from numba.core import event

from streamkit.cli.compiling import SENTENCE, announce_compilation
from streamkit.cli.options import QUIET, load_spec


def test_what_is_compiled_is_told_once_and_only_during_the_command(run_file: Path) -> None:
    @click.command()
    @QUIET
    def compiles(quiet: bool) -> None:
        load_spec(run_file)
        for power in (2, 3):
            njit(lambda x, power=power: x**power)(2.0)

    runner = CliRunner()
    assert runner.invoke(compiles).stderr == f"streamkit: {SENTENCE}\n"
    assert runner.invoke(compiles, ["-q"]).stderr == ""
    assert not event._registered["numba:compile"]


def test_nothing_is_told_where_nothing_is_compiled() -> None:
    done = CliRunner().invoke(click.command()(announce_compilation))
    assert (done.exit_code, done.stderr) == (0, "")
