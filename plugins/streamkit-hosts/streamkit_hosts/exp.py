"""Read the hosts of EXP: a basis `sphereSL` in YAML, its model, and coefficients in HDF5, without EXP.

The formats are those of EXP 7 (Petersen, Weinberg & Katz 2022, MNRAS 510, 6201; JOSS 10, 7302). The potential is
``G / scale sum c_lmn Y_lm Phi_ln(r / scale)``: Y_lm are normalised over the sphere, with the sign (-1)^m, and the parts
of c_lmn are those of cos(m phi) and sin(m phi).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from streamkit import GYR, Array, G, StreamkitError
from streamkit_hosts.exp_basis import basis_of, settings_of
from streamkit_hosts.exp_coefficients import Coefficients, read_coefficients
from streamkit_hosts.expansion import Expansion
from streamkit_hosts.path import moved_by, path_of, told


@dataclass(frozen=True)
class Units:
    """The units of a file: length in kpc, mass in Msun, time in Gyr. G is 1 in them; None where they are not known."""

    length: float | None = None
    mass: float | None = None
    time: float | None = None


def read(
    basis_file: Path, file: Path, units: Units, *, l_max: int | None = None, every: int = 1, today: float | None = None
) -> Expansion:
    """Return the host of a basis and its coefficients.

    Parameters
    ----------
    basis_file, file
        The basis (YAML), beside which its model is, and the coefficients (HDF5).
    units
        Those of the file, in place of what it says itself. A time follows from length and mass without its own.
    l_max, every
        Largest degree to keep, and every so many-th time, counted from the last.
    today
        The time of today in the file's unit; the last one without.

    Raises StreamkitError with a sentence for files that cannot be used.
    """
    settings = settings_of(basis_file)
    whole, nmax = int(settings["Lmax"]), int(settings["nmax"])
    kept = min(whole, l_max if l_max is not None else whole)
    basis = basis_of(basis_file, settings)
    found = read_coefficients(file, whole, nmax, every)
    length, mass, time = _units(file, found, units)
    now = found.times[-1] if today is None else today
    harmonics = [(n, m) for n in range(kept + 1) for m in range(-n, n + 1) if _is_used(n, m, settings)]
    parts = []
    for n, m in harmonics:
        value = (-1.0) ** m * found.values[:, n * (n + 1) // 2 + abs(m)]
        parts.append(value.imag if m < 0 else value.real)
    amplitudes = np.stack(parts, axis=1) * G * mass / length / settings["scale"] / np.sqrt(4 * np.pi)
    degree = np.array([n for n, _ in harmonics])
    scale = length * settings["scale"]

    def phi(r: Array, fewer: int = 0, below: int = kept + 1) -> Array:
        functions = basis(r / scale)
        functions[:, nmax - fewer :] = 0.0
        out = np.empty((len(amplitudes), len(degree), len(r)))
        for n in range(kept + 1):
            out[:, degree == n] = amplitudes[:, degree == n] @ functions[n] if n < below else 0.0
        return out

    fewer = max(1, nmax // 5)
    cuts: dict[str, Callable[[Array], Array]] = {f"the last {fewer} of {nmax} functions": partial(phi, fewer=fewer)}
    if kept >= 4:
        cuts[f"the degrees above {kept - 2}"] = partial(phi, below=kept - 1)
    first, last = basis.first * scale, basis.last * scale
    moved = moved_by(found.centre) * length
    path = path_of((found.times - now) * time, found.centre * length) if moved > first else {}
    said = (told(moved, path),) if moved > first else ()
    return Expansion((found.times - now) * time, harmonics, phi, first, last, cuts, said, path)


def _is_used(n: int, m: int, settings: dict[str, Any]) -> bool:
    """Return whether a basis has a harmonic that is not switched off."""
    off = ("NO_L1", n == 1), ("EVEN_L", n % 2), ("EVEN_M", m % 2), ("M0_ONLY", m != 0)
    return not any(settings[name] and there for name, there in off)


def _units(file: Path, found: Coefficients, given: Units) -> tuple[float, float, float]:
    """Return the units of length, mass and time in kpc, Msun and Gyr."""
    stated = found.units
    constant = stated.get("G", 1.0)
    length = given.length or stated.get("length")
    if length is None:
        raise StreamkitError(f"{file}: does not state its unit of length: give --length, in kpc")
    time, speed = given.time or stated.get("time"), stated.get("velocity")
    if speed is None and stated.get("time"):
        speed = length / (stated["time"] * GYR)
    mass = given.mass or stated.get("mass") or (constant * speed**2 * length / G if speed else None)
    if mass is None:
        raise StreamkitError(f"{file}: does not state its unit of mass: give --mass, in Msun")
    return length, mass, time or length / np.sqrt(G * mass / (constant * length)) / GYR
