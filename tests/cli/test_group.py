"""Commands that other packages bring: listed without an import, called like our own, and never in their way."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from commands import call, refused
from laid import lay

from streamkit.cli.main import main

COMMAND = '''
import click
from streamkit.errors import StreamkitError

@click.command()
@click.argument("angle", type=int)
def tilt(angle):
    """Tilt the disc."""
    if angle > 90:
        raise StreamkitError(f"{angle} degrees are not a tilt")
    click.echo(f"tilted by {angle}")
'''
Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Lay a distribution with a command on the path as pip would."""
    monkeypatch.syspath_prepend(tmp_path)

    def install(distribution: str, name: str, module: str, body: str = COMMAND, attribute: str = "tilt") -> None:
        (tmp_path / f"{module}.py").write_text(body)
        points = f"[streamkit.commands]\n{name} = {module}:{attribute}\n"
        lay(tmp_path, distribution, points, metadata="Summary: Tilts discs.\n")

    return install


def test_the_list_names_it_and_imports_nothing(install: Install) -> None:
    install("streamkit-tilt", "tilt", "command_listed")
    listing = call("--help").stdout
    assert "\n  tilt         Tilts discs. (streamkit-tilt)\n" in listing
    assert listing.index("\n  stream ") < listing.index("\n  tilt ")
    assert "command_listed" not in sys.modules


@pytest.mark.parametrize(("typed", "meant"), [("fit", "run"), ("mcmc", "run"), ("plot", "stream"), ("stats", "status")])
def test_words_of_other_programs_are_understood(typed: str, meant: str) -> None:
    assert f"Did you mean {meant!r}?" in refused(typed, "run.toml")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--draw", "3"], "no such option '--draw'. Did you mean '--draws'? See 'streamkit check --help'."),
        (["--draws", "1e3"], "'1e3' is not a whole number. See"),
    ],
)
def test_a_wrong_option_is_told_in_plain_sentences(words: list[str], told: str) -> None:
    assert told in refused("check", "run.toml", *words)


def test_it_is_called_like_our_own(install: Install) -> None:
    install("streamkit-tilt", "tilt", "command_called")
    assert call("tilt", "30").stdout == "tilted by 30\n"
    text = call("tilt", "-h").stdout
    assert text.startswith("Usage: streamkit tilt [OPTIONS] ANGLE")
    assert "Tilt the disc." in text
    assert "steep" in refused("tilt", "steep")
    assert refused("tilt", "100") == "streamkit: 100 degrees are not a tilt\n"
    assert "no command is called 'tild'. Did you mean 'tilt'?" in refused("tild")


@pytest.mark.parametrize(
    ("body", "attribute", "reason"),
    [
        ("import agama_of_the_future", "tilt", "cannot be imported (ModuleNotFoundError: No module named 'agama_"),
        ("raise SystemExit('no licence')", "tilt", "cannot be imported (SystemExit: no licence)"),
        (COMMAND, "tild", "cannot be imported (AttributeError: "),
        ("tilt = 3", "tilt", "is no click command: 3"),
    ],
)
def test_one_that_fails_is_named_and_costs_no_other(
    install: Install, body: str, attribute: str, reason: str, request: pytest.FixtureRequest
) -> None:
    install("streamkit-tilt", "tilt", f"command_broken{abs(hash(request.node.name))}", body, attribute)
    for arguments in (["tilt", "3"], ["tilt", "--help"]):
        assert f"the command 'tilt' of streamkit-tilt 1.2 {reason}" in refused(*arguments)
    assert "  tilt " in call("--help").stdout
    assert call("plugins", "potential", "nfw").exit_code == 0


def test_a_built_in_command_wins(install: Install) -> None:
    install("streamkit-tilt", "check", "command_clash")
    assert call("--help").stdout.count("\n  check ") == 1
    assert "Tilt the disc" not in call("check", "--help").stdout
    assert "command_clash" not in sys.modules


def test_two_packages_with_one_command(install: Install) -> None:
    install("streamkit-one", "tilt", "command_one")
    install("streamkit-two", "tilt", "command_two")
    assert call("--help").stdout.count("\n  tilt ") == 1
    assert (
        "the command 'tilt' comes from two packages, streamkit-one 1.2 and streamkit-two 1.2: uninstall one"
        in refused("tilt", "3")
    )
    assert call("plugins", "potential", "nfw").exit_code == 0


def test_another_interpreter_finds_it_too(install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install("streamkit-tilt", "tilt", "command_apart")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    done = subprocess.run([sys.executable, "-m", "streamkit", "tilt", "200"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "streamkit: 200 degrees are not a tilt\n")


def test_completion_knows_it(install: Install) -> None:
    from click.shell_completion import ShellComplete

    install("streamkit-tilt", "tilt", "command_completed")
    found = ShellComplete(main, {}, "streamkit", "_STREAMKIT_COMPLETE").get_completions([], "ti")
    assert [item.value for item in found] == ["tilt"]


def test_one_can_be_switched_off(install: Install, monkeypatch: pytest.MonkeyPatch) -> None:
    install("streamkit-tilt", "tilt", "command_off")
    monkeypatch.setenv("STREAMKIT_DISABLE_PLUGINS", "other, tilt")
    assert "tilt" not in call("--help").stdout
    assert "no command is called 'tilt'" in refused("tilt", "3")
    monkeypatch.setenv("STREAMKIT_DISABLE_PLUGINS", "nbody")
    told = "no command is called 'nbody'. 'nbody' is in streamkit-nbody: pip install streamkit-nbody"
    assert told in refused("nbody")
    assert call("tilt", "30").stdout == "tilted by 30\n"
