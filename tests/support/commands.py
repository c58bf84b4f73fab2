"""The command line in this process."""

from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner, Result

from streamkit.cli.main import main


def call(*args: str | Path) -> Result:
    """Run the command in this process; anything but a clean exit is a bug and comes through."""
    result = CliRunner().invoke(main, [str(arg) for arg in args], prog_name="streamkit")
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def refused(*args: str | Path) -> str:
    """Run a command that must be refused, and return its one paragraph."""
    result = call(*args)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("streamkit: ")
    assert "Traceback" not in result.stderr
    assert "\n\n" not in result.stderr
    return result.stderr
