"""N-body snapshots: the satellite's particles at one time, read with units stated, from two layouts.

``.hdf5``, ``.h5``: the Gadget layout. ``PartTypeN/Coordinates`` and ``Velocities``, units as attributes of ``Units``,
``Parameters`` or ``Header`` (``UnitLength_in_cm`` and ``UnitVelocity_in_cm_per_s``, or SWIFT's ``Unit length in cgs
(U_L)`` and ``Unit time in cgs (U_t)``), ``Header/Time``. Optional, and written by streamkit's own N-body plugin:
``PartTypeN/StrippingTime`` (the last time inside the tidal radius, in the file's time; -1 for bound particles),
``PartTypeN/Winding`` (radians, leading positive), ``StrippingOffset`` and ``StrippingVelocity`` (from the core at that
time), and the track of the core, which ends at ``Header/Time``: ``Progenitor/Times``, ``Coordinates``, ``Velocities``.

``.npz``: a plain table. Columns ``x y z`` and ``vx vy vz``; ``meta``, JSON whose ``units`` must name kpc, km/s and Gyr
and whose ``t_gyr`` is the snapshot's time. Optional: ``t_strip`` (Gyr; -1 for bound particles), ``Lam_unwrapped_deg``
(the winding), ``chi`` (kpc Gyr), ``prog_xv`` (6,) and ``orbit_txv`` (T, 7).

Physical coordinates, with the host's centre at the origin and at rest.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from streamkit.errors import StreamkitError, nearest
from streamkit.phase import Array
from streamkit.units import GYR

KPC_CM, KMS_CGS = 3.0856775814913673e21, 1e5
COLUMNS = ("x", "y", "z", "vx", "vy", "vz")
UNITS = ("kpc", "km/s", "Gyr")
"""What the ``units`` of a plain table must name."""
LAYOUTS = (".npz", ".hdf5", ".h5")


class SnapshotError(StreamkitError):
    """A snapshot cannot be used: the file, what was found, what is wanted."""


@dataclass(frozen=True)
class Snapshot:
    """Particles of a satellite at one time, which is t = 0, in engine units.

    Attributes
    ----------
    source
        The file, for messages.
    q, v
        (3, n) positions and velocities.
    t_strip
        (n,) last time inside the tidal radius, NaN for bound particles; None where the file does not say.
    winding
        (n,) angle swept relative to the progenitor, radians, leading positive; None likewise.
    chi
        (n,) phase of Gibbons+ 2014; None likewise.
    core
        (7, T) track of the satellite's core: t, q, v, up to t = 0; None likewise. One column is its state alone.
    dq_strip, dv_strip
        (3, n) position and velocity relative to the core at the stripping time, Galactocentric; None likewise.
    """

    source: str
    q: Array
    v: Array
    t_strip: Array | None = None
    winding: Array | None = None
    chi: Array | None = None
    core: Array | None = None
    dq_strip: Array | None = None
    dv_strip: Array | None = None


def read(path: str | Path) -> Snapshot:
    """Read a snapshot; ``FILE.hdf5:PartType2`` picks one of several particle types.

    Raises
    ------
    SnapshotError
        For a file that cannot be read, units that are missing or wrong, missing or broken fields.
    """
    name, _, group = str(path).partition(":PartType")
    file = Path(name)
    if file.suffix not in LAYOUTS:
        raise SnapshotError(
            f"{file}: a snapshot must be a plain table (.npz) or HDF5 in the Gadget layout (.hdf5, .h5), "
            f"found {file.suffix or 'no suffix'!r}.{nearest(file.suffix, LAYOUTS)}"
        )
    if not file.is_file():
        raise SnapshotError(f"{file}: {'is a directory' if file.is_dir() else 'there is no such file'}")
    snapshot = _read_table(file) if file.suffix == ".npz" else _read_gadget(file, group)
    _check(snapshot)
    return snapshot


def _check(snapshot: Snapshot) -> None:
    n = snapshot.q.shape[1]
    if n == 0:
        raise SnapshotError(f"{snapshot.source}: holds no particles")
    for what, values in (("positions", snapshot.q), ("velocities", snapshot.v), ("track of the core", snapshot.core)):
        if values is not None and not np.isfinite(values).all():
            raise SnapshotError(f"{snapshot.source}: the {what} hold numbers that are not finite")
    if snapshot.winding is not None and not np.isfinite(snapshot.winding).all():
        raise SnapshotError(f"{snapshot.source}: the windings hold numbers that are not finite")


def _read_table(file: Path) -> Snapshot:
    try:
        with np.load(file, allow_pickle=False) as data:
            table = {name: data[name] for name in data.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise SnapshotError(f"{file}: cannot be read as a plain table (.npz): {error}") from None
    _wanted(file, COLUMNS, table)
    n = len(table["x"])
    per_particle = (*COLUMNS, "t_strip", "Lam_unwrapped_deg", "chi")
    wrong = [name for name in per_particle if name in table and table[name].shape != (n,)]
    if table["x"].ndim != 1 or wrong:
        raise SnapshotError(f"{file}: {', '.join(wrong or ['x'])}: expected one number per particle, as x has ({n})")
    meta = _meta(file, table)
    now = float(meta["t_gyr"])
    core = None
    if "orbit_txv" in table:
        core = _core(file, "orbit_txv", table["orbit_txv"].T, now) * np.array([[GYR]] + 6 * [[1.0]])
    elif "prog_xv" in table:
        core = np.concatenate([[0.0], table["prog_xv"]]).astype(float)[:, None]
    stripped, winding, chi = (table.get(name) for name in ("t_strip", "Lam_unwrapped_deg", "chi"))
    return Snapshot(
        source=str(file),
        q=np.array([table[name] for name in "xyz"], dtype=float),
        v=np.array([table[name] for name in ("vx", "vy", "vz")], dtype=float),
        t_strip=None if stripped is None else _since(stripped.astype(float), now) * GYR,
        winding=None if winding is None else np.radians(winding.astype(float)),
        chi=None if chi is None else chi.astype(float) * GYR,
        core=core,
    )


def _since(t: Array, now: float) -> Array:
    """(n,) Times counted from today; NaN for the negative ones, which mark bound particles."""
    return np.where(t < 0, np.nan, t - now)


def _meta(file: Path, table: Mapping[str, Any]) -> dict[str, Any]:
    """Read the ``meta`` of a plain table, and insist on its units."""
    stated = 'expected meta, JSON such as {"units": "kpc, km/s, Gyr", "t_gyr": 3.77}'
    try:
        meta = json.loads(str(table["meta"]))
        words = str(meta["units"]).replace(",", " ").replace(";", " ").split()
    except KeyError as error:
        raise SnapshotError(f"{file}: does not state its units: {error} is missing; {stated}") from None
    except (ValueError, TypeError):
        raise SnapshotError(f"{file}: does not state its units: its meta is not JSON; {stated}") from None
    if absent := [unit for unit in UNITS if unit not in words]:
        raise SnapshotError(
            f"{file}: its units are {meta['units']!r}, without {' and '.join(absent)}; a plain table must be in kpc, "
            "km/s and Gyr: convert it"
        )
    if not isinstance(meta.get("t_gyr"), int | float):
        raise SnapshotError(f"{file}: meta does not say the time of the snapshot; {stated}")
    return dict(meta)


def _read_gadget(file: Path, group: str) -> Snapshot:
    import h5py

    try:
        with h5py.File(file, "r") as data:
            return _gadget(file, data, group)
    except OSError as error:
        raise SnapshotError(f"{file}: cannot be read as HDF5: {error}") from None


def _gadget(file: Path, data: Any, group: str) -> Snapshot:
    kinds = sorted(name for name in data if name.startswith("PartType"))
    chosen = f"PartType{group}" if group else (kinds[0] if len(kinds) == 1 else "")
    if chosen not in kinds:
        found = ", ".join(kinds) or f"no PartType, but {', '.join(data) or 'nothing'}"
        raise SnapshotError(
            f"{file}: found {found}; expected one group of particles in the Gadget layout, those of the satellite: "
            f"name it as {file.name}:PartType1"
        )
    attributes: dict[str, Any] = {}
    for place in ("Header", "Parameters", "Units"):  # the last one says it best
        attributes.update(data[place].attrs if place in data else {})
    _plain_space(file, attributes)
    length, speed = _gadget_units(file, attributes)
    time = length / speed
    particles = data[chosen]
    _wanted(f"{file}: {chosen}", ("Coordinates", "Velocities"), particles)
    q, v = (np.array(particles[name], dtype=float) for name in ("Coordinates", "Velocities"))
    if q.ndim != 2 or q.shape[1] != 3 or v.shape != q.shape:
        raise SnapshotError(f"{file}: {chosen}: expected Coordinates and Velocities (n, 3), found {q.shape}, {v.shape}")
    now = float(np.ravel(attributes.get("Time", 0.0))[0])
    shapes = {
        "StrippingTime": (len(q),),
        "Winding": (len(q),),
        "StrippingOffset": q.shape,
        "StrippingVelocity": q.shape,
    }
    optional = {name: np.array(particles[name], dtype=float) for name in shapes if name in particles}
    if wrong := [name for name, values in optional.items() if values.shape != shapes[name]]:
        raise SnapshotError(f"{file}: {chosen}/{wrong[0]}: expected the shape {shapes[wrong[0]]}")
    core = None
    if "Progenitor" in data:
        track = data["Progenitor"]
        _wanted(f"{file}: Progenitor", ("Times", "Coordinates", "Velocities"), track)
        rows = [np.array(track["Times"])[None], np.array(track["Coordinates"]).T, np.array(track["Velocities"]).T]
        if not all(row.ndim == 2 and row.shape[1] == rows[0].shape[1] for row in rows):
            raise SnapshotError(f"{file}: Progenitor: expected Times (T,), Coordinates and Velocities (T, 3)")
        scale = np.array([[time], *3 * [[length]], *3 * [[speed]]])
        core = _core(file, "Progenitor", np.concatenate(rows).astype(float), now) * scale
    stripped, offset, kick = (optional.get(name) for name in ("StrippingTime", "StrippingOffset", "StrippingVelocity"))
    return Snapshot(
        source=str(file),
        q=np.ascontiguousarray(q.T) * length,
        v=np.ascontiguousarray(v.T) * speed,
        t_strip=None if stripped is None else _since(stripped, now) * time,
        winding=optional.get("Winding"),
        core=core,
        dq_strip=None if offset is None else offset.T * length,
        dv_strip=None if kick is None else kick.T * speed,
    )


def _core(file: Path, name: str, track: Array, now: float) -> Array:
    """(7, T) The track with times from today; it must be in order and end at the snapshot."""
    track = np.array(track, dtype=float)
    if track.ndim != 2 or len(track) != 7 or track.shape[1] < 2 or not (np.diff(track[0]) > 0).all():
        raise SnapshotError(f"{file}: {name}: expected time, position and velocity at two or more increasing times")
    if abs(track[0, -1] - now) > 1e-3 * (track[0, -1] - track[0, 0]):
        raise SnapshotError(
            f"{file}: {name} ends at {track[0, -1]:.4g} and the snapshot is of {now:.4g}: the track must end there"
        )
    track[0] -= track[0, -1]
    return track


def _gadget_units(file: Path, attributes: Mapping[str, Any]) -> tuple[float, float]:
    """Return the file's units of length and speed in kpc and km/s."""
    cgs = {}
    for name, keys in (
        ("length", ("UnitLength_in_cm", "Unit length in cgs (U_L)")),
        ("speed", ("UnitVelocity_in_cm_per_s",)),
        ("time", ("UnitTime_in_s", "Unit time in cgs (U_t)")),
    ):
        found = [attributes[key] for key in keys if key in attributes]
        cgs[name] = float(np.ravel(found[0])[0]) if found else np.nan
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
        value = float(np.ravel(attributes.get(name, allowed[0]))[0])
        if not np.isclose(value, allowed, rtol=0, atol=1e-6).any():
            raise SnapshotError(f"{file}: {name} is {value:g}; expected {why}")


def _wanted(where: str | Path, names: tuple[str, ...], found: Mapping[str, Any]) -> None:
    absent = [name for name in names if name not in found]
    if absent:
        raise SnapshotError(
            f"{where}: {', '.join(absent)} missing; a snapshot needs positions and velocities ({', '.join(names)}). "
            f"Found {', '.join(sorted(found)) or 'nothing'}.{nearest(absent[0], found)}"
        )
