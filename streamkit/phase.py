"""The nouns of the pipeline as frozen dataclasses of arrays. Shapes and units are stated here once.

Engine units throughout: kpc, km/s, Msun; times in kpc/(km/s) with 0 today and the past negative.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from streamkit.units import GYR

if TYPE_CHECKING:
    from astropy.table import QTable

Array = NDArray[np.float64]
"""An array of floats: positions and velocities are (3, n), what belongs to a particle (n,)."""
IntArray = NDArray[np.int64]
"""An array of integers."""
BoolArray = NDArray[np.bool_]
"""An array of booleans."""

LEADING, TRAILING = -1, 1
"""Sign of the radial offset at release, as in Gibbons+ 2014: leading inwards, trailing outwards."""


@dataclass(frozen=True)
class Orbit:
    """States of the progenitor: its track on a grid of times, or its states at the release times.

    Attributes
    ----------
    t
        (n,) times, increasing.
    q, v
        (3, n) Galactocentric positions and velocities.
    a
        (3, n) accelerations by the host.
    r_tidal
        (n,) tidal radius; NaN where there is none (and where it was not asked for).
    mass_left
        (n,) fraction of its mass at first that the progenitor still has; all of it unless given.
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

    @cached_property
    def r(self) -> Array:
        """(n,) distance from the Galactic centre."""
        return np.asarray(np.sqrt((self.q**2).sum(axis=0)))

    @cached_property
    def omega(self) -> Array:
        """(n,) instantaneous angular speed ``|L| / r^2`` in km/s/kpc."""
        return np.asarray(np.sqrt((np.cross(self.q.T, self.v.T) ** 2).sum(axis=1)) / self.r**2)

    @cached_property
    def frame(self) -> tuple[Array, Array, Array]:
        """Unit vectors ``e_r, e_phi, e_z``, each (3, n): outward, along the motion, along L."""
        e_r = self.q / self.r
        pole = np.cross(self.q.T, self.v.T).T
        e_z = pole / np.sqrt((pole**2).sum(axis=0))
        return e_r, np.ascontiguousarray(np.cross(e_z.T, e_r.T).T), e_z

    def at(self, t: Array) -> Orbit:
        """Return the states at times ``t`` (m,) by quintic Hermite interpolation; r_t and the mass linearly."""
        t = np.atleast_1d(np.asarray(t, dtype=float))
        i = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)
        h = self.t[i + 1] - self.t[i]
        s = (t - self.t[i]) / h
        c0, c1, c2, c3, c4, c5 = self.polynomials.take(i, axis=2)
        q = c0 + s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * c5))))
        v = (c1 + s * (2 * c2 + s * (3 * c3 + s * (4 * c4 + 5 * s * c5)))) / h
        a = (2 * c2 + s * (6 * c3 + s * (12 * c4 + 20 * s * c5))) / h**2
        r_tidal, mass_left = (x[i] + s * (x[i + 1] - x[i]) for x in (self.r_tidal, self.mass_left))
        return Orbit(t, q, v, a, r_tidal, mass_left)

    @cached_property
    def polynomials(self) -> Array:
        """(6, 3, n - 1) Coefficients of the quintic Hermite polynomials between the nodes, in units of their steps."""
        h = np.diff(self.t)
        q0, v0, a0 = self.q[:, :-1], self.v[:, :-1] * h, self.a[:, :-1] * h**2
        q1, v1, a1 = self.q[:, 1:], self.v[:, 1:] * h, self.a[:, 1:] * h**2
        d = q1 - q0 - v0 - 0.5 * a0
        dv = v1 - v0 - a0
        da = a1 - a0
        return np.array(
            [q0, v0, 0.5 * a0, 10 * d - 4 * dv + 0.5 * da, -15 * d + 7 * dv - da, 6 * d - 3 * dv + 0.5 * da]
        )

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
            t = np.clip(t - rv_t / slope, self.t[i], self.t[i + 1])
        return np.asarray(t)


@dataclass(frozen=True)
class Release:
    """Where the particles start: q, v (3, n), at the release times they were asked for."""

    q: Array
    v: Array


