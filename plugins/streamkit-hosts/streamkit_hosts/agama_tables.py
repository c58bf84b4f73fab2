"""The tables of AGAMA's expansions: coefficients of `Multipole`, and the grids of `CylSpline`."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np

from streamkit import Array, Multipoles, StreamkitError
from streamkit_hosts.ini import Section
from streamkit_hosts.quintic import Quintic

DENSE = 16  # radii between two of a table
FEWEST = 4  # radii of a table
HARMONIC = re.compile(r"l=(\d+),m=(-?\d+)")


class Sphere(Multipoles):
    """Multipoles that know the first and the last radius of their table."""

    ends: tuple[float, float] = (0.0, np.inf)


def multipole_of(section: Section, length: float, velocity: float) -> Sphere:
    """Return the multipoles of a section, with units of length in kpc and velocity in km/s.

    As in AGAMA they are quintics in ln r: of log(-Phi_00) where the mean is negative, and of the others over it.
    """
    names, phi = _block(section, "#Phi")
    again, slope = _block(section, "#dPhi/dr")
    pairs = [HARMONIC.fullmatch(name) for name in names]
    if phi.shape != slope.shape or names != again or not all(pairs) or len(phi) < FEWEST:
        raise StreamkitError(f"{section.where}: expected Phi and dPhi/dr at the same radii, {FEWEST} or more")
    radius = phi[:, 0] * length
    if not ((np.diff(radius) > 0).all() and radius[0] > 0 and (phi[:, 0] == slope[:, 0]).all()):
        raise StreamkitError(f"{section.where}: expected radii that grow, the same for Phi and dPhi/dr")
    harmonics = [(int(found[1]), int(found[2])) for found in pairs if found]
    if (0, 0) not in harmonics:
        raise StreamkitError(f"{section.where}: has no l=0,m=0, the mean potential")
    s, mean = np.log(radius), harmonics.index((0, 0))
    phi, slope = phi[:, 1:] * velocity**2, slope[:, 1:] * velocity**2 / length * radius[:, None]
    dense = np.linspace(s[0], s[-1], DENSE * (len(s) - 1) + 1)
    if (phi[:, mean] < 0).all():
        base, pull = phi[:, [mean]], slope[:, [mean]]
        value, rise = phi / base, (slope - phi / base * pull) / base
        value[:, mean], rise[:, mean] = np.log(-base[:, 0]), (pull / base)[:, 0]
        made, _ = Quintic(s, value, rise)(dense)
        base = -np.exp(made[:, [mean]])
        made = made * base
        made[:, mean] = base[:, 0]
    else:
        made, _ = Quintic(s, phi, slope)(dense)
    n, m = np.array(harmonics).T
    made = made * (-1.0) ** m  # AGAMA's harmonics have this sign
    columns = np.repeat(n, len(dense)), np.repeat(m, len(dense)), np.tile(np.exp(dense), len(n)), made.T.ravel()
    try:
        sphere = Sphere(*columns)
    except ValueError as error:
        raise StreamkitError(f"{section.where}: {error}") from None
    sphere.ends = float(radius[0]), float(radius[-1])
    return sphere


def cylinder_rows(section: Section, length: float, velocity: float) -> dict[str, Array]:
    """Return the columns of a table `cylspline` of a section, with units of length in kpc and velocity in km/s."""
    blocks = [_grids(section, title) for title in ("#Phi", "#dPhi/dR", "#dPhi/dz")]
    radius, height, phi = blocks[0]
    if any(block[2].keys() != phi.keys() for block in blocks) or any(
        not (np.array_equal(radius, block[0]) and np.array_equal(height, block[1])) for block in blocks
    ):
        raise StreamkitError(f"{section.where}: expected Phi, dPhi/dR and dPhi/dz for the same m, R and z")
    size = len(radius) * len(height)
    r, z = (axis.ravel() * length for axis in np.meshgrid(radius, height, indexing="ij"))
    scale = velocity**2, velocity**2 / length, velocity**2 / length
    return {
        "m": np.repeat([float(m) for m in phi], size),
        "R": np.tile(r, len(phi)),
        "z": np.tile(z, len(phi)),
    } | {
        name: np.concatenate([block[2][m].ravel() * one for m in phi])
        for name, block, one in zip(("phi", "dphi_dR", "dphi_dz"), blocks, scale, strict=True)
    }


def _block(section: Section, title: str) -> tuple[list[str], Array]:
    """Return the names of the columns after the first, and the rows, below a title."""
    lines = _below(section, title)
    if not lines or not lines[0].startswith("#radius"):
        raise StreamkitError(f"{section.where}: below {title} expected a line that begins with #radius")
    return lines[0].split("\t")[1:], _rows(section, lines[1:], len(lines[0].split("\t")))


def _grids(section: Section, title: str) -> tuple[Array, Array, dict[int, Array]]:
    """Return R (k,), z (j,) and the grid (k, j) of each m below a title."""
    lines = _below(section, title)
    starts = [k for k, line in enumerate(lines) if line.endswith("#m")]
    grids: dict[int, Array] = {}
    axes: list[tuple[Array, Array]] = []
    for first, end in pairwise([*starts, len(lines)]):
        head = lines[first + 1].split("\t")[1:] if first + 1 < end else []
        try:
            order, height = int(lines[first].split("\t")[0]), np.array(head, dtype=float)
        except ValueError:
            raise StreamkitError(f"{section.where}: below {title} expected an m, and a line with z") from None
        rows = _rows(section, lines[first + 2 : end], len(head) + 1)
        axes.append((rows[:, 0], height))
        grids[order] = rows[:, 1:]
    same = all(np.array_equal(a, b) for axis in axes for a, b in zip(axis, axes[0], strict=True))
    if not same or 0 not in grids:
        raise StreamkitError(f"{section.where}: below {title} expected m = 0, and all m on the same R and z")
    return *axes[0], grids


def _below(section: Section, title: str) -> list[str]:
    """Return the lines below a title, up to the next title."""
    lines = [line.rstrip() for line in section.lines if line.strip()]
    if title not in lines:
        raise StreamkitError(f"{section.where}: has no {title} after Coefficients")
    first = lines.index(title) + 1
    ends = [k for k in range(first, len(lines)) if lines[k] in ("#Phi", "#dPhi/dr", "#dPhi/dR", "#dPhi/dz")]
    return lines[first : ends[0] if ends else len(lines)]


def _rows(section: Section, lines: list[str], width: int) -> Array:
    try:
        rows = np.array([[float(word) for word in line.split()] for line in lines])
    except ValueError:
        rows = np.zeros(0)
    if rows.ndim != 2 or rows.shape[1] != width or not np.isfinite(rows).all():
        raise StreamkitError(f"{section.where}: expected rows of {width} finite numbers in its table")
    return rows
