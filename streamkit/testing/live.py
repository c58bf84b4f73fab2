"""Checks of a scheme that follows a live progenitor, in a Plummer sphere on an eccentric, inclined orbit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from streamkit import Array, BlockEdge, G, LiveStripping, Population, Potential, Remnant
from streamkit.engine import build_field
from streamkit.testing.common import Check, require
from streamkit.testing.hosts import MASS, Satellite, progenitor_orbit

COUNT = 400
LOOKBACK = -3.0
BRACKET = 900.0  # (km/s/kpc)^2: a tidal radius of 1.5 kpc for the mass of the checks
NOISE = 0.05  # of a force by so few particles, in units of its largest value
AWAY = 1e3  # kpc: no progenitor binds particles at this distance


class PlummerSphere:
    """The progenitor of the checks: its particles are slower than they are in equilibrium, and all are bound."""

    potential: Potential = Satellite(mass=MASS, radius=0.85)
    mass, scale, cut = MASS, 0.85, 17.0

    def mass_inside(self, r: Array) -> Array:
        """(n,) Mass in Msun inside radii r (n,) in kpc."""
        return np.asarray(self.mass * (1 + (self.scale / r) ** 2) ** -1.5)

    def sample(self, points: Array) -> tuple[Array, Array]:
        """Return positions and velocities (3, n) from uniform random numbers (6, n)."""
        r = self.scale / np.sqrt((0.99 * points[0] + 0.005) ** (-2 / 3) - 1)
        speed = 0.7 * np.cbrt(points[1]) * np.sqrt(2 * G * self.mass / np.hypot(r, self.scale))
        return r * _direction(points[2:4]), speed * _direction(points[4:6])

    def weigh(self, q: Array, v: Array, density: Callable[[Array], Array]) -> Array:
        """(n,) Weights with a mean of 1: here of the density alone."""
        r = np.sqrt((q**2).sum(axis=0))
        weight = density(r) * (1 + (r / self.scale) ** 2) ** 2.5
        return np.asarray(weight / weight.mean())


def _direction(points: Array) -> Array:
    z, angle = 2 * points[0] - 1, 2 * np.pi * points[1]
    return np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z])


def core_of_start() -> Array:
    """(9,) Position, velocity and acceleration of the progenitor at the look-back time."""
    orbit = progenitor_orbit(LOOKBACK)
    return np.concatenate([orbit.q[:, 0], orbit.v[:, 0], orbit.a[:, 0]])


def _points(scheme: LiveStripping) -> Array:
    return np.random.default_rng(7).random((scheme.draws, COUNT))


def first_edge(people: Population, core: Array) -> BlockEdge:
    """Return the edge at the look-back time."""
    q, v = (np.ascontiguousarray(x) for x in (people.q, people.v))
    return BlockEdge(LOOKBACK, LOOKBACK, q, v, people.mass, core, BRACKET)


def _both(people: Population) -> Array:
    return np.concatenate([people.q, people.v])


def populate_has_the_right_shape(scheme: LiveStripping) -> None:
    """Check that ``populate`` gives finite q, v (3, n), masses and weights (n,), and alters no argument."""
    core, points = core_of_start(), _points(scheme)
    before = core.copy(), points.copy()
    people = scheme.populate(core, PlummerSphere(), points)
    shapes = [np.shape(x) for x in (people.q, people.v, people.mass, people.weight)]
    require(shapes == [(3, COUNT), (3, COUNT), (COUNT,), (COUNT,)], f"q, v, mass and weight have shapes {shapes}")
    require(all(np.isfinite(x).all() for x in (people.q, people.v, people.mass, people.weight)), "not all is finite")
    require((people.mass >= 0).all(), "a particle has a negative mass")
    require(abs(people.weight.mean() - 1) < 0.1, f"the mean of the weights is {people.weight.mean():.3g}, expected 1")
    same = np.array_equal(before[0], core) and np.array_equal(before[1], points)
    require(same, "populate changes its arguments")


def chance_is_an_argument(scheme: LiveStripping) -> None:
    """Check that the same numbers give the same particles, that each depends on its own, and that all are used."""
    core, points = core_of_start(), _points(scheme)
    whole = _both(scheme.populate(core, PlummerSphere(), points))
    again = _both(scheme.populate(core, PlummerSphere(), points))
    require(np.array_equal(whole, again), "two calls with the same numbers differ: draw nothing yourself")
    for row in range(scheme.draws):
        other = points.copy()
        other[row] = np.random.default_rng(9).random(COUNT)
        changed = _both(scheme.populate(core, PlummerSphere(), other))
        require(not np.array_equal(changed, whole), f"row {row} of the numbers changes nothing: draws is too large")


def moves_with_the_core(scheme: LiveStripping) -> None:
    """Check that the particles are centred on the progenitor, in position and velocity."""
    core = core_of_start()
    people = scheme.populate(core, PlummerSphere(), _points(scheme))
    for what, values, centre in (("position", people.q, core[:3]), ("velocity", people.v, core[3:6])):
        spread = values.std(axis=1).max()
        off = np.abs(np.median(values, axis=1) - centre).max()
        require(off < 0.5 * spread, f"the median {what} is {off:.3g} from the progenitor's, the spread is {spread:.3g}")


def update_remnant_says_what_is_left(scheme: LiveStripping) -> None:
    """Check the force, the mass and the bound particles of two edges, the second with particles far away.

    These are not bound; the force pulls inwards; the same call gives the same; and no argument is altered.
    """
    core = core_of_start()
    people = scheme.populate(core, PlummerSphere(), _points(scheme))
    edge = first_edge(people, core)
    before = edge.q.copy(), edge.v.copy(), core.copy()
    first = scheme.update_remnant(edge, PlummerSphere(), None)
    _sound(first)
    require(first.bound.mean() > 0.5, f"only {first.bound.mean():.0%} of a sphere are bound at the look-back time")
    require(all(map(np.array_equal, before, (edge.q, edge.v, core))), "update_remnant changes its arguments")
    far = edge.q.copy()
    far[:, ::4] += AWAY
    gone = BlockEdge(LOOKBACK, edge.t + 0.02, far, edge.v, edge.mass, core, BRACKET)
    second = scheme.update_remnant(gone, PlummerSphere(), first)
    _sound(second)
    require(not second.bound[::4].any(), f"particles {AWAY:g} kpc away are bound")
    require(second.mass <= first.mass * (1 + 1e-9), "a quarter of the particles is gone, and the mass has grown")
    again = scheme.update_remnant(gone, PlummerSphere(), first)
    same = again.mass == second.mass and np.array_equal(again.bound, second.bound)
    require(same, "two calls with the same particles differ: keep nothing yourself")


def _sound(remnant: Remnant) -> None:
    require(np.shape(remnant.bound) == (COUNT,), f"bound has the shape {np.shape(remnant.bound)}")
    require(np.isfinite(remnant.mass) and remnant.mass >= 0, f"the bound mass is {remnant.mass!r}")
    places = np.geomspace(0.4, 20.0, 30) * np.array([[0.6], [0.0], [0.8]])  # too few particles are further in
    pull = build_field([remnant.force]).acceleration(0.0, places)
    inward = -(pull * places).sum(axis=0) / np.sqrt((places**2).sum(axis=0))
    noise = NOISE * np.abs(inward).max()
    require(bool(np.isfinite(pull).all() and (inward >= -noise).all()), "the force does not pull inwards everywhere")


def says_its_step(scheme: LiveStripping) -> None:
    """Check that ``longest_step`` is a positive time."""
    step = scheme.longest_step(PlummerSphere(), progenitor_orbit(LOOKBACK))
    require(step > 0, f"the longest step is {step!r}, expected a positive time")


CHECKS: tuple[Check, ...] = (
    populate_has_the_right_shape,
    chance_is_an_argument,
    moves_with_the_core,
    update_remnant_says_what_is_left,
    says_its_step,
)
