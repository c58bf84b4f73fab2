"""Damaged and hostile snapshots: one sentence each, soon, and nothing that is read is executed."""

from __future__ import annotations

import pickle
import time
import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from snapshot_files import write_gadget, write_table

from streamkit.nbody import read_snapshot
from streamkit.nbody.snapshot import SnapshotError


class Trap:
    """Creates a file when it is unpickled."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def __reduce__(self) -> Any:
        return Path.touch, (self.place,)


def refused(path: Path | str) -> str:
    begin = time.process_time()
    with pytest.raises(SnapshotError) as caught:
        read_snapshot(path)
    assert time.process_time() - begin < 2
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(path).partition(":PartType")[0])
    return str(caught.value)


@pytest.mark.parametrize("whole", [True, False], ids=["a pickle", "an array of objects"])
def test_no_pickle_is_executed(tmp_path: Path, whole: bool) -> None:
    path, trap = tmp_path / "a.npz", tmp_path / "executed"
    if whole:
        path.write_bytes(pickle.dumps(Trap(trap)))
    else:
        write_table(path, x=np.array([Trap(trap)] * 3, dtype=object))
    refused(path)
    assert not trap.exists()


@pytest.mark.parametrize(
    ("changes", "wanted"),
    [
        ({"x": ["a", "b", "c"]}, "x: holds no numbers"),
        ({"vx": [1j, 2j, 3j]}, "vx: holds no numbers"),
        ({"x": 3.0}, "expected one number per particle"),
        ({"orbit_txv": None, "prog_xv": [1.0, 2.0]}, "prog_xv: expected 6 numbers, found 2"),
        ({"orbit_txv": 3.0}, "orbit_txv: expected time, position and velocity"),
        ({"meta": "[1, 2]"}, "does not state its units"),
        ({"meta": '{"units": "kpc, km/s, Gyr", "t_gyr": NaN}'}, "does not say the time"),
        ({"x": [np.inf, 1.0, 2.0]}, "not finite"),
    ],
)
def test_wrong_tables(tmp_path: Path, changes: dict[str, Any], wanted: str) -> None:
    assert wanted in refused(write_table(tmp_path / "a.npz", **changes))


def test_an_array_larger_than_its_file(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_table(path)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content.replace(b"(3,)", b"(9000000000000,)") if name == "x.npy" else content)
    refused(path)


def test_an_archive_whose_names_are_damaged_is_not_quoted(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_table(path)
    content = bytearray(path.read_bytes())
    content[26:28] = (500).to_bytes(2, "little")  # the length of the first member's name
    path.write_bytes(content)
    assert len(refused(path)) < 300 + len(str(path))


def fault(name: str, file: h5py.File) -> None:
    """Change a good snapshot."""
    particles = file["PartType1"]
    if name == "huge":
        del particles["Coordinates"]
        particles.create_dataset("Coordinates", (10**10, 3), dtype=float, chunks=(1000, 3))
    elif name == "link":
        del particles["Coordinates"]
        particles["Coordinates"] = h5py.ExternalLink("/dev/zero", "/x")
    elif name == "raw":
        del particles["Coordinates"]
        particles.create_dataset("Coordinates", (3, 3), dtype=float, external=[("/etc/passwd", 0, 72)])
    elif name == "loop":
        del particles["Coordinates"]
        particles["Coordinates"] = h5py.SoftLink("/PartType1/Coordinates")
    elif name == "group":
        del particles["Coordinates"]
        particles.create_group("Coordinates")
    elif name == "text":
        del particles["Winding"]
        particles["Winding"] = np.array([b"a", b"b", b"c"])
    elif name == "no group":
        del file["PartType1"]
        file["PartType1"] = 3.0
    elif name == "track":
        del file["Progenitor"]
        file["Progenitor"] = 3.0
    elif name == "unit":
        file["Units"].attrs["UnitLength_in_cm"] = "cm"
    elif name == "time":
        file["Header"].attrs["Time"] = np.empty(0)


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("huge", "Coordinates: claims the shape (10000000000, 3)"),
        ("link", ""),
        ("raw", "is in another file"),
        ("loop", ""),
        ("group", "Coordinates: holds no numbers"),
        ("text", "Winding: holds no numbers"),
        ("no group", "PartType1: expected a group"),
        ("track", "Progenitor: expected a group"),
        ("unit", "the unit of length: expected a number, found 'cm'"),
        ("time", "Time: expected a number, found '[]'"),
    ],
)
def test_wrong_hdf5(tmp_path: Path, name: str, wanted: str) -> None:
    path = write_gadget(tmp_path / "a.hdf5")
    with h5py.File(path, "r+") as file:
        fault(name, file)
    assert wanted in refused(path)


@pytest.mark.parametrize("suffix", [".npz", ".hdf5"])
def test_damaged_files(tmp_path: Path, suffix: str) -> None:
    """Cut, with bytes changed, empty, or of the other kind: a snapshot, or a sentence."""
    path, draw = tmp_path / f"a{suffix}", np.random.default_rng(3)
    good = (write_table if suffix == ".npz" else write_gadget)(path).read_bytes()
    other = (write_gadget if suffix == ".npz" else write_table)(tmp_path / "other.npz").read_bytes()
    cuts = [good[:n] for n in draw.integers(0, len(good), 15)]
    changed = []
    for _ in range(60):
        data = bytearray(good)
        for at in draw.integers(0, len(good), 20):
            data[at] = draw.integers(256)
        changed.append(bytes(data))
    for data in [b"", b"\0" * 200, other, *cuts, *changed]:
        path.write_bytes(data)
        try:
            read_snapshot(path)
        except SnapshotError as error:
            assert str(path) in str(error)  # noqa: PT017  a snapshot is right as well
