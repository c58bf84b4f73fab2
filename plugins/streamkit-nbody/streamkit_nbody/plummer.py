"""The satellite at the start: particles drawn from the isotropic distribution function of a Plummer sphere."""

from __future__ import annotations

import numpy as np

from streamkit import Array, G

TRUNCATION = 20.0  # outermost radius in scale radii; 0.4 % of a Plummer sphere is outside


def sample(n: int, mass: float, radius: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw n particles of a Plummer sphere at rest at the origin, in equilibrium.

    Radii by inversion of M(r) = M r^3 / (r^2 + a^2)^(3/2), up to `TRUNCATION` a. Speeds from f ~ (-E)^(7/2): the
    density of x = (v / v_esc)^2 is x^(1/2) (1 - x)^(7/2), the beta distribution (3/2, 9/2) (Aarseth, Henon & Wielen
    1974, A&A 37, 183, appendix). Returns q (3, n) in kpc and v (3, n) in km/s, with the mean of each taken off.
    """
    inside = (1.0 + TRUNCATION**-2) ** -1.5
    r = radius / np.sqrt((inside * rng.uniform(size=n)) ** (-2.0 / 3.0) - 1.0)
    escape = np.sqrt(2.0 * G * mass / np.sqrt(r * r + radius * radius))
    speed = escape * np.sqrt(rng.beta(1.5, 4.5, size=n))
    q, v = r * _directions(n, rng), speed * _directions(n, rng)
    return q - q.mean(axis=1, keepdims=True), v - v.mean(axis=1, keepdims=True)


def _directions(n: int, rng: np.random.Generator) -> Array:
    """(3, n) Unit vectors, uniform on the sphere."""
    x = rng.standard_normal((3, n))
    return np.asarray(x / np.sqrt((x * x).sum(axis=0)))
