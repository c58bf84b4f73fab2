"""A small snapshot as a plain table and in the Gadget layout, each with what a test wants changed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from streamkit import GYR

KPC_CM = 3.0856775814913673e21
META = {"units": "kpc, km/s, Gyr (t_*), Msun", "t_gyr": 4.0}


def table(**changes: Any) -> dict[str, Any]:
    """Three particles and a track of two states; the last particle is bound."""
    columns: dict[str, Any] = {
        "x": [10.0, 20.0, 30.0], "y": [1.0, 2.0, 3.0], "z": [4.0, 5.0, 6.0],
        "vx": [100.0, -50.0, 0.0], "vy": [7.0, 8.0, 9.0], "vz": [0.0, 1.0, 2.0],
        "t_strip": [1.0, 3.5, -1.0], "Lam_unwrapped_deg": [370.0, -90.0, 0.0], "chi": [-5.0, 6.0, 0.0],
        "orbit_txv": [[0.0, *range(1, 7)], [4.0, *range(2, 8)]], "meta": json.dumps(META),
    }  # fmt: skip
    columns.update(changes)
    return {name: np.array(value) for name, value in columns.items() if value is not None}


def write_table(path: Path, **changes: Any) -> Path:
    np.savez(path, **table(**changes))
    return path


def write_gadget(path: Path, length: float = 1.0, speed: float = 1.0, **changes: Any) -> Path:
    """The same particles in units of ``length`` kpc and ``speed`` km/s."""
    columns = table()
    time = GYR * speed / length  # a Gyr in the file's unit
    content: dict[str, Any] = {
        "Header": {"Time": 4.0 * time, "Redshift": 0.0, "NumFilesPerSnapshot": 1, "HubbleParam": 1.0},
        "Units": {"UnitLength_in_cm": length * KPC_CM, "UnitVelocity_in_cm_per_s": speed * 1e5},
        "PartType1": {
            "Coordinates": np.stack([columns[name] for name in "xyz"], axis=1) / length,
            "Velocities": np.stack([columns[name] for name in ("vx", "vy", "vz")], axis=1) / speed,
            "StrippingTime": np.where(columns["t_strip"] < 0, -1, columns["t_strip"] * time),
            "Winding": np.radians(columns["Lam_unwrapped_deg"]),
        },
        "Progenitor": {
            "Times": columns["orbit_txv"][:, 0] * time,
            "Coordinates": columns["orbit_txv"][:, 1:4] / length,
            "Velocities": columns["orbit_txv"][:, 4:] / speed,
        },
    }
    for where, value in changes.items():
        group, _, name = where.partition("__")
        if value is None:
            content[group].pop(name) if name else content.pop(group)
        elif name:
            content[group][name] = value
        else:
            content[group] = value
    with h5py.File(path, "w") as file:
        for group, items in content.items():
            place = file.create_group(group)
            for name, value in items.items():
                if group in ("Header", "Units", "Parameters"):
                    place.attrs[name] = value
                else:
                    place[name] = value
    return path
