"""Mass inside a radius and circular velocity of any sum of potentials, by Gauss's law."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache

import numpy as np

from streamkit.components import Potential
from streamkit.errors import blamed
from streamkit.phase import Array
from streamkit.units import G

POLAR = 20
"""Gauss-Legendre nodes per hemisphere."""
AZIMUTH = 16
"""Equal angles: exact for every harmonic below this order."""


@cache
def _sphere() -> tuple[Array, Array]:
    """Directions (3, k) over the sphere and weights (k,) of a mean over it.

    cos(theta) = s^3 crowds the nodes at the plane, where a thin disc pulls within a few degrees.
    """
    s, w = np.polynomial.legendre.leggauss(POLAR)
    s, w = 0.5 * (1 + s), 0.5 * w
    mu = np.concatenate([-(s[::-1] ** 3), s**3])
    weight = np.concatenate([(3 * s**2 * w)[::-1], 3 * s**2 * w])
    phi = (np.arange(AZIMUTH) + 0.5) * 2 * np.pi / AZIMUTH
    sine = np.sqrt(1 - mu**2)
    x, y = np.outer(sine, np.cos(phi)), np.outer(sine, np.sin(phi))
    directions = np.stack([x, y, np.outer(mu, np.ones(AZIMUTH))])
    return directions.reshape(3, -1), np.repeat(weight / weight.sum() / AZIMUTH, AZIMUTH)


@cache
def _circle() -> Array:
    """Directions (3, k) around the plane z = 0."""
    phi = (np.arange(AZIMUTH) + 0.5) * 2 * np.pi / AZIMUTH
    return np.stack([np.cos(phi), np.sin(phi), np.zeros(AZIMUTH)])


def inward(potentials: Sequence[Potential], directions: Array, radii: Array) -> Array:
    """(nr, k) Inward radial acceleration in (km/s)^2/kpc today, at radii (nr,) along directions (3, k)."""
    x, y, z = np.ascontiguousarray(directions[:, None, :] * radii[:, None]).reshape(3, -1)
    total = np.zeros((3, len(x)))
    for potential in potentials:
        parameters = potential.internal().tolist()
        with blamed(f"potential {potential.kind}"):
            total += np.stack(type(potential).acceleration(x, y, z, np.zeros_like(x), *parameters))
    shape = (3, len(radii), directions.shape[1])
    return np.asarray(-np.einsum("crk,ck->rk", total.reshape(shape), directions))


def mass_inside(potentials: Sequence[Potential], radii: Array) -> Array:
    """(nr,) Mass in Msun inside radii (nr,) in kpc: ``r^2 <-a_r> / G``, the mean taken over the sphere."""
    radii = np.asarray(radii, dtype=float)
    directions, weights = _sphere()
    return np.asarray(radii**2 / G * (inward(potentials, directions, radii) @ weights))


def circular_velocity(potentials: Sequence[Potential], radii: Array) -> Array:
    """(nr,) Circular velocity in km/s at radii (nr,) in kpc in the plane: ``sqrt(R <-a_R>)`` over azimuth."""
    radii = np.asarray(radii, dtype=float)
    pull = inward(potentials, _circle(), radii).mean(axis=1)
    return np.asarray(np.sqrt(np.maximum(radii * pull, 0.0)))


def profiles(models: Iterable[Sequence[Potential]], radii: Array) -> tuple[Array, Array]:
    """Return M (n, nr) in Msun and v_c (n, nr) in km/s of n potentials at radii (nr,) in kpc."""
    both = [(mass_inside(p, radii), circular_velocity(p, radii)) for p in models]
    shape = (-1, len(radii))
    return np.reshape([m for m, _ in both], shape), np.reshape([v for _, v in both], shape)
