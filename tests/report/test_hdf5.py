"""Files of HDF5 with the right checksum that refer to other files, or claim a size that they cannot have."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from forging import forging

from streamkit.report import BLOCK, DamagedError, read_own, write_own

SECRET = np.arange(5.0)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file of ours, beside one of the user's."""
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["x"] = SECRET
    (tmp_path / "secret.bin").write_bytes(SECRET.tobytes())
    with h5py.File(tmp_path / "made.h5", "w", userblock_size=BLOCK) as file:
        file["group/x"] = np.zeros(5)
        file["packed"] = np.zeros(3)
    write_own(tmp_path / "own.h5", (tmp_path / "made.h5").read_bytes())
    return tmp_path / "own.h5"


def x(file: h5py.File) -> float:
    return float(file["group/x"][...].sum())


def external_storage(file: h5py.File, folder: Path) -> None:
    del file["group/x"]
    file.create_dataset("group/x", (5,), "f8", external=[(str(folder / "secret.bin"), 0, h5py.h5f.UNLIMITED)])


def virtual(file: h5py.File, folder: Path) -> None:
    layout = h5py.VirtualLayout((5,), "f8")
    layout[:] = h5py.VirtualSource(str(folder / "secret.h5"), "x", shape=(5,))
    del file["group/x"]
    file.create_virtual_dataset("group/x", layout)


def external_link(file: h5py.File, folder: Path) -> None:
    del file["group/x"]
    file["group/x"] = h5py.ExternalLink(str(folder / "secret.h5"), "x")


def external_group(file: h5py.File, folder: Path) -> None:
    del file["group"]
    file["group"] = h5py.ExternalLink(str(folder / "secret.h5"), "/")


def soft_link(file: h5py.File, folder: Path) -> None:
    del file["group/x"]
    file["group/x"] = h5py.SoftLink("/packed")


def broken_link(file: h5py.File, folder: Path) -> None:
    file["other"] = h5py.SoftLink("/nowhere")


def huge(file: h5py.File, folder: Path) -> None:
    del file["group/x"]
    file.create_dataset("group/x", (10**9, 1000), "f8", chunks=(100, 100), compression="gzip")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (external_storage, "the data of group/x are in another file"),
        (virtual, "the data of group/x are in another file"),
        (external_link, "group/x is a link to somewhere else"),
        (external_group, "group is a link to somewhere else"),
        (soft_link, "group/x is a link to somewhere else"),
        (broken_link, "other is a link to somewhere else"),
        (huge, "group/x claims to hold 8000000000000 bytes"),
    ],
)
def test_a_file_that_is_not_all_is_refused(
    path: Path, change: Callable[[h5py.File, Path], None], reason: str
) -> None:
    with forging(path) as file:
        change(file, path.parent)
    with pytest.raises(DamagedError, match=reason):
        read_own(path, x)


def test_a_group_inside_itself_comes_to_an_end(path: Path) -> None:
    with forging(path) as file:
        file["group/again"] = file["group"]
    assert read_own(path, x) == 0.0


def test_the_densest_data_of_gzip_are_read(path: Path) -> None:
    with forging(path) as file:
        file.create_dataset("zeros", data=np.zeros(10**7), chunks=(10**6,), compression="gzip", compression_opts=9)
    assert path.stat().st_size < 8 * 10**7 / 500
    assert read_own(path, lambda file: len(file["zeros"])) == 10**7
