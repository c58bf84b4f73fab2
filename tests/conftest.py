"""Fixtures for all tests."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import RUN

collect_ignore = ["third_party"]  # a package of its own: test_third_party.py installs it and runs its test


@pytest.fixture(autouse=True)
def hundred_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Text is as wide as the terminal, of which a test process may have any."""
    monkeypatch.setenv("COLUMNS", "100")


@pytest.fixture
def run_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small run file, alone in the working directory."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "small.toml"
    path.write_text(RUN)
    return path
