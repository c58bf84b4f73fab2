"""A disk that fills when a run has ended: the products that are missing are an error, and the samples are whole."""

from __future__ import annotations

import errno
import os
import zipfile
from pathlib import Path

import pytest
from commands import refused

import streamkit as sk
from streamkit.report import files

ARCHIVE = Path(__file__).parents[2] / "data" / "runs_0.1.0.zip"


def test_a_report_without_room_for_its_pictures_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with zipfile.ZipFile(ARCHIVE) as archive:
        archive.extractall(tmp_path)
    to_disk = files.to_disk

    def full(path: Path) -> None:
        if path.suffix in (".png", ".html"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        to_disk(path)

    monkeypatch.setattr(files, "to_disk", full)
    message = refused("report", tmp_path / "chain", "--trust", "-q")
    assert "cannot be written (No space left on device), and " in message
    assert f"streamkit report {tmp_path / 'chain'}" in message.replace("\n", " ")
    names = {path.name for path in (tmp_path / "chain").iterdir()}
    assert "summary.ecsv" in names
    assert not any(name.endswith((".png", ".html")) for name in names)
    assert len(sk.load_results(tmp_path / "chain", trust=True).chain) == 11
