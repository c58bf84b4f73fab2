"""``streamkit new``: every package that it writes installs, and passes its own test as it is written."""

from __future__ import annotations

import errno
import importlib.util
import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from commands import call, refused

import streamkit
from streamkit.cli.new import ROLES

QUICK = ("potential", "stripping", "data")  # roles whose check takes a second
HERE = str(Path(streamkit.__file__).parent.parent)


def test_there_is_one_for_every_role() -> None:
    told = refused("new", "galaxy", "mine")
    assert {"potential", "stripping", "integrator", "observable"} <= set(ROLES)
    for role in ROLES:
        assert repr(role) in told


@pytest.mark.parametrize(
    "role", [pytest.param(role, marks=() if role in QUICK else pytest.mark.slow) for role in ROLES]
)
def test_it_passes_its_own_test(role: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process, whose imports are made."""
    monkeypatch.chdir(tmp_path)
    out = call("new", role, f"my_{role}").stdout
    package = tmp_path / f"streamkit-my-{role}"
    names = {"pyproject.toml", f"streamkit_my_{role}.py", f"test_my_{role}.py", "README.md"}
    assert {file.name for file in package.iterdir()} == names
    assert f"pip install -e streamkit-my-{role} pytest" in out
    monkeypatch.syspath_prepend(package)
    (test,) = (
        value for name, value in runpy.run_path(str(package / f"test_my_{role}.py")).items() if name.startswith("test_")
    )
    test()


@pytest.mark.parametrize(("role", "section"), [("potential", "[potential]"), ("data", "[data.my_own]")])
def test_the_section_of_a_run_file_and_the_manual_are_named(
    role: str, section: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert f'In a run file: {section} with kind = "my_own"' in call("new", role, "my_own").stdout
    text = (tmp_path / "streamkit-my-own" / "README.md").read_text()
    assert f'kind = "my_own"` in `{section}`' in text
    assert "plugins/README.md" in text


def test_a_full_disk_leaves_no_part_of_a_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))  # as `write` has it, without the name of the file

    monkeypatch.setattr(Path, "write_text", full)
    message = refused("new", "potential", "my_own", "-o", tmp_path / "package")
    assert f"{tmp_path / 'package'}: cannot be written (No space left on device)" in message
    assert not (tmp_path / "package").exists()


def test_a_potential_takes_less_than_forty_lines(tmp_path: Path) -> None:
    call("new", "potential", "short", "-o", tmp_path / "deep" / "short")
    files = list((tmp_path / "deep" / "short").iterdir())
    assert len(files) == 4
    assert sum(len(file.read_text().splitlines()) for file in files) < 40


def test_pip_installs_it_and_a_run_file_finds_it(tmp_path: Path) -> None:
    call("new", "potential", "installed", "-o", tmp_path / "package")
    install = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--disable-pip-version-check"]
    if importlib.util.find_spec("hatchling"):  # else pip fetches it for the build
        install.append("--no-build-isolation")
    done = subprocess.run(
        [*install, "--target", tmp_path / "site", tmp_path / "package"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([HERE, str(tmp_path / "site")])}
    command = [sys.executable, "-m", "streamkit", "plugins", "potential", "installed"]
    listing = subprocess.run(command, env=environment, capture_output=True, text=True).stdout
    assert listing.startswith("potential installed, from streamkit-installed 0.1\n")


@pytest.mark.parametrize(
    ("name", "told"),
    [
        (
            "My-Halo",
            "'My-Halo' cannot be the name of a component: allowed are lower-case letters, digits and underscores",
        ),
        ("My-Halo", "Perhaps 'my_halo'?"),
        ("MyHalo", "Perhaps 'my_halo'?"),
        ("2halos", "a letter first. Perhaps 'halos'?"),
        ("../halo", "Perhaps 'halo'?"),
        ("é", "cannot be the name"),
        ("potential", "the class would be called Potential, which is a name in Python or streamkit"),
        ("true", "the class would be called True"),
        ("plummer", f"streamkit {streamkit.__version__} has a potential of this name"),
    ],
)
def test_names_that_cannot_be(name: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert told in refused("new", "potential", name)
    assert not list(tmp_path.iterdir())


def test_a_directory_that_exists_is_left_alone(tmp_path: Path) -> None:
    told = refused("new", "potential", "mine", "-o", tmp_path)
    assert f"{tmp_path}: exists already; nothing was changed" in told
    assert not list(tmp_path.iterdir())
