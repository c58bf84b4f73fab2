"""Multipoles of the potential of particles: Phi_lm(r), with the real harmonics of `streamkit.Multipoles`."""

from __future__ import annotations

import numpy as np
from scipy.special import sph_harm_y

from streamkit import Array, G

BLOCK = 100_000  # particles whose harmonics are in memory together


def names(l_max: int) -> list[tuple[int, int]]:
    """Return (l, m) of all harmonics, m < 0 for sines."""
    return [(n, m) for n in range(l_max + 1) for m in range(-n, n + 1)]


def harmonic(n: int, m: int, theta: Array, phi: Array) -> Array:
    """(k,) A real harmonic, whose mean square over the sphere is 1: cos(m phi), and sin(|m| phi) for m < 0."""
    value = np.sqrt(4 * np.pi) * sph_harm_y(n, abs(m), theta, phi)
    part = value.imag if m < 0 else value.real
    return np.asarray(part if m == 0 else np.sqrt(2.0) * (-1.0) ** m * part)


def inwards(phi: Array, radii: Array, l_max: int, first: float) -> tuple[Array, Array]:
    """Return radii from ``first`` on and Phi_lm there, continued as in a core of constant density.

    That is r^l, and a parabola for the mean: without it few particles would make a cusp.
    """
    count = int(np.ceil(np.log(radii[0] / first) / np.log(radii[1] / radii[0]))) + 1
    if count < 2:
        return radii, phi
    inner = np.geomspace(first, radii[0], count)[:-1]
    x = inner / radii[0]
    core = np.array([phi[h, 0] * x**n for h, (n, _) in enumerate(names(l_max))])
    pull = (phi[0, 1] - phi[0, 0]) / ((radii[1] / radii[0]) ** 2 - 1)
    core[0] = phi[0, 0] + pull * (x**2 - 1)
    return np.concatenate([inner, radii]), np.concatenate([core, phi], axis=1)


def of_particles(q: Array, mass: Array, radii: Array, l_max: int) -> Array:
    """(h, k) Phi_lm in (km/s)^2 at radii (k,) of particles at q (3, n) kpc with masses (n,) in Msun.

    The exact sum over all particles: ``-G / (2l + 1) sum m Y_lm r_<^l / r_>^(l+1)``. A particle at the centre counts
    at the innermost radius.
    """
    harmonics = names(l_max)
    r = np.maximum(np.sqrt((q**2).sum(axis=0)), 1e-6 * radii[0])
    shell = np.searchsorted(radii, r, side="left")  # a particle in shell k is inside radius k, outside k - 1
    theta, phi = np.arccos(np.clip(q[2] / r, -1, 1)), np.arctan2(q[1], q[0])
    inner, outer = np.zeros((2, len(harmonics), len(radii) + 1))
    for first in range(0, len(r), BLOCK):
        part = slice(first, first + BLOCK)
        # powers of the radius over that of its shell, so that none is too large or too small
        scaled_in = r[part] / radii[np.minimum(shell[part], len(radii) - 1)]
        scaled_out = radii[np.maximum(shell[part] - 1, 0)] / r[part]
        for h, (n, m) in enumerate(harmonics):
            weight = mass[part] * harmonic(n, m, theta[part], phi[part])
            inner[h] += np.bincount(shell[part], weight * scaled_in**n, len(radii) + 1)
            outer[h] += np.bincount(shell[part], weight / r[part] * scaled_out**n, len(radii) + 1)
    degree = np.array([n for n, _ in harmonics])[:, None]
    within, beyond = np.zeros((2, len(harmonics), len(radii)))
    step = (radii[:-1] / radii[1:]) ** degree
    within[:, 0] = inner[:, 0]
    for k in range(1, len(radii)):
        within[:, k] = within[:, k - 1] * step[:, k - 1] + inner[:, k]
    beyond[:, -1] = outer[:, -1]
    for k in range(len(radii) - 2, -1, -1):
        beyond[:, k] = beyond[:, k + 1] * step[:, k] + outer[:, k + 1]
    return np.asarray(-G / (2 * degree + 1) * (within / radii + beyond))
