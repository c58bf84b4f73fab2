"""The tutorials run from their first line; by day with few particles and steps, in the slow tests as a fit."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "examples" / "tutorials"
SCRIPTS = sorted(FOLDER.glob("*.py"))
NEEDS = {"from_gala_galpy_agama": ("streamkit_gala", "streamkit_galpy")}


def run(script: Path, folder: Path, **more: str) -> str:
    """Run a copy in a folder of its own, with the commands of this environment."""
    for module in NEEDS.get(script.stem, ()):
        pytest.importorskip(module)
    for file in (script, *FOLDER.glob("*.ecsv")):
        shutil.copy(file, folder)
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"} | more
    environment["MPLBACKEND"] = "agg"
    command = [sys.executable, script.name]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_tutorial_runs(script: Path, tmp_path: Path) -> None:
    text = run(script, tmp_path)
    assert text
    assert not re.search(r"[+-]nan", text), text


@pytest.mark.slow
def test_the_fit_of_ones_own_stream_converges(tmp_path: Path) -> None:
    text = run(FOLDER / "my_stream.py", tmp_path, FULL="1")
    assert "converged: True" in text


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_tutorial_is_a_notebook_too(script: Path) -> None:
    """Cells in jupytext's percent format: a title first, and text before code."""
    lines = script.read_text(encoding="utf-8").splitlines()
    assert lines[0] == "# %% [markdown]"
    assert lines[1].startswith("# # ")
    assert lines.count("# %%") >= 2