@dataclass(frozen=True)
class Stream:
    """The particles today, and what happened to each.

    Attributes
    ----------
    q, v
        (3, n) Galactocentric positions and velocities today.
    t_release
        (n,) time of release.
    t_strip
        (n,) stripping time: the last time inside the instantaneous tidal radius; 0 for bound particles.
    dq_galactocentric, dv_galactocentric
        (3, n) position and velocity relative to the progenitor at the last sample inside the tidal radius.
    tail
        (n,) Lagrange point of release: -1 inner ("leading"), +1 outer ("trailing").
    winding
        (n,) angle swept in the progenitor's orbital plane minus the angle swept by the progenitor, radians;
        positive = leading.
    chi
        (n,) the phase of Gibbons+ 2014: time-weighted sum of ``|x| - |x_p|`` since release, kpc * kpc/(km/s);
        negative = leading.
    bound
        (n,) True for particles that are inside the tidal radius today.
    weight
        (n,) how many particles of the scheme's own release rate each one stands for; their mean is 1.
    orbit
        The progenitor's track from the look-back time to today.
    future
        The progenitor's track from today to just past its next apocentre; None where it has none.
    """

    q: Array
    v: Array
    t_release: Array
    t_strip: Array
    dq_galactocentric: Array
    dv_galactocentric: Array
    tail: IntArray
    winding: Array
    chi: Array
    bound: BoolArray
    weight: Array
    orbit: Orbit
    future: Orbit | None = None
    parameters: dict[str, float] = field(default_factory=dict)

    def __len__(self) -> int:
        return int(self.q.shape[1])

    @cached_property
    def r(self) -> Array:
        """(n,) Galactocentric distance in kpc."""
        return np.asarray(np.sqrt((self.q**2).sum(axis=0)))

    @cached_property
    def arm(self) -> IntArray:
        """(n,) 1 leading, -1 trailing, by the sign of the winding; 0 bound."""
        return np.where(self.bound, 0, np.where(self.winding > 0, 1, -1)).astype(np.int64)

    @cached_property
    def dq_strip(self) -> Array:
        """(3, n) ``dq_galactocentric`` in the progenitor's frame then: radial, tangential, out of the plane."""
        return self._turned(self.dq_galactocentric)

    @cached_property
    def dv_strip(self) -> Array:
        """(3, n) ``dv_galactocentric`` in the progenitor's frame then: radial, tangential, out of the plane."""
        return self._turned(self.dv_galactocentric)

    def _turned(self, x: Array) -> Array:
        frame = np.stack(self.orbit.at(self.t_strip).frame)  # when asked for: no likelihood call needs it
        return np.asarray(np.einsum("fcn,cn->fn", frame, x))

    def table(self) -> QTable:
        """Return one row per particle with units, as an astropy QTable."""
        from astropy import units as u
        from astropy.table import QTable

        kpc, kms = u.kpc, u.km / u.s
        table = QTable()
        for name, row in zip("xyz", self.q, strict=True):
            table[name] = row * kpc
        for name, row in zip(("vx", "vy", "vz"), self.v, strict=True):
            table[name] = row * kms
        table["t_release"] = self.t_release / GYR * u.Gyr
        table["t_strip"] = np.where(self.bound, np.nan, self.t_strip) / GYR * u.Gyr
        table["winding"] = np.degrees(self.winding) * u.deg
        table["phase"] = self.chi / GYR * kpc * u.Gyr
        table["arm"] = np.array(["trailing", "bound", "leading"])[self.arm + 1]
        table["lagrange_point"] = np.where(self.tail < 0, "inner", "outer")
        table["bound"] = self.bound
        table.meta["parameters"] = dict(self.parameters)
        return table


@dataclass(frozen=True)
class Prediction:
    """What an observable says of a stream.

    Attributes
    ----------
    names
        m names.
    mean
        (m,) predicted values, in the units of the data.
    variance
        (m,) variance of the estimate itself, from the finite number of particles.
    why_not
        Empty, or the reason (a short constant sentence) why there is no value; mean is then NaN.
    details
        What a plot wants to show of the measurement (tracks, fits); free-form per observable.
    """

    names: tuple[str, ...]
    mean: Array
    variance: Array
    why_not: str = ""
    details: dict[str, Array] = field(default_factory=dict)
