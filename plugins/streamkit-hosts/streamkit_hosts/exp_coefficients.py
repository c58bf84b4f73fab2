"""Read the coefficients of EXP for a sphere, in HDF5."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from streamkit import Array, StreamkitError
from streamkit.report import DamagedError, group_of, number_of, numbers_of, read_foreign
from streamkit_hosts.table import check_rows

UNITS = {
    "length": {"pc": 1e-3, "kpc": 1.0, "Mpc": 1e3},
    "mass": {"Msun": 1.0},
    "time": {"yr": 1e-9, "Myr": 1e-3, "Gyr": 1.0},
    "velocity": {"km/s": 1.0, "m/s": 1e-3, "cm/s": 1e-5},
}
MOST_UNITS = 20


@dataclass(frozen=True)
class Coefficients:
    """c_lmn (T, lm, n) at increasing times (T,), with the centre (T, 3) of each, in the file's units."""

    times: Array
    values: Array
    centre: Array
    units: dict[str, float] = field(default_factory=dict)  # what the file says of them


def read_coefficients(file: Path, l_max: int, n_max: int, every: int) -> Coefficients:
    """Return every so many-th snapshot, counted from the last, of a file for a basis with these largest l and n."""
    if not file.is_file():
        raise StreamkitError(f"{file}: {'is a directory' if file.is_dir() else 'there is no such file'}")
    try:
        return read_foreign(file, lambda data: _coefficients(file, data, l_max, n_max, every))
    except DamagedError as error:
        raise StreamkitError(f"{file}: cannot be read as HDF5: {error}") from None


def _coefficients(file: Path, data: Any, l_max: int, n_max: int, every: int) -> Coefficients:
    for name, wanted in (("lmax", l_max), ("nmax", n_max)):
        if name not in data.attrs:
            raise StreamkitError(f"{file}: has no attribute {name}; expected coefficients of EXP for a sphere")
        if (value := number_of(file, name, data.attrs[name])) != wanted:
            raise StreamkitError(f"{file}: {name} is {value:g}, and {wanted} in the basis: they do not belong together")
    if "snapshots" not in data:
        raise StreamkitError(f"{file}: has no group snapshots; expected coefficients of EXP")
    snapshots = group_of(file, data, "snapshots")
    names = sorted(snapshots)[::-1][::every][::-1]
    shape = ((l_max + 1) * (l_max + 2) // 2, n_max)
    check_rows(len(names) * shape[0] * 2, f"{len(names)} times at one radius", "take fewer times by --every")
    times, values, centres = [], [], []
    for name in names:
        group = group_of(file, snapshots, name)
        if "Time" not in group.attrs or "coefficients" not in group:
            raise StreamkitError(f"{file}: snapshots/{name}: expected an attribute Time and coefficients")
        coefficients = numbers_of(file, group, "coefficients", complex)
        if coefficients.shape != shape:
            raise StreamkitError(f"{file}: snapshots/{name}: expected coefficients {shape}, found {coefficients.shape}")
        if not np.isfinite(coefficients).all():
            raise StreamkitError(f"{file}: snapshots/{name}: has coefficients that are not finite")
        if "CoefficientOutputVersion" not in data.attrs:  # files before this mark have the other order of numbers
            coefficients = coefficients.reshape(-1).reshape(shape[::-1]).T
        centre = np.ravel(group.attrs.get("Center", np.zeros(3)))
        if centre.shape != (3,) or centre.dtype.kind not in "iuf" or not np.isfinite(centre).all():
            raise StreamkitError(f"{file}: snapshots/{name}: expected a Center of three numbers")
        turned = np.asarray(group.attrs.get("Rotation", np.eye(3)))
        if turned.shape != (3, 3) or turned.dtype.kind not in "iuf" or not np.allclose(turned, np.eye(3), atol=1e-6):
            raise StreamkitError(f"{file}: snapshots/{name}: has a Rotation; expected coefficients that are not turned")
        times.append(number_of(file, f"snapshots/{name}: Time", group.attrs["Time"]))
        values.append(coefficients)
        centres.append(centre.astype(float))
    if not times:
        raise StreamkitError(f"{file}: has no snapshots")
    order = np.argsort(times, kind="stable")
    if (np.diff(np.array(times)[order]) <= 0).any():
        raise StreamkitError(f"{file}: has several snapshots of the same time")
    return Coefficients(np.array(times)[order], np.array(values)[order], np.array(centres)[order], _stated(file, data))


def _stated(file: Path, data: Any) -> dict[str, float]:
    """Return what a file says of its units: of length, mass, time and velocity in streamkit's, and G."""
    if "Units" not in data:
        return {}
    rows = data["Units"]
    if rows.dtype.names != ("name", "unit", "value") or rows.size > MOST_UNITS:
        raise StreamkitError(f"{file}: Units: expected rows with name, unit and value")
    stated = {}
    for *words, value in rows[()]:
        name, unit = (bytes(word).split(b"\0")[0].decode("ascii", "replace") for word in words)
        if name == "G":
            stated["G"] = number_of(file, "the unit G", value)
        elif name in UNITS and unit not in ("none", ""):
            if unit not in UNITS[name]:
                raise StreamkitError(f"{file}: its unit of {name} is {unit!r}; expected {', '.join(UNITS[name])}")
            stated[name] = number_of(file, f"the unit of {name}", value) * UNITS[name][unit]
    if any(value <= 0 for value in stated.values()):
        raise StreamkitError(f"{file}: expected units that are positive")
    return stated


