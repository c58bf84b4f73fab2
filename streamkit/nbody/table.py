"""Snapshots as plain tables: NumPy archives with units in their ``meta``."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from streamkit.errors import brief
from streamkit.nbody.snapshot import Snapshot, SnapshotError, core_track, insist_on, since_today
from streamkit.units import GYR

COLUMNS = ("x", "y", "z", "vx", "vy", "vz")
UNITS = ("kpc", "km/s", "Gyr")  # the required ``units`` of a plain table


def read_table(file: Path) -> Snapshot:
    """Read a plain table."""
    try:
        with file.open("rb") as raw, np.load(raw, allow_pickle=False) as data:
            table = {name: data[name] for name in data.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise SnapshotError(f"{file}: cannot be read as a plain table (.npz): {brief(error)}") from None
    insist_on(file, COLUMNS, table)
    n = np.size(table["x"])
    per_particle = (*COLUMNS, "t_strip", "Lam_unwrapped_deg", "chi")
    for name in (*per_particle, "orbit_txv", "prog_xv"):  # other columns are not read
        if name in table and getattr(table[name], "dtype", np.dtype("V")).kind not in "iuf":
            raise SnapshotError(f"{file}: {name}: holds no numbers, expected an array of numbers")
    wrong = [name for name in per_particle if name in table and table[name].shape != (n,)]
    if table["x"].ndim != 1 or wrong:
        raise SnapshotError(f"{file}: {', '.join(wrong or ['x'])}: expected one number per particle, as x has ({n})")
    meta = _meta(file, table)
    now = float(meta["t_gyr"])
    core = None
    if "orbit_txv" in table:
        core = core_track(file, "orbit_txv", table["orbit_txv"].T, now) * np.array([[GYR]] + 6 * [[1.0]])
    elif "prog_xv" in table:
        core = np.concatenate([[0.0], np.ravel(table["prog_xv"])]).astype(float)[:, None]
        if len(core) != 7:
            raise SnapshotError(f"{file}: prog_xv: expected 6 numbers, found {len(core) - 1}")
    stripped, winding, chi = (table.get(name) for name in ("t_strip", "Lam_unwrapped_deg", "chi"))
    return Snapshot(
        source=str(file),
        q=np.array([table[name] for name in "xyz"], dtype=float),
        v=np.array([table[name] for name in ("vx", "vy", "vz")], dtype=float),
        t_strip=None if stripped is None else since_today(stripped.astype(float), now) * GYR,
        winding=None if winding is None else np.radians(winding.astype(float)),
        chi=None if chi is None else chi.astype(float) * GYR,
        core=core,
    )


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
    if not (isinstance(meta.get("t_gyr"), int | float) and np.isfinite(meta["t_gyr"])):
        raise SnapshotError(f"{file}: meta does not say the time of the snapshot; {stated}")
    return dict(meta)
