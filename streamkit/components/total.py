"""Potentials added up through NumPy, and the circular speed of their sum."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np

from streamkit.components.potential import Potential
from streamkit.errors import blamed
from streamkit.stream import Array, read_only

AZIMUTH = 16
"""Equal angles: exact for every harmonic below this order."""


def add_up(what: str, potentials: Iterable[Potential], q: Array) -> Array:
    """Add up a static method of potentials at positions q (3, n) today, called with whole arrays.

    Parameters
    ----------
    what
        "acceleration": (3, n) in (km/s)^2/kpc; "potential": (n,) in (km/s)^2.
    potentials
        All centred on the origin.
    q
        (3, n) kpc.

    Raises ComponentError if one of them fails.
    """
    x, y, z = read_only(np.ascontiguousarray(q))
    t = read_only(np.zeros_like(x))
    total: Array = np.zeros(())
    for potential in potentials:
        with blamed(f"potential {potential.kind}"):
            parameters = potential.in_engine_units()
            total = total + np.stack(getattr(type(potential), what)(x, y, z, t, *parameters))
    return total


def circular_speed(potentials: Iterable[Potential], radius: float) -> float:
    """Return ``sqrt(R <-a_R>)`` in km/s at a radius in kpc in the plane z = 0, the mean over the azimuth.

    Zero where the mean force is outward; NaN where there is no force.
    """
    around = circle()
    with np.errstate(all="ignore"):
        outward = (add_up("acceleration", potentials, radius * around) * around).sum(axis=0).mean()
    return float(np.sqrt(np.maximum(-radius * outward, 0.0)))


@cache
def circle() -> Array:
    """Directions (3, k) around the plane z = 0."""
    phi = (np.arange(AZIMUTH) + 0.5) * 2 * np.pi / AZIMUTH
    return np.stack([np.cos(phi), np.sin(phi), np.zeros(AZIMUTH)])
