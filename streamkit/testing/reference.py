"""A slow, obvious oracle: NumPy forces, and SciPy's DOP853, one particle at a time.

Nothing here touches the compiled engine, so that a test may compare the two. Units are the engine's.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from scipy.integrate import solve_ivp

from streamkit import Array, Potential

Rates = Callable[[float, Array], Array]


def acceleration(potentials: Sequence[Potential], t: Array | float, q: Array) -> Array:
    """(3, n) sum of the NumPy accelerations at positions q (3, n) in kpc and times t (n,)."""
    t = np.broadcast_to(np.asarray(t, dtype=float), q.shape[1:])
    parts = [np.stack(np.broadcast_arrays(*type(p).acceleration(*q, t, *p.in_engine_units()))) for p in potentials]
    return np.asarray(np.sum(parts, axis=0))


def drag(potentials: Sequence[Potential], t: Array | float, q: Array, v: Array) -> Array:
    """(3, n) sum of the NumPy accelerations that depend on velocity, at q and v (3, n) and times t (n,)."""
    t = np.broadcast_to(np.asarray(t, dtype=float), q.shape[1:])
    parts = [np.stack(np.broadcast_arrays(*type(p).drag(*q, *v, t, *p.in_engine_units()), t)[:3]) for p in potentials]
    return np.asarray(np.sum(parts, axis=0))


def energy(potentials: Sequence[Potential], t: Array | float, q: Array, v: Array) -> Array:
    """(n,) energy per mass in (km/s)^2 of particles q, v (3, n)."""
    t = np.broadcast_to(np.asarray(t, dtype=float), q.shape[1:])
    return np.asarray(
        0.5 * (v**2).sum(axis=0) + sum(type(p).potential(*q, t, *p.in_engine_units()) for p in potentials)
    )


# Difference steps in units of r: the coarse ones for nearly constant fields, the fine for thin discs.
_STEPS = (1e-1, 1e-2, 1e-3)


def _slopes(f: Callable[[Array], Array], q: Array, h: Array) -> Array:
    """(3, ...) derivatives of f along the axes: central differences of fourth order with steps h (n,)."""
    rows = []
    for axis in np.eye(3):
        step = axis[:, None] * h
        one_step, two_steps = f(q + step) - f(q - step), f(q + 2 * step) - f(q - 2 * step)
        rows.append((8 * one_step - two_steps) / (12 * h))
    return np.stack(rows)


def _settled(candidates: Sequence[Array]) -> Array:
    """Of derivatives (..., n) with ever finer steps, take for each point the one that changed least."""
    best, distance = candidates[0], np.full(candidates[0].shape[-1], np.inf)
    for coarse, fine in itertools.pairwise(candidates):
        change = np.abs(fine - coarse).reshape(-1, fine.shape[-1]).max(axis=0)
        best = np.where(change < distance, fine, best)
        distance = np.minimum(change, distance)
    return best


def gradient(potential: Potential, t: Array, q: Array) -> Array:
    """(3, n) numerical gradient of `potential` at q (3, n)."""
    r = np.sqrt((q**2).sum(axis=0))

    def phi(x: Array) -> Array:
        return np.asarray(type(potential).potential(*x, t, *potential.in_engine_units()), dtype=float)

    return _settled([_slopes(phi, q, h * r) for h in _STEPS])


def divergence_and_curl(potential: Potential, t: Array, q: Array) -> tuple[Array, Array]:
    """(n,) numerical divergence and (3, n) curl of the acceleration at q (3, n)."""
    r = np.sqrt((q**2).sum(axis=0))
    slopes = _settled([_slopes(lambda x: acceleration([potential], t, x), q, h * r) for h in _STEPS])
    curl = np.stack([slopes[j, k] - slopes[k, j] for j, k in ((1, 2), (2, 0), (0, 1))])
    return np.asarray(np.trace(slopes)), curl


def dop853(rates: Rates, w: Array, t0: float, t1: float) -> Array:
    """SciPy's DOP853 from t0 to t1 at a relative tolerance of 1e-12."""
    if t0 == t1:
        return w.copy()
    return np.asarray(solve_ivp(rates, (t0, t1), w, method="DOP853", rtol=1e-12, atol=1e-11).y[:, -1])


def advance(
    host: Sequence[Potential],
    q: Array,
    v: Array,
    t0: Array,
    t1: float,
    satellite: Sequence[Potential] = (),
    progenitor: tuple[Array, Array, float] | None = None,
) -> tuple[Array, Array]:
    """Carry particles q, v (3, n) from their own times t0 (n,) to t1; return new arrays (3, n), (3, n).

    Parameters
    ----------
    host
        Potentials fixed at the origin.
    satellite
        Potentials centred on the progenitor, which feels the host alone.
    progenitor
        Position (3,), velocity (3,) and the time at which it has them; needed with a satellite. It is
        integrated together with each particle: no track, no interpolation.
    """

    def rates(t: float, w: Array) -> Array:
        """State: particle position, velocity, then (with a satellite) the progenitor's."""
        x = w[:3, None]
        a = acceleration(host, t, x) + drag(host, t, x, w[3:6, None])
        if progenitor is None:
            return np.concatenate([w[3:6], a[:, 0]])
        centre = w[6:9, None]
        a = a + acceleration(satellite, t, x - centre)
        its_own = acceleration(host, t, centre) + drag(host, t, centre, w[9:12, None])
        return np.concatenate([w[3:6], a[:, 0], w[9:12], its_own[:, 0]])

    def alone(t: float, w: Array) -> Array:
        a = acceleration(host, t, w[:3, None]) + drag(host, t, w[:3, None], w[3:, None])
        return np.concatenate([w[3:], a[:, 0]])

    out = np.empty((6, q.shape[1]))
    for i, start in enumerate(np.asarray(t0, dtype=float)):
        w = np.concatenate([q[:, i], v[:, i]])
        if progenitor is not None:
            w = np.concatenate([w, dop853(alone, np.concatenate(progenitor[:2]), progenitor[2], start)])
        out[:, i] = dop853(rates, w, start, t1)[:6]
    return out[:3].copy(), out[3:].copy()
