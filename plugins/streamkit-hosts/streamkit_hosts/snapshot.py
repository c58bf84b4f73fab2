"""Read the masses, places and time of a snapshot in the Gadget layout (HDF5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from streamkit import GYR, Array, StreamkitError
from streamkit.report import DamagedError, group_of, number_of, numbers_of, read_foreign

KPC_CM, MSUN_G, KMS_CGS = 3.0856775814913673e21, 1.98840987e33, 1e5
UNITS = {"UnitLength_in_cm": KPC_CM, "UnitMass_in_g": MSUN_G, "UnitVelocity_in_cm_per_s": KMS_CGS}
MOST_PARTICLES = 50_000_000  # in one snapshot
# Attributes with the values that they may have, and what is expected.
PLAIN = {
    "ComovingIntegrationOn": ((0,), "physical coordinates"),
    "Redshift": ((0,), "physical coordinates, and no redshift"),
    "HubbleParam": ((0, 1), "lengths and masses without 1/h"),
    "NumFilesPerSnapshot": ((1,), "a snapshot in one file: join its files"),
}


@dataclass(frozen=True)
class Particles:
    """The particles of one time in Gyr: places (3, n) in kpc and masses (n,) in Msun."""

    source: Path
    time: float
    q: Array
    mass: Array


def read(path: Path, types: Sequence[int] = ()) -> Particles:
    """Return the particles of some types, or of all; StreamkitError with a sentence for anything else."""
    if not path.is_file():
        raise StreamkitError(f"{path}: {'is a directory' if path.is_dir() else 'there is no such file'}")
    try:
        return read_foreign(path, lambda data: _particles(path, data, types))
    except DamagedError as error:
        raise StreamkitError(f"{path}: cannot be read as HDF5: {error}") from None


def _particles(path: Path, data: Any, types: Sequence[int]) -> Particles:
    attributes: dict[str, Any] = {}
    for place in ("Header", "Parameters", "Units"):  # the last one says it best
        attributes.update(data[place].attrs if place in data else {})
    for name, (allowed, expected) in PLAIN.items():
        value = _number(path, attributes, name, allowed[0])
        if not np.isclose(value, allowed, rtol=0, atol=1e-6).any():
            raise StreamkitError(f"{path}: {name} is {value:g}; expected {expected}")
    length, mass, speed = (_number(path, attributes, name) / one for name, one in UNITS.items())
    there = sorted(int(name[8:]) for name in data if name.startswith("PartType") and name[8:].isdigit())
    if absent := [kind for kind in types if kind not in there]:
        raise StreamkitError(f"{path}: has no particles of type {absent[0]}; it has {', '.join(map(str, there))}")
    parts = [_of_type(path, group_of(path, data, f"PartType{kind}"), kind, attributes) for kind in types or there]
    q = np.concatenate([places for places, _ in parts]) if parts else np.zeros((0, 3))
    masses = np.concatenate([each for _, each in parts]) if parts else np.zeros(0)
    if not len(q) <= MOST_PARTICLES:
        raise StreamkitError(f"{path}: has {len(q)} particles; expected at most {MOST_PARTICLES}: choose with --type")
    if not len(q):
        raise StreamkitError(f"{path}: there is no particle")
    for what, bad in (
        ("a place that is not finite", ~np.isfinite(q).all(axis=1)),
        ("a mass that is not finite", ~np.isfinite(masses)),
        ("a negative mass", masses < 0),
    ):
        if bad.any():
            raise StreamkitError(f"{path}: {bad.sum()} of {len(q)} particles have {what}, the first is {bad.argmax()}")
    if not masses.any():
        raise StreamkitError(f"{path}: the masses of all {len(q)} particles are 0")
    time = _number(path, attributes, "Time") * length / speed / GYR
    return Particles(path, time, np.ascontiguousarray(q.T) * length, masses * mass)


def _of_type(path: Path, group: Any, kind: int, attributes: dict[str, Any]) -> tuple[Array, Array]:
    where = f"{path}: PartType{kind}"
    if "Coordinates" not in group:
        raise StreamkitError(f"{where}: has no Coordinates")
    q = numbers_of(path, group, "Coordinates")
    if q.ndim != 2 or q.shape[1] != 3:
        raise StreamkitError(f"{where}: expected Coordinates (n, 3), found {q.shape}")
    if "Masses" in group:
        mass = numbers_of(path, group, "Masses")
    else:
        table = np.ravel(attributes.get("MassTable", ()))
        if kind >= len(table) or not table[kind] > 0:
            raise StreamkitError(f"{where}: has no Masses, and MassTable has none for it")
        mass = np.full(len(q), float(table[kind]))
    if mass.shape != (len(q),):
        raise StreamkitError(f"{where}: expected Masses ({len(q)},), found {mass.shape}")
    return q, mass


def _number(path: Path, attributes: dict[str, Any], name: str, default: float | None = None) -> float:
    value = attributes.get(name, default)
    if value is None:
        raise StreamkitError(f"{path}: has no attribute {name} in Units, Parameters or Header")
    return number_of(path, name, value)
