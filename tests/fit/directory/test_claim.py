"""Directories of runs that came from elsewhere: their code is not run unasked, and changed data are told."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from commands import call, refused
from runfiles import FIT

import streamkit as sk
from streamkit.runfile import to_toml

PLUGIN = """
from streamkit import hookimpl

@hookimpl
def streamkit_components():
    return []
"""
TRAP = """
from pathlib import Path
Path(__file__).with_name("executed").touch()
"""
CURVE = """
[data.curve]
kind = "rotation_curve"
table = { file = "curve.csv", units = { R = "kpc", v_c = "km/s", error = "km/s" } }
"""
ROWS = "R,v_c,error\n10,210,9\n50,200,9\n"


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of one step with a plugin file and a data file."""
    folder = tmp_path_factory.mktemp("kept")
    (folder / "mine.py").write_text(PLUGIN)
    (folder / "curve.csv").write_text(ROWS)
    (folder / "run.toml").write_text(f'plugins = ["mine.py"]\n{to_toml(FIT)}{CURVE}')
    sk.run(folder / "run.toml", folder / "out", steps=1, progress=False, products=False)
    return folder / "out"


@pytest.fixture
def directory(kept: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(kept, tmp_path / "out"))


def test_code_in_a_directory_runs_only_when_it_is_asked_for(directory: Path) -> None:
    plugin = directory / "plugins" / "mine.py"  # it has no component in the run, so that it is not in its digest
    plugin.write_text(PLUGIN + TRAP)
    for args in (["report"], ["status"], ["export", "-o", directory / "s.csv"], ["cite"]):
        message = refused(args[0], directory, *args[1:])
        assert "run.toml: names the plugin file 'plugins/mine.py'" in message
        assert "--trust" in message
    with pytest.raises(sk.ChainError, match="trust=True"):
        sk.load_results(directory)
    assert not plugin.with_name("executed").exists()
    assert call("cite", directory, "--trust").exit_code == 0
    assert plugin.with_name("executed").exists()


def test_code_that_the_user_named_before_is_no_strangers(directory: Path) -> None:
    """The process that ran a fit may read its results."""
    assert len(sk.load_results(directory).chain) == 1


def test_a_changed_copy_of_a_data_file_is_told(directory: Path) -> None:
    (directory / "data" / "curve.csv").write_text(ROWS.replace("210", "211"))
    message = refused("report", directory)
    assert "data/curve.csv: has changed since the run began" in message
