"""N-body snapshots: both layouts in any units; what they lack, by following the particles back; bad files refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from snapshot_files import META, write_gadget, write_table
from snapshots import nbody_snapshot, nbody_stream, run_file

from streamkit import GYR, StreamkitError
from streamkit.nbody import as_stream, read_snapshot
from streamkit.nbody.as_stream import remnant
from streamkit.nbody.snapshot import Snapshot, SnapshotError

KPC_CM = 3.0856775814913673e21


def test_a_plain_table_is_read_in_the_units_of_the_engine(tmp_path: Path) -> None:
    snapshot = read_snapshot(write_table(tmp_path / "a.npz"))
    assert snapshot.q[:, 1] == pytest.approx([20, 2, 5])
    assert snapshot.v[:, 0] == pytest.approx([100, 7, 0])
    assert snapshot.t_strip == pytest.approx([-3.0 * GYR, -0.5 * GYR, np.nan], nan_ok=True)
    assert snapshot.winding == pytest.approx(np.radians([370, -90, 0]))
    assert snapshot.chi == pytest.approx([-5 * GYR, 6 * GYR, 0])
    assert snapshot.core is not None
    assert snapshot.core[0] == pytest.approx([-4 * GYR, 0])
    assert snapshot.core[1:, -1] == pytest.approx(range(2, 8))


def test_columns_that_are_not_read_may_hold_anything(tmp_path: Path) -> None:
    """The published tables have a boolean column, and others might have names."""
    plain = read_snapshot(write_table(tmp_path / "a.npz"))
    more = read_snapshot(write_table(tmp_path / "b.npz", bound=[False, False, True], label=["a", "b", "c"]))
    assert np.array_equal(plain.q, more.q)


@pytest.mark.parametrize(("length", "speed"), [(1.0, 1.0), (1000.0, 1.0), (1e-3, 0.9)])
def test_the_gadget_layout_in_any_units_holds_the_same(tmp_path: Path, length: float, speed: float) -> None:
    same, result = (
        read_snapshot(write_table(tmp_path / "a.npz")),
        read_snapshot(write_gadget(tmp_path / "a.hdf5", length, speed)),
    )
    for name in ("q", "v", "t_strip", "winding", "core"):
        assert getattr(result, name) == pytest.approx(getattr(same, name), nan_ok=True), name


def test_units_as_swift_writes_them(tmp_path: Path) -> None:
    units = {"Unit length in cgs (U_L)": np.array([KPC_CM]), "Unit time in cgs (U_t)": np.array([KPC_CM / 1e5])}
    result = read_snapshot(write_gadget(tmp_path / "a.hdf5", Units=units))
    assert result.v[:, 0] == pytest.approx([100, 7, 0])


def test_one_of_several_types_is_picked(tmp_path: Path) -> None:
    other = {"Coordinates": np.ones((2, 3)), "Velocities": np.full((2, 3), 5.0)}
    path = write_gadget(tmp_path / "a.hdf5", PartType4=other, Progenitor=None)
    with pytest.raises(SnapshotError, match=r"found PartType1, PartType4; expected one .* name it as a.hdf5:PartType1"):
        read_snapshot(path)
    assert read_snapshot(f"{path}:PartType4").q.shape == (3, 2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"vx": None, "vy": None, "vz": None}, "vx, vy, vz missing; a snapshot needs positions and velocities"),
        ({"meta": None}, "does not state its units: 'meta is not a file in the archive' is missing|'meta' is missing"),
        ({"meta": "kpc"}, "its meta is not JSON"),
        ({"meta": json.dumps(META | {"units": "pc, km/s, Gyr"})}, "its units are 'pc, km/s, Gyr', without kpc"),
        ({"meta": json.dumps({"units": META["units"]})}, "does not say the time of the snapshot"),
        ({"chi": [1.0, 2.0]}, r"chi: expected one number per particle, as x has \(3\)"),
        ({"y": [1.0, np.nan, 3.0]}, "the positions hold numbers that are not finite"),
        ({"orbit_txv": [[0.0] * 7, [3.0] * 7]}, "orbit_txv ends at 3 and the snapshot is of 4"),
    ],
)
def test_a_wrong_table_is_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(SnapshotError, match=message):
        read_snapshot(write_table(tmp_path / "a.npz", **changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"PartType1__Velocities": None}, "PartType1: Velocities missing; a snapshot needs positions and velocities"),
        ({"Units": None}, "does not state its unit of length and speed: expected the attributes UnitLength_in_cm"),
        ({"Units__UnitVelocity_in_cm_per_s": None}, "does not state its unit of speed"),
        ({"PartType1": None}, "found no PartType, but Header, Progenitor, Units; expected one group of particles"),
        ({"Parameters": {"ComovingIntegrationOn": 1}}, "expected physical coordinates, and these are comoving"),
        ({"Header__Redshift": 0.5}, "Redshift is 0.5; expected a snapshot of today"),
        ({"Header__HubbleParam": 0.7}, "HubbleParam is 0.7; expected lengths without 1/h"),
        ({"Header__NumFilesPerSnapshot": 4}, "expected the snapshot in one file"),
        ({"PartType1__Winding": np.zeros(2)}, r"PartType1/Winding: expected the shape \(3,\)"),
        ({"Progenitor__Times": np.array([4.0, 0.0])}, "Progenitor: expected .* two or more increasing times"),
    ],
)
def test_a_wrong_gadget_file_is_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(SnapshotError, match=message):
        read_snapshot(write_gadget(tmp_path / "a.hdf5", **changes))


def test_what_is_no_snapshot_is_refused(tmp_path: Path) -> None:
    text = tmp_path / "a.npz"
    text.write_text("x y z")
    (tmp_path / "b.hdf5").write_text("x y z")
    for name, message in (
        ("a.npz", "cannot be read as a plain table"),
        ("b.hdf5", "cannot be read as HDF5"),
        ("a.txt", "found '.txt'"),
        ("c.npz", "there is no such file"),
    ):
        with pytest.raises(SnapshotError, match=message):
            read_snapshot(tmp_path / name)


def satellite(name: str = "B") -> Snapshot:
    """The N-body extract with positions and velocities alone."""
    return replace(nbody_snapshot(name), t_strip=None, winding=None, chi=None)


@pytest.mark.parametrize("name", [pytest.param("A", marks=pytest.mark.slow), "B"])
def test_positions_and_velocities_alone_give_the_windings_and_stripping_times(name: str) -> None:
    """Of the N-body simulation, which kept them as it ran: turns for 97 %, times to a tenth of a Gyr in the median."""
    result, outcome = nbody_stream(name), as_stream(satellite(name), run_file(name).bind())
    free = ~outcome.bound
    assert free.mean() > 0.95
    assert (np.abs(outcome.winding - result.winding)[free] < 0.1).mean() > 0.97
    late = (outcome.t_strip - result.t_strip)[free] / GYR
    assert abs(np.median(late)) < 0.1
    assert np.percentile(np.abs(late), 68) < 0.25
    assert np.median(np.abs(outcome.chi - result.chi)[free]) < 0.15 * np.median(np.abs(result.chi[free]))


def test_a_stream_from_a_snapshot_counts_angles_as_the_model_does() -> None:
    """Position = radius times the direction at the winding, in the plane of the progenitor; B's orbit is polar."""
    stream = nbody_stream("B")
    first = stream.orbit.q[:, -1] / stream.orbit.r[-1]
    pole = np.cross(stream.orbit.q[:, -1], stream.orbit.v[:, -1])
    second = np.cross(pole / np.sqrt(pole @ pole), first)
    x, y = first @ stream.q, second @ stream.q
    assert np.hypot(x, y) * np.cos(stream.winding) == pytest.approx(x, abs=1e-3)
    assert np.hypot(x, y) * np.sin(stream.winding) == pytest.approx(y, abs=1e-3)


