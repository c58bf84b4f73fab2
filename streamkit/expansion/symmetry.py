"""What a force is the same under: turned about an axis, mirrored, at other times. Found by asking it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass
from typing import TypeAlias

import numpy as np

from streamkit.stream import Array
from streamkit.units import GYR

ForceAt: TypeAlias = Callable[[float, Array], Array]  # acceleration (3, n) at one time and positions (3, n)

POINTS, SEED = 48, 14
# Times other than today at which a force is compared with that of today, in kpc/(km/s).
TIMES = tuple(t * GYR for t in (-6.0, -2.3, -0.7, -0.1, 0.3))


@dataclass(frozen=True)
class Symmetry:
    """Whether a force is static; spherical; the same at all azimuths, on both sides of z = 0, y = 0; at -x, -y."""

    static: bool
    spherical: bool
    axisymmetric: bool
    mirror: bool
    sideways: bool
    half_turn: bool


def symmetry_of(force: ForceAt, tolerance: float, times: Sequence[float] | Array = (0.0,)) -> Symmetry:
    """Return the symmetries that hold to a relative tolerance at all times, at random positions from 0.1 to 500 kpc."""
    each = [astuple(_symmetry_at(force, tolerance, float(t))) for t in times]
    return Symmetry(*(all(held) for held in zip(*each, strict=True)))


def _symmetry_at(force: ForceAt, tolerance: float, now: float) -> Symmetry:
    q = random_positions(POINTS, np.random.default_rng(SEED))
    r = np.sqrt((q**2).sum(axis=0))
    turns = [_turn(angle) for angle in (0.9, 2.0, 3.6)]
    flip, aside, half = np.diag([1.0, 1.0, -1.0]), np.diag([1.0, -1.0, 1.0]), np.diag([-1.0, -1.0, 1.0])
    tilts = [tilt @ turn for tilt, turn in zip((_tilt(0.7), _tilt(1.9)), turns, strict=False)]
    maps = [np.eye(3), *turns, flip, aside, half, *tilts]
    here, *others = np.split(force(now, np.concatenate([m @ q for m in maps], axis=1)), len(maps), axis=1)
    size = np.sqrt((here**2).sum(axis=0)) + 1e-300

    def same(index: int) -> bool:
        difference = others[index] - maps[1 + index] @ here
        return bool((np.sqrt((difference**2).sum(axis=0)) <= tolerance * size).all())

    static = all((np.sqrt(((force(t, q) - here) ** 2).sum(axis=0)) <= 1e-9 * size).all() for t in TIMES)
    across = here - (here * q).sum(axis=0) * q / r**2
    radial = bool((np.sqrt((across**2).sum(axis=0)) <= tolerance * size).all())
    around = all(same(k) for k in range(3))
    return Symmetry(
        static=static,
        spherical=radial and around and same(6) and same(7),
        axisymmetric=around,
        mirror=same(3),
        sideways=same(4),
        half_turn=same(5),
    )


def random_positions(count: int, generator: np.random.Generator) -> Array:
    """(3, count) random positions: half from 0.1 to 500 kpc and half from 3 to 150, half of each crowding at z = 0."""
    k = np.arange(count)
    low, high = np.where(k % 2, 3.0, 0.1), np.where(k % 2, 150.0, 500.0)
    r = low * (high / low) ** generator.uniform(size=count)
    mu = generator.uniform(-1, 1, count)
    mu = np.where(k % 4 < 2, mu, mu**3)
    phi = generator.uniform(0, 2 * np.pi, count)
    sine = np.sqrt(1 - mu**2)
    return np.asarray(r * np.stack([sine * np.cos(phi), sine * np.sin(phi), mu]))


def _turn(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _tilt(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
