"""The tutorials run from their first line: the short one always, the others and a whole fit in the slow tests."""

from __future__ import annotations

import re
import runpy
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from commands import call

FOLDER = Path(__file__).parents[2] / "examples" / "tutorials"
SCRIPTS = sorted(FOLDER.glob("*.py"))
NEEDS = {
    "from_gala_galpy_agama": ("streamkit_gala", "streamkit_galpy"),
    "neural_posterior": ("streamkit_simulate", "sbi"),
}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with the data, where the commands of tutorials run in this process."""
    for file in FOLDER.glob("*.ecsv"):
        shutil.copy(file, tmp_path)
    monkeypatch.chdir(tmp_path)

    start = subprocess.run

    def run(command: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
        if command[0] != "streamkit":
            return start(command, **options)
        result = call(*command[1:])
        assert result.exit_code == 0, result.output
        return subprocess.CompletedProcess(command, 0, result.stdout, result.stderr)

    monkeypatch.setattr(subprocess, "run", run)
    return tmp_path


@pytest.mark.usefixtures("place", "short_check")
@pytest.mark.parametrize(
    "script",
    [
        pytest.param(path, id=path.stem, marks=() if path.stem == "my_own_potential" else pytest.mark.slow)
        for path in SCRIPTS
    ],
)
def test_a_tutorial_runs(script: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for module in NEEDS.get(script.stem, ()):
        pytest.importorskip(module)
    runpy.run_path(str(script), run_name="__main__")
    text = capsys.readouterr().out
    assert text
    assert not re.search(r"[+-]nan", text), text
    shown = re.findall(r"^# !\[.+\]\((.+)\)$", script.read_text(encoding="utf-8"), re.MULTILINE)
    assert shown
    assert [name for name in shown if not Path(name).is_file()] == []


@pytest.mark.slow
@pytest.mark.usefixtures("place")
def test_the_fit_of_ones_own_stream_converges(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FULL", "1")
    runpy.run_path(str(FOLDER / "my_stream.py"), run_name="__main__")
    assert "converged: True" in capsys.readouterr().out


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_tutorial_is_a_notebook_too(script: Path) -> None:
    """Cells in jupytext's percent format: a title first, and text before code."""
    lines = script.read_text(encoding="utf-8").splitlines()
    assert lines[0] == "# %% [markdown]"
    assert lines[1].startswith("# # ")
    assert lines.count("# %%") >= 2
