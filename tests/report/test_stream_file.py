"""Streams as files: a full disk is one sentence, and names of other alphabets stay in the header."""

from __future__ import annotations

import errno
import os
import warnings
from pathlib import Path

import pytest
from astropy.table import QTable
from runfiles import FIT

import streamkit as sk
from streamkit.report import write_stream


@pytest.fixture(scope="module")
def made() -> tuple[sk.Stream, sk.Spec]:
    spec = sk.load(FIT)
    return sk.Model(spec).stream(), spec


def test_a_full_disk_is_one_sentence(
    made: tuple[sk.Stream, sk.Spec], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """HDF5 itself is never there: it would end the process."""

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    write_stream(*made, tmp_path / "good.hdf5")
    good = QTable.read(tmp_path / "good.hdf5", path="stream")
    assert (len(good), str(good["x"].unit), good.meta["run_digest"]) == (100, "kpc", made[1].digest())
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(sk.StreamkitError, match=r"full\.hdf5': cannot be written \(No space left on device\)$"):
        write_stream(*made, tmp_path / "full.hdf5")


def test_a_name_that_is_not_ascii_is_written_to_fits(made: tuple[sk.Stream, sk.Spec], tmp_path: Path) -> None:
    stream, spec = made
    object.__setattr__(spec, "source", "Ströme/é.toml")
    with warnings.catch_warnings(action="error"):
        write_stream(stream, spec, tmp_path / "x.fits")
    assert QTable.read(tmp_path / "x.fits").meta["RUN_FILE"] == r"\xe9.toml"
