"""Real spherical harmonics, as polynomials in the unit vector, and integrals over the sphere."""

from __future__ import annotations

from functools import cache

import numpy as np

from streamkit.stream import Array


def legendre(l_max: int, m_max: int, mu: Array) -> dict[tuple[int, int], tuple[Array, Array]]:
    """Return (l, m) -> (n,) P_lm(mu) / sin(theta)^m and its derivative with respect to mu, for mu (n,).

    Normalised so that the mean square over the sphere of P_lm cos(m phi), and of P_lm sin(m phi), is 1.
    """
    polynomials: dict[tuple[int, int], tuple[Array, Array]] = {}
    sectoral = np.ones_like(mu)
    for m in range(m_max + 1):
        if m:
            sectoral = sectoral * np.sqrt((2 * m + 1) / (2 * m) * (2.0 if m == 1 else 1.0))
        before: tuple[Array, Array] = np.zeros_like(mu), np.zeros_like(mu)
        here: tuple[Array, Array] = sectoral, np.zeros_like(mu)
        for degree in range(m, l_max + 1):
            polynomials[degree, m] = here
            n = degree + 1
            a = np.sqrt((4 * n * n - 1) / (n * n - m * m))
            b = np.sqrt(((n - 1) ** 2 - m * m) / (4 * (n - 1) ** 2 - 1)) if n > 1 else 0.0
            value = a * (mu * here[0] - b * before[0])
            slope = a * (here[0] + mu * here[1] - b * before[1])
            before, here = here, (value, slope)
    return polynomials


def names(l_max: int, m_max: int, even: bool = False) -> list[tuple[int, int]]:
    """Return (l, m) of all harmonics, m < 0 for sines; with ``even`` those of triaxial bodies on their axes alone."""
    if even:
        return [(n, m) for n in range(0, l_max + 1, 2) for m in range(0, min(n, m_max) + 1, 2)]
    return [(n, m) for n in range(l_max + 1) for m in range(-min(n, m_max), min(n, m_max) + 1)]


@cache
def quadrature(l_max: int, m_max: int) -> tuple[Array, Array]:
    """Directions (3, k), and weights (k,) of a mean over the sphere that is exact up to the degree 2 l_max."""
    mu, weight = np.polynomial.legendre.leggauss(2 * l_max + 2)
    azimuths = 1 if m_max == 0 else 4 * m_max + 2
    phi = 2 * np.pi * (np.arange(azimuths) + 0.5) / azimuths
    sine = np.sqrt(1 - mu**2)
    x, y = np.outer(sine, np.cos(phi)), np.outer(sine, np.sin(phi))
    directions = np.stack([x, y, np.outer(mu, np.ones(azimuths))]).reshape(3, -1)
    return directions, np.repeat(weight / 2 / azimuths, azimuths)


def at_directions(harmonics: list[tuple[int, int]], directions: Array) -> Array:
    """(h, k) Values of the harmonics in directions (3, k)."""
    x, y, z = directions
    l_max = max(n for n, _ in harmonics)
    polynomials = legendre(l_max, max(abs(m) for _, m in harmonics), z)
    powers = (x + 1j * y)[None] ** np.arange(l_max + 1)[:, None]
    parts = [polynomials[n, abs(m)][0] * (powers[m].real if m >= 0 else powers[-m].imag) for n, m in harmonics]
    return np.array(parts)
