"""A series of snapshots as the table of a `multipole` potential, and how far it can be trusted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from streamkit import Array, StreamkitError
from streamkit_hosts.compare import LIMIT, median_change, places
from streamkit_hosts.multipoles import inwards, names, of_particles
from streamkit_hosts.path import moved_by, path_of, told
from streamkit_hosts.snapshot import Particles, read
from streamkit_hosts.table import check_rows, force_of, table_of

INNERMOST = 300  # particles inside the first radius
CENTRE = 0.01  # kpc: the first radius, down to which the innermost multipoles are continued
OUTSIDE = 1e-3  # share of the particles outside the last radius
FEWEST = 10_000  # particles
PART = 0.1  # largest error of a response in units of itself: it is some per cent of the host's force
SHRINK, CORE = 0.7, 1000  # of the spheres by which a centre is found, down to so many particles


@dataclass(frozen=True)
class Series:
    """A table of multipoles in time, as `streamkit.multipole_table` makes it, with its errors."""

    table: Any
    times: Array  # (T,) in Gyr, 0 today
    radii: Array  # (k,) in kpc
    l_max: int
    # Median relative change of the force between the first and the last radius, the largest of all snapshots: without
    # the two highest degrees, and between two halves of the particles over 2, which is the noise of all. Of a response
    # that of the last snapshot, in units of the response.
    truncation: float
    noise: float
    moved: float  # largest distance in kpc of a centre from the last one
    path: dict[str, list[float]] = field(default_factory=dict)  # the columns of `centre`; none for a host at rest
    response: bool = False  # whether the table has the degrees from 1 on alone

    def warnings(self) -> list[str]:
        """Return a sentence for each reason not to trust the table."""
        said = []
        if self.response:
            if self.noise > PART:
                much = f"their noise is {self.noise:.0%} of the response today"
                said.append(f"too few particles: {much}. Lower --l-max or --radii")
            return said
        if self.truncation > max(LIMIT, 2 * self.noise):
            said.append(
                f"the expansion does not converge: without the degrees above {self.l_max - 2} the force changes by "
                f"{self.truncation:.1%}. Raise --l-max"
            )
        if self.noise > LIMIT:
            said.append(f"too few particles: their noise in the force is {self.noise:.1%}. Lower --l-max or --radii")
        if self.moved > self.radii[0]:
            said.append(told(self.moved, self.path))
        return said


def expand(
    files: Sequence[Path], *, types: Sequence[int] = (), l_max: int = 4, radii: int = 25, centred: bool = True,
    response: bool = False, tell: Callable[[str], None] | None = None,
) -> Series:  # fmt: skip
    """Return the multipoles of snapshots, of which the last in time is today.

    Parameters
    ----------
    files
        Snapshots in the Gadget layout, in any order.
    types
        Types of particles; all without any.
    l_max, radii
        Largest degree, and number of radii, evenly spaced in the logarithm.
    centred
        Take the densest place of each snapshot as its centre; else the origin.
    response
        The degrees from 1 on alone, for the kind `response`.
    tell
        Called with a line for each snapshot.

    Raises StreamkitError with a sentence for a snapshot that cannot be used, or a table that would be too large.
    """
    check_rows(
        len(files) * (l_max + 1) ** 2 * radii,
        f"{len(files)} snapshots, {(l_max + 1) ** 2} harmonics, {radii} radii",
        "take fewer snapshots, or a lower --l-max",
    )
    shells = whole = np.zeros(0)
    parts, times, centres, errors = [], [], [], []
    for file in files:
        snapshot = read(file, types)
        if len(snapshot.mass) < FEWEST:
            raise StreamkitError(f"{file}: has {len(snapshot.mass)} particles; expected {FEWEST} or more")
        centre = densest(snapshot) if centred else np.zeros(3)
        q = snapshot.q - centre[:, None]
        shells = shells if len(shells) else _radii(q, radii)
        phi = of_particles(q, snapshot.mass, shells, l_max)
        errors.append(_errors(q, snapshot.mass, shells, phi, l_max, int(response)))
        whole, phi = inwards(phi, shells, l_max, CENTRE)
        parts.append(phi)
        times.append(snapshot.time)
        centres.append(centre)
        if tell is not None:
            tell(f"{file}: {snapshot.time:.4g} Gyr, {len(snapshot.mass)} particles, {snapshot.mass.sum():.4g} Msun")
    order = np.argsort(times)
    now = np.array(times)[order]
    if (same := np.flatnonzero(np.diff(now) <= 0)).size:
        first, second = (files[order[same[0] + k]] for k in (0, 1))
        raise StreamkitError(f"{first} and {second} have the same time, {now[same[0]]:.4g} Gyr: give one of them")
    truncation, noise = errors[order[-1]] if response else np.max(errors, axis=0)
    in_order = np.array(centres)[order]
    moved = moved_by(in_order)
    kept = slice(int(response), None)  # of the harmonics, of which the mean is the first
    table = table_of(now - now[-1], whole, names(l_max)[kept], np.array(parts)[order][:, kept])
    path = path_of(now - now[-1], in_order) if moved > shells[0] else {}
    return Series(table, now - now[-1], shells, l_max, float(truncation), float(noise), moved, path, response)


def densest(snapshot: Particles) -> Array:
    """(3,) The centre of mass of ever smaller spheres (Power+ 2003, MNRAS 338, 14)."""
    q, mass = snapshot.q, snapshot.mass
    centre = np.average(q, axis=1, weights=mass)
    r = np.sqrt(((q - centre[:, None]) ** 2).sum(axis=0))
    size = np.quantile(r, 0.9)
    while True:
        inside = r < size
        if np.count_nonzero(inside) < CORE:
            return np.asarray(centre)
        q, mass = q[:, inside], mass[inside]
        centre, size = np.average(q, axis=1, weights=mass), SHRINK * size
        r = np.sqrt(((q - centre[:, None]) ** 2).sum(axis=0))


def _radii(q: Array, count: int) -> Array:
    r = np.sort(np.sqrt((q**2).sum(axis=0)))
    return np.geomspace(r[INNERMOST], r[int((1 - OUTSIDE) * (len(r) - 1))], count)


def _errors(q: Array, mass: Array, radii: Array, phi: Array, l_max: int, first: int) -> tuple[float, float]:
    """Truncation and noise of one snapshot, see `Series`; of the harmonics from number ``first`` on."""
    place = places(radii[0], radii[-1], seed=len(mass))
    lower = phi.copy()
    lower[[n > max(l_max - 2, 0) for n, _ in names(l_max)]] = 0.0
    halves = [of_particles(q[:, k::2], 2 * mass[k::2], radii, l_max) for k in (0, 1)]
    every = np.stack([phi, lower, *halves])
    every[:, :first] = 0.0
    whole, low, one, other = (force_of(each, radii, names(l_max), place) for each in every)
    return median_change(whole, low, whole), median_change(one, other, whole) / 2