@pytest.mark.parametrize(
    ("factor", "message"),
    [((1e-3, 1.0), "the median distance is .* Are the units right"), ((1.0, 1e5), "the median speed is")],
)
def test_particles_in_other_units_than_stated_are_refused(factor: tuple[float, float], message: str) -> None:
    snapshot = satellite()
    wrong = replace(snapshot, q=snapshot.q * factor[0], v=snapshot.v * factor[1])
    with pytest.raises(StreamkitError, match=message):
        as_stream(wrong, run_file("B").bind())


def test_a_snapshot_of_another_place_says_where_its_remnant_is() -> None:
    spec = run_file("B").with_values({"progenitor.x": 25.0})
    with pytest.raises(
        StreamkitError, match=r"put into \[progenitor\]: x = 19.15\d*, y = 0.02\d*, z = -5.71\d*, vx = 176"
    ):
        as_stream(satellite(), spec.bind())


def test_the_remnant_is_found_in_the_particles_themselves() -> None:
    """A Gaussian clump of 1 kpc among debris along a circle of 40 kpc: to its standard error."""
    rng = np.random.default_rng(3)
    angle = rng.uniform(0, 2 * np.pi, 2000)
    debris = 40 * np.array([np.cos(angle), np.sin(angle), 0 * angle])
    place, speed = np.array([30.0, -20.0, 5.0]), np.array([150.0, 100.0, -50.0])
    clump = place[:, None] + rng.normal(0, 1, (3, 3000))
    v = np.concatenate([rng.normal(0, 100, (3, 2000)), speed[:, None] + rng.normal(0, 10, (3, 3000))], axis=1)
    result = remnant(np.concatenate([debris, clump], axis=1), v, 3.0)
    assert result is not None
    assert result[:3] == pytest.approx(place, abs=0.1)
    assert result[3:] == pytest.approx(speed, abs=1.0)
    assert remnant(debris, v[:, :2000], 3.0) is None
