"""The release: when the particles leave the progenitor, where, and what that costs it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamkit.components import Stripping
from streamkit.errors import ComponentError, blamed
from streamkit.spec import Setup
from streamkit.stream import LEADING, TRAILING, Array, IntArray, Orbit, Release


def release_particles(setup: Setup, orbit: Orbit, times: Array, normals: Array) -> tuple[Orbit, IntArray, Release]:
    """Return the progenitor at the release times (n,), the Lagrange points (n,) and states of all particles.

    Raises
    ------
    ComponentError
        If the stripping scheme fails, or returns other shapes or numbers than it should.
    """
    scheme, n = setup.stripping, setup.stripping.particles
    name = f"stripping {scheme.kind}"
    with blamed(name):
        tail = np.where(np.arange(n) % 2 == 0, LEADING, TRAILING)
        start = orbit.at(times)
        release = scheme.release(start, tail, setup.mass * start.mass_left, normals)
        for what, values in (("q", release.q), ("v", release.v)):
            if np.shape(values) != (3, n):
                found = np.shape(values)
                raise ComponentError(f"{name}: released `{what}` has the shape {found}, expected (3, {n})")
            if not np.isfinite(values).all():
                raise ComponentError(f"{name}: released `{what}` holds numbers that are not finite")
    return start, tail, release


def release_times(scheme: Stripping, orbit: Orbit) -> Array:
    """(n,) When the scheme releases its particles.

    Raises
    ------
    ComponentError
        If it does not say so for all particles, within the orbit and in order.
    """
    name, n = f"stripping {scheme.kind}", scheme.particles
    with blamed(name):
        times = np.asarray(scheme.times(orbit), dtype=float)
    if times.shape != (n,):
        raise ComponentError(f"{name}: `times` returned the shape {times.shape}, expected ({n},)")
    if not ((np.diff(times) >= 0).all() and orbit.t[0] <= times[0] and times[-1] <= orbit.t[-1]):
        raise ComponentError(f"{name}: the release times must increase from the look-back time to today")
    return times


def losing_mass(orbit: Orbit, loss: float, times: Array) -> Orbit:
    """Return the orbit with the mass that the progenitor has left, and the tidal radius of that mass.

    It goes with the particles, released at ``times`` (n,): all of them together carry the fraction ``loss``.
    """
    if loss == 0:
        return orbit
    pairs = times[::2]
    gone = np.interp(orbit.t, [*pairs, orbit.t[-1]], np.linspace(0.0, 1.0, len(pairs) + 1))
    left = 1.0 - loss * gone
    return replace(orbit, r_tidal=orbit.r_tidal * np.cbrt(left), mass_left=left)


def standard_normals(stripping: Stripping, seed: int) -> Array:
    """(draws, n) Standard normals from the seed; column i belongs to particle i whatever n is.

    The two tails, which alternate, have a Sobol sequence each: one sequence for both would give each tail one half
    of the first coordinate. Release times grow with the index, which completes the sequence to a Hammersley set.
    """
    n, draws = stripping.particles, stripping.draws
    if not stripping.quasi_random:
        return np.ascontiguousarray(np.random.default_rng(seed).standard_normal((n, draws)).T)
    from scipy.special import ndtri
    from scipy.stats import qmc  # slow to import

    out = np.empty((draws, n))
    for tail, stream in enumerate(np.random.default_rng(seed).spawn(2)):
        count = len(range(tail, n, 2))
        points = qmc.Sobol(draws, scramble=True, rng=stream).random_base2(max(count - 1, 1).bit_length())
        out[:, tail::2] = ndtri(points[:count].T)
    return out
