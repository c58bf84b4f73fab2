"""Expand a force: choose the form and the nodes by the error at held-out points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from streamkit import engine
from streamkit.errors import OutOfDomain
from streamkit.expansion.forces import Expansion, expansion_in_time, expansion_of
from streamkit.expansion.grid import Grid
from streamkit.expansion.symmetry import ForceAt, Symmetry, random_positions, symmetry_of
from streamkit.stream import Array

# Forms of an expansion, as a run file names them.
Form: TypeAlias = Literal["auto", "spherical", "axisymmetric", "general", "none"]

# Points at which an expansion is compared with the force: when its nodes are chosen, and for other parameters.
HELD_OUT, AGAIN = 512, 64
# Nodes are added until the error is this fraction of the tolerance: at other parameters it may be larger.
MARGIN = 0.5
MOST_NODES = 100_000  # most nodes
SLOWEST = 0.05  # refinement ends if the error falls with a lower power of the number of nodes
ROUND = 1e-5  # symmetries hold to this fraction of the tolerance
THICKNESS = (np.inf, 3.0, 0.3)  # scale heights in kpc to try; infinite without a disc
SOME = 5  # times at which a grid is chosen for a force that changes, of those that it is expanded at
NEIGHBOURS = 25  # places at about the same radius, if errors are relative to the root mean square of the force there
CORE = 1.0  # inside this radius in kpc errors are relative to the typical acceleration: it may vanish at the centre

_TODAY = np.zeros(1)


class NoExpansion(Exception):  # noqa: N818  a statement about a potential, whose name the caller adds
    """A force has no expansion; the message has the reason and a remedy."""


@dataclass(frozen=True)
class Expanded:
    """An expansion, and its error."""

    force: Expansion  # the force in the compiled loop
    grid: Grid
    # Largest relative error of the acceleration, and the number of held-out points at which it was found.
    error: float
    points: int
    times: int = 0  # number of times of a force that changes

    def scaled(self, factor: float) -> Expanded:
        """Return the expansion of the force times a factor."""
        return replace(self, force=self.force.scaled(factor))

    def text(self) -> str:
        """Describe it in a line."""
        grid = self.grid
        size = [f"{grid.radii} radii"]
        if grid.heights > 1:
            size.append(f"{grid.heights} polar angles")
        if grid.angles > 1:
            size.append(f"{grid.angles} azimuths (m up to {grid.orders[-1]})")
        if self.times:
            size.append(f"{self.times} times")
        return (
            f"{grid.form} expansion, {' x '.join(size)}, largest error {self.error:.1g} at {self.points} "
            "held-out points"
        )


def expand(
    force: ForceAt,
    form: Form,
    tolerance: float,
    times: Array | None = None,
    vanishes: bool = False,
    order: int | None = None,
) -> Expanded:
    """Expand a force in a form, with the fewest nodes that meet the tolerance at held-out points.

    The tolerance is the largest relative error |da| / |a| from 0.1 to 500 kpc. If the force ``vanishes`` at some
    places, errors are relative to its root mean square at about the same radius, if that is larger. The form ``auto``
    is the simplest that the force's symmetries allow. A force that changes is expanded at increasing ``times`` (n,) in
    kpc/(km/s), between which it is a cubic spline. A known ``order`` is the largest m of the harmonics.

    Raises NoExpansion if the force depends on time and there are no times, is not finite somewhere, or `MOST_NODES`
    nodes miss the tolerance.
    """
    some = _some(times)
    symmetry = symmetry_of(force, max(tolerance * ROUND, 1e-11), some)
    if not symmetry.static and times is None:
        raise NoExpansion(
            "it changes in time, and has no `known_times` to be expanded at: give since, the earliest time, where the "
            'kind takes it; or set expansion = "none", which is slow'
        )
    check = _Check(force, HELD_OUT, some, vanishes)
    if not np.isfinite(check.exact).all():
        raise NoExpansion('its force is not finite everywhere from 0.1 to 500 kpc: set expansion = "none"')
    form = _form(symmetry) if form == "auto" else form
    tried = [_try(force, _with_order(grid, order), check) for grid in _starts(form, symmetry)]
    best = min(tried, key=lambda expanded: expanded.error)
    while best.error > MARGIN * tolerance:
        grids = dict.fromkeys(_with_order(grid, order) for grid in _finer(best.grid))
        finer = [grid for grid in grids if best.grid.nodes < grid.nodes <= MOST_NODES]
        gains = [(_gain(best, expanded), expanded) for expanded in (_try(force, grid, check) for grid in finer)]
        gain, better = max(gains, key=lambda pair: pair[0], default=(0.0, best))
        if gain < SLOWEST:
            break
        best = better
    if not best.error <= tolerance:
        raise NoExpansion(
            f"its {form} expansion misses the tolerance {tolerance:g}: with {best.grid.nodes} nodes the largest "
            f"error is {best.error:.1g}, at {check.place(best.force)}. Raise the tolerance, "
            + ('take expansion = "auto", ' if form != _form(symmetry) else "")
            + 'or set expansion = "none", which calls the potential itself'
        )
    if times is None or symmetry.static:
        return best
    whole = _at_all_times(force, best.grid, HELD_OUT, times, vanishes)
    if not whole.error <= tolerance:
        raise NoExpansion(
            f"between its {len(times)} times it misses the tolerance {tolerance:g}: the largest error is "
            f"{whole.error:.1g}. Give it more times, or raise the tolerance"
        )
    return whole


def expand_like(
    model: Expanded, force: ForceAt, tolerance: float, missed: str, times: Array | None = None, vanishes: bool = False
) -> Expanded:
    """Expand a force at the nodes of another expansion: it is then a smooth function of the parameters.

    Raises OutOfDomain with the sentence ``missed`` where that misses the tolerance.
    """
    try:
        if times is not None and model.times:
            expanded = _at_all_times(force, model.grid, AGAIN, times, vanishes)
        else:
            expanded = _try(force, model.grid, _Check(force, AGAIN, vanishes=vanishes))
    except NoExpansion:
        raise OutOfDomain(missed) from None
    if not expanded.error <= tolerance:
        raise OutOfDomain(missed)
    return expanded


def _some(times: Array | None) -> Array:
    """Return the times at which a grid is chosen: today without any."""
    if times is None:
        return _TODAY
    return np.asarray(times[np.unique(np.linspace(0, len(times) - 1, SOME).astype(int))])


def _at_all_times(force: ForceAt, grid: Grid, count: int, times: Array, vanishes: bool) -> Expanded:
    """Expand a force at all times, and compare it between them."""
    expansion = expansion_in_time(grid, times, (_at_nodes(force, t, grid) for t in times))
    check = _Check(force, count, 0.5 * (times[1:] + times[:-1]), vanishes)
    return Expanded(expansion, grid, float(check.errors(expansion).max()), len(check.r), len(times))


class _Check:
    """Compares expansions with the force at points between the nodes, in turn at each of the times."""

    def __init__(self, force: ForceAt, count: int, times: Array = _TODAY, vanishes: bool = False) -> None:
        self.vanishes = vanishes
        self.q = random_positions(count, np.random.default_rng(count))
        self.times = times[np.arange(count) * len(times) // count]
        self.exact = np.concatenate([force(t, self.q[:, self.times == t]) for t in np.unique(self.times)], axis=1)
        self.r = np.sqrt((self.q**2).sum(axis=0))

    @cached_property
    def size(self) -> Array:
        """(n,) The acceleration that errors are relative to."""
        size = np.sqrt((self.exact**2).sum(axis=0))
        if self.vanishes:
            order = np.argsort(self.r)
            near = np.ones(min(NEIGHBOURS, len(order)))
            square, count = (np.convolve(a, near, "same") for a in (size[order] ** 2, np.ones(len(order))))
            size[order] = np.maximum(size[order], np.sqrt(square / count))
        inside = self.r < CORE
        typical = np.median(size[inside]) if inside.any() else 0.0
        return np.asarray(np.maximum(np.where(inside, np.maximum(size, typical), size), 1e-300))

    def errors(self, expansion: Expansion) -> Array:
        """(n,) Relative errors."""
        acceleration = engine.build_field([expansion]).acceleration(self.times, self.q)
        return np.asarray(np.sqrt(((acceleration - self.exact) ** 2).sum(axis=0)) / self.size)

    def place(self, expansion: Expansion) -> str:
        """Return where the error is largest."""
        i = int(np.argmax(self.errors(expansion)))
        return f"({', '.join(f'{x:.3g}' for x in self.q[:, i])}) kpc"


def _at_nodes(force: ForceAt, t: float, grid: Grid) -> Array:
    q = grid.positions()
    values = force(t, q)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=0))
    if len(bad):
        where = np.sqrt((q[:, bad[0]] ** 2).sum())
        raise NoExpansion(f'its force is not finite at a radius of {where:.3g} kpc: set expansion = "none"')
    return values


def _try(force: ForceAt, grid: Grid, check: _Check) -> Expanded:
    """Expand a force at the time of the check, or at each of its times by itself."""
    each = [(expansion_of(grid, _at_nodes(force, t, grid)), check.times == t) for t in np.unique(check.times)]
    error = max(float(check.errors(expansion)[there].max()) for expansion, there in each)
    return Expanded(each[-1][0], grid, error, len(check.r))


def _gain(old: Expanded, new: Expanded) -> float:
    """Power of the number of nodes with which the error falls."""
    return float(np.log(old.error / max(new.error, 1e-300)) / np.log(new.grid.nodes / old.grid.nodes))


def _form(symmetry: Symmetry) -> Form:
    return "spherical" if symmetry.spherical else "axisymmetric" if symmetry.axisymmetric else "general"


def _starts(form: Form, symmetry: Symmetry) -> list[Grid]:
    if form == "spherical":
        return [Grid(50)]
    heights = 13 if symmetry.mirror else 25
    flat = [Grid(50, heights, thickness=h, mirror=symmetry.mirror) for h in THICKNESS]
    if form == "axisymmetric":
        return flat
    step, sines = 2 if symmetry.half_turn else 1, not symmetry.sideways
    angles = (6 if sines else 4) * (1 if step == 2 else 2)
    return [replace(grid, angles=angles, step=step, sines=sines) for grid in flat]


def _with_order(grid: Grid, order: int | None) -> Grid:
    """Return the grid with as many azimuths as harmonics up to a known order need."""
    if order is None or grid.angles == 1:
        return grid
    most = order // grid.step
    return replace(grid, angles=2 * most + 2 if grid.sines else most + 2)


def _finer(grid: Grid) -> list[Grid]:
    """Return the grids with more nodes in one direction or in all."""
    radii = grid.radii * 3 // 2
    heights = 2 * (grid.heights * 3 // 4) + 1 if grid.heights > 1 else 1
    angles = grid.angles + (2 if grid.sines or grid.step == 1 else 1) if grid.angles > 1 else 1
    finer = [replace(grid, radii=radii, heights=heights, angles=angles), replace(grid, radii=radii)]
    if heights > 1:
        finer.append(replace(grid, heights=heights))
    if angles > 1:
        finer.append(replace(grid, angles=angles))
    return finer
