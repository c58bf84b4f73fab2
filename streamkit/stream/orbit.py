"""The orbit: states of the progenitor on a grid of times, or at the release times.

Units are kpc, km/s and kpc/(km/s), as everywhere behind the run file; today is 0, and the past is negative.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from streamkit.stream.arrays import Array, freeze, read_only

TOGETHER = 4096  # times whose states are computed together: few enough for the cache


@dataclass(frozen=True)
class Orbit:
    """States of the progenitor: its track on a grid of times, or its states at the release times.

    Its arrays are read-only.

    Attributes
    ----------
    t
        (n,) times, increasing.
    q, v
        (3, n) Galactocentric positions and velocities.
    a
        (3, n) accelerations by the host.
    r_tidal
        (n,) tidal radius; NaN where there is none, or where it was not computed.
    mass_left
        (n,) remaining fraction of the progenitor's initial mass; 1 unless given.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    r_tidal: Array
    mass_left: Array = None  # type: ignore[assignment]  # ones, see below

    def __post_init__(self) -> None:
        if self.mass_left is None:
            object.__setattr__(self, "mass_left", np.ones(len(self.t)))
        freeze(self)

    @cached_property
    def r(self) -> Array:
        """(n,) distance from the Galactic centre."""
        return np.asarray(read_only(np.sqrt((self.q**2).sum(axis=0))))

    @cached_property
    def omega(self) -> Array:
        """(n,) instantaneous angular speed ``|L| / r^2`` in km/s/kpc."""
        return np.asarray(read_only(np.sqrt((np.cross(self.q.T, self.v.T) ** 2).sum(axis=1)) / self.r**2))

    @cached_property
    def frame(self) -> tuple[Array, Array, Array]:
        """Unit vectors ``e_r, e_phi, e_z``, each (3, n): outward, along the motion, along L."""
        e_r = self.q / self.r
        pole = np.cross(self.q.T, self.v.T).T
        e_z = pole / np.sqrt((pole**2).sum(axis=0))
        return read_only(e_r), read_only(np.ascontiguousarray(np.cross(e_z.T, e_r.T).T)), read_only(e_z)

    def at(self, t: Array) -> Orbit:
        """Return the states at times ``t`` (m,) by quintic Hermite interpolation; r_t and the mass linearly."""
        t = np.atleast_1d(np.asarray(t, dtype=float))
        if len(t) <= TOGETHER:
            return Orbit(t, *self._states(t))
        parts = (self._states(t[begin : begin + TOGETHER]) for begin in range(0, len(t), TOGETHER))
        return Orbit(t, *(np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True)))

    def _states(self, t: Array) -> tuple[Array, Array, Array, Array, Array]:
        i = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)
        h = self.t[i + 1] - self.t[i]
        s = (t - self.t[i]) / h
        c0, c1, c2, c3, c4, c5 = self.polynomials.take(i, axis=2)
        q = c0 + s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * c5))))
        v = (c1 + s * (2 * c2 + s * (3 * c3 + s * (4 * c4 + 5 * s * c5)))) / h
        a = (2 * c2 + s * (6 * c3 + s * (12 * c4 + 20 * s * c5))) / h**2
        r_tidal, mass_left = (x[i] + s * (x[i + 1] - x[i]) for x in (self.r_tidal, self.mass_left))
        return q, v, a, r_tidal, mass_left

    @cached_property
    def polynomials(self) -> Array:
        """(6, 3, n - 1) Coefficients of the quintic Hermite polynomials between the nodes, in units of their steps."""
        h = np.diff(self.t)
        q0, v0, a0 = self.q[:, :-1], self.v[:, :-1] * h, self.a[:, :-1] * h**2
        q1, v1, a1 = self.q[:, 1:], self.v[:, 1:] * h, self.a[:, 1:] * h**2
        d = q1 - q0 - v0 - 0.5 * a0
        dv = v1 - v0 - a0
        da = a1 - a0
        coefficients = [q0, v0, 0.5 * a0, 10 * d - 4 * dv + 0.5 * da, -15 * d + 7 * dv - da, 6 * d - 3 * dv + 0.5 * da]
        return np.asarray(read_only(np.array(coefficients)))

    def apocentres(self) -> Array:
        """(k,) times at which r has a maximum inside the track."""
        return self._turning(-1.0)

    def pericentres(self) -> Array:
        """(k,) times at which r has a minimum inside the track."""
        return self._turning(+1.0)

    def _turning(self, sign: float) -> Array:
        """Times where r.v changes sign upwards (+1) or downwards (-1), to second order in the grid step."""
        rv = sign * (self.q * self.v).sum(axis=0)
        i = np.flatnonzero((rv[:-1] < 0) & (rv[1:] >= 0))
        h = self.t[i + 1] - self.t[i]
        t = self.t[i] + h * rv[i] / (rv[i] - rv[i + 1])
        for _ in range(3):  # Newton on the interpolated orbit
            s = self.at(t)
            rv_t = sign * (s.q * s.v).sum(axis=0)
            slope = sign * ((s.v**2).sum(axis=0) + (s.q * s.a).sum(axis=0))
            step = np.divide(rv_t, slope, out=np.zeros_like(t), where=slope != 0)  # 0 on a circle
            t = np.clip(t - step, self.t[i], self.t[i + 1])
        return np.asarray(t)
