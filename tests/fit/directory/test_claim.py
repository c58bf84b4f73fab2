"""Directories of runs that came from elsewhere: their code is not run unasked, and changed data are told."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
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
    (folder / "inner.csv").write_text(ROWS.replace("50", "5"))
    more = CURVE + CURVE.replace("curve.csv", "inner.csv").replace("data.curve", "data.inner")
    (folder / "run.toml").write_text(f'plugins = ["mine.py"]\n{to_toml(FIT)}{more}')
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


ELSEWHERE = """
import sys
from commands import call
for command in (["cite"], ["status"], ["report"], ["export", "-o", sys.argv[2]], ["host"]):
    result = call(command[0], sys.argv[1], *command[1:])
    assert result.exit_code == 2, result.output
    print(result.stderr.replace("\\n", " "))
"""


def test_code_in_a_directory_does_not_run_by_a_letter_that_the_locale_lacks(directory: Path) -> None:
    """The run file is read in UTF-8 in any locale, where the code is looked for too."""
    run_file, plugin = directory / "run.toml", directory / "plugins" / "mine.py"
    run_file.write_bytes("# \u00c1\n".encode() + run_file.read_bytes())
    plugin.write_text(PLUGIN + TRAP)
    ascii_only = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    paths = os.pathsep.join(sys.path)
    done = subprocess.run(
        [sys.executable, "-c", ELSEWHERE, directory, directory / "s.csv"],
        capture_output=True, text=True, env={**os.environ, **ascii_only, "PYTHONPATH": paths},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert not plugin.with_name("executed").exists()
    assert done.stdout.count("names the plugin file 'plugins/mine.py'") == 5


@pytest.mark.parametrize("name", ["run.toml", "manifest.json"])
def test_a_file_in_another_encoding_is_refused(directory: Path, name: str) -> None:
    plugin = directory / "plugins" / "mine.py"
    plugin.write_text(PLUGIN + TRAP)
    for encoding in ("utf-16", "utf-32", "latin-1"):
        text = (directory / name).read_bytes().decode()
        (directory / name).write_bytes(f"{text} # \u00c1".encode(encoding))
        for args in (["report"], ["status"], ["export", "-o", directory / "s.csv"], ["cite"]):
            assert name in refused(args[0], directory, *args[1:])
        (directory / name).write_bytes(text.encode())
    assert not plugin.with_name("executed").exists()


def test_exchanged_copies_of_data_files_are_told(directory: Path) -> None:
    """Each file is one of the run's, and none is in its own place."""
    one, two = directory / "data" / "curve.csv", directory / "data" / "inner.csv"
    first, second = one.read_bytes(), two.read_bytes()
    one.write_bytes(second)
    two.write_bytes(first)
    for args in (["report"], ["status"], ["export", "-o", directory / "s.csv"], ["cite"]):
        assert "data/curve.csv: has changed since the run began" in refused(args[0], directory, "--trust", *args[1:])
    with pytest.raises(sk.ChainError, match=r"What differs \(there -> here\): the data file data/curve\.csv; "):
        sk.run(directory / "run.toml", directory, resume=True, progress=False)
