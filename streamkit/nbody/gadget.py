"""Snapshots in the Gadget layout: HDF5 with units as attributes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from streamkit.nbody.snapshot import Snapshot, SnapshotError, core_track, insist_on, since_today
from streamkit.report import DamagedError, group_of, number_of, numbers_of, read_foreign

KPC_CM, KMS_CGS = 3.0856775814913673e21, 1e5


def read_gadget(file: Path, group: str) -> Snapshot:
    """Read HDF5 in the Gadget layout; the group is the number of a particle type, or empty."""
    try:
        return read_foreign(file, lambda data: _gadget(file, data, group))
    except DamagedError as error:
        raise SnapshotError(f"{file}: cannot be read as HDF5: {error}") from None


def _gadget(file: Path, data: Any, group: str) -> Snapshot:
    kinds = sorted(name for name in data if name.startswith("PartType"))
    chosen = f"PartType{group}" if group else (kinds[0] if len(kinds) == 1 else "")
    if chosen not in kinds:
        groups = ", ".join(kinds) or f"no PartType, but {', '.join(data) or 'nothing'}"
        raise SnapshotError(
            f"{file}: found {groups}; expected one group of particles in the Gadget layout, those of the satellite: "
            f"name it as {file.name}:PartType1"
        )
    attributes: dict[str, Any] = {}
    for place in ("Header", "Parameters", "Units"):  # the last one says it best
        attributes.update(data[place].attrs if place in data else {})
    _plain_space(file, attributes)
    length, speed = _gadget_units(file, attributes)
    time = length / speed
    particles = group_of(file, data, chosen)
    insist_on(f"{file}: {chosen}", ("Coordinates", "Velocities"), particles)
    q, v = (numbers_of(file, particles, name) for name in ("Coordinates", "Velocities"))
    if q.ndim != 2 or q.shape[1] != 3 or v.shape != q.shape:
        raise SnapshotError(f"{file}: {chosen}: expected Coordinates and Velocities (n, 3), found {q.shape}, {v.shape}")
    now = number_of(file, "Time", attributes.get("Time", 0.0))
    shapes = {
        "StrippingTime": (len(q),),
        "Winding": (len(q),),
        "StrippingOffset": q.shape,
        "StrippingVelocity": q.shape,
    }
    optional = {name: numbers_of(file, particles, name) for name in shapes if name in particles}
    if wrong := [name for name, values in optional.items() if values.shape != shapes[name]]:
        raise SnapshotError(f"{file}: {chosen}/{wrong[0]}: expected the shape {shapes[wrong[0]]}")
    core = None
    if "Progenitor" in data:
        track = group_of(file, data, "Progenitor")
        insist_on(f"{file}: Progenitor", ("Times", "Coordinates", "Velocities"), track)
        rows = [np.atleast_2d(numbers_of(file, track, name).T) for name in ("Times", "Coordinates", "Velocities")]
        if not all(row.ndim == 2 and row.shape[1] == rows[0].shape[1] for row in rows):
            raise SnapshotError(f"{file}: Progenitor: expected Times (T,), Coordinates and Velocities (T, 3)")
        scale = np.array([[time], *3 * [[length]], *3 * [[speed]]])
        core = core_track(file, "Progenitor", np.concatenate(rows).astype(float), now) * scale
    stripped, offset, kick = (optional.get(name) for name in ("StrippingTime", "StrippingOffset", "StrippingVelocity"))
    return Snapshot(
        source=str(file),
        q=np.ascontiguousarray(q.T) * length,
        v=np.ascontiguousarray(v.T) * speed,
        t_strip=None if stripped is None else since_today(stripped, now) * time,
        winding=optional.get("Winding"),
        core=core,
        dq_strip=None if offset is None else offset.T * length,
        dv_strip=None if kick is None else kick.T * speed,
    )


def _gadget_units(file: Path, attributes: Mapping[str, Any]) -> tuple[float, float]:
    """Return the file's units of length and speed in kpc and km/s."""
    cgs = {}
    for name, keys in (
        ("length", ("UnitLength_in_cm", "Unit length in cgs (U_L)")),
        ("speed", ("UnitVelocity_in_cm_per_s",)),
        ("time", ("UnitTime_in_s", "Unit time in cgs (U_t)")),
    ):
        values = [attributes[key] for key in keys if key in attributes]
        cgs[name] = number_of(file, f"the unit of {name}", values[0]) if values else np.nan
    if np.isnan(cgs["speed"]):
        cgs["speed"] = cgs["length"] / cgs["time"]
    if absent := [name for name in ("length", "speed") if not cgs[name] > 0]:
        raise SnapshotError(
            f"{file}: does not state its unit of {' and '.join(absent)}: expected the attributes UnitLength_in_cm and "
            "UnitVelocity_in_cm_per_s of the group Units, Parameters or Header (3.0857e21 and 1e5 for kpc and km/s)"
        )
    return cgs["length"] / KPC_CM, cgs["speed"] / KMS_CGS


def _plain_space(file: Path, attributes: Mapping[str, Any]) -> None:
    """Refuse what is comoving, scaled by h, or spread over several files."""
    wanted = {
        "ComovingIntegrationOn": ((0,), "physical coordinates, and these are comoving"),
        "Redshift": ((0,), "a snapshot of today, and this one has a redshift"),
        "HubbleParam": ((0, 1), "lengths without 1/h: convert them, and set HubbleParam to 1"),
        "NumFilesPerSnapshot": ((1,), "the snapshot in one file: join its files"),
    }
    for name, (allowed, why) in wanted.items():
        value = number_of(file, name, attributes.get(name, allowed[0]))
        if not np.isclose(value, allowed, rtol=0, atol=1e-6).any():
            raise SnapshotError(f"{file}: {name} is {value:g}; expected {why}")
