"""The programs of tests/benchmarks start, and the table of faults can be made: one run is killed, and resumed."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.parametrize("program", sorted(FOLDER.glob("*.py")), ids=lambda path: path.stem)
def test_it_describes_itself(program: Path, capsys, monkeypatch) -> None:
    monkeypatch.setattr(sys, "argv", [str(program), "--help"])
    monkeypatch.setattr(sys, "path", [str(FOLDER), *sys.path])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(program), run_name="__main__")
    assert end.value.code == 0
    assert "options:" in capsys.readouterr().out


@pytest.mark.slow  # tests/fit/test_runner.py kills a run, and tests/sample/store/test_chain_file.py resumes one
def test_a_killed_run_is_resumed_to_the_same_samples(tmp_path) -> None:
    command = [sys.executable, FOLDER / "faults.py", "--tries", "1", "--only", "kill"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "| killed (SIGKILL) | 1 | 0 | 0 | 0 | 1 of 1 |" in done.stdout
