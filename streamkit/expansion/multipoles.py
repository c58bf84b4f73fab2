"""A potential as spherical harmonics with splines in ln r, and how to make one from a potential or a density."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline, PPoly, make_interp_spline

from streamkit.expansion.harmonics import at_directions, legendre, names, quadrature
from streamkit.stream import Array
from streamkit.units import CENTRE, G


class Multipoles:
    """``Phi = sum over l, m of Phi_lm(r) P_lm(cos theta) cos(m phi)``, with ``sin(|m| phi)`` for m < 0.

    The mean square of every harmonic over the sphere is 1: Phi_00 is the mean potential. Phi_lm are cubic splines in ln
    r. Inside the first radius all are power laws, with the power of r of Phi_00. Outside the last radius they fall as
    r^-(l+1), as they do without mass.

    Parameters
    ----------
    degree, order, radius, phi
        (n,) l, m, r in kpc and Phi_lm(r) in (km/s)^2: every pair of l and m that occurs at the same four radii or more,
        in any order of rows.
    time
        (n,) times in kpc/(km/s), each with all these rows; left out without a change in time. Between the times Phi_lm
        are cubic splines, with two continuous derivatives (a parabola through three times, a line through two); before
        the first they are those of the first, after the last those of the last.

    Raises ValueError if that is not so.
    """

    def __init__(self, degree: Array, order: Array, radius: Array, phi: Array, time: Array | None = None) -> None:
        degree, order, radius, phi = (np.asarray(a, dtype=float) for a in (degree, order, radius, phi))
        time = np.zeros_like(phi) if time is None else np.asarray(time, dtype=float)
        radii, times = np.unique(radius), np.unique(time)
        pairs = list(zip(degree, order, strict=True))
        self.harmonics = sorted({(int(n), int(m)) for n, m in set(pairs)})
        wrong = [pair for pair in pairs if pair[0] != int(pair[0]) or pair[1] != int(pair[1]) or abs(pair[1]) > pair[0]]
        if wrong:
            raise ValueError(f"found l = {wrong[0][0]:g}, m = {wrong[0][1]:g}; expected whole numbers with |m| <= l")
        if len(radii) < 4 or radii[0] <= 0:
            raise ValueError(f"found {len(radii)} radii from {radii[0]:g} kpc; expected four or more, all positive")
        if (0, 0) not in self.harmonics:
            raise ValueError("found no rows with l = 0, m = 0: the mean potential")
        index = {pair: k for k, pair in enumerate(self.harmonics)}
        values = np.full((len(radii), len(times), len(self.harmonics)), np.nan)
        places = np.searchsorted(radii, radius), np.searchsorted(times, time), [index[int(n), int(m)] for n, m in pairs]
        values[places] = phi
        if len(phi) != values.size or not np.isfinite(values).all():
            at = f"the {len(radii)} radii" + (f" and {len(times)} times" if len(times) > 1 else "")
            raise ValueError(
                f"found {len(phi)} rows; expected each of the {len(self.harmonics)} pairs of l and m once at each of "
                f"{at}"
            )
        self.times = times
        self._mean = index[0, 0]
        self._spline = CubicSpline(np.log(radii), values if len(times) > 1 else values[:, 0])
        self._in_time = None
        if len(times) > 1:
            coefficients = np.moveaxis(self._spline.c, 2, 0)
            self._in_time = make_interp_spline(times, coefficients, k=min(3, len(times) - 1))
        self._last: tuple[float, _Radial] = (np.nan, self._radial_at(float(times[-1])))

    def _radial_at(self, t: float) -> _Radial:
        if self._in_time is None:
            return _Radial(self._spline, self.harmonics, self._mean)
        c = self._in_time(min(max(t, self.times[0]), self.times[-1]))
        return _Radial(PPoly(c, self._spline.x), self.harmonics, self._mean)

    def radial(self, r: Array, t: Any = 0.0) -> tuple[Array, Array]:
        """(h, n) Phi_lm at radii r (n,) and times t, one or (n,), and their derivatives with respect to ln r."""
        if self._in_time is None:
            return self._last[1](r)
        if np.ndim(t) == 0 or (np.ravel(t) == np.ravel(t)[0]).all():
            now = float(np.ravel(t)[0])
            if self._last[0] != now:
                self._last = now, self._radial_at(now)
            return self._last[1](r)
        value, slope = np.empty((2, len(self.harmonics), len(r)))
        for now in np.unique(t):
            there = t == now
            value[:, there], slope[:, there] = self._radial_at(float(now))(r[there])
        return value, slope

    def potential(self, x: Any, y: Any, z: Any, t: Any = 0.0) -> Any:
        """Return the potential in (km/s)^2 at positions in kpc, floats or arrays of one shape, and at times."""
        q, flat, r, times = _flat(x, y, z, t)
        value, _ = self.radial(r, times)
        return (value * at_directions(self.harmonics, flat / r)).sum(axis=0).reshape(q.shape[1:])[()]

    def acceleration(self, x: Any, y: Any, z: Any, t: Any = 0.0) -> tuple[Any, Any, Any]:
        """Return minus its gradient in (km/s)^2/kpc."""
        q, flat, r, times = _flat(x, y, z, t)
        value, slope = self.radial(r, times)
        ex, ey, mu = flat / r
        m_max = max(abs(m) for _, m in self.harmonics)
        polynomials = legendre(max(n for n, _ in self.harmonics), m_max, mu)
        powers = [np.ones_like(ex) + 0j]
        for _ in range(m_max):
            powers.append(powers[-1] * (ex + 1j * ey))
        ds, dmu, radial, gx, gy = (np.zeros_like(r) for _ in range(5))
        for (n, signed), phi, dphi in zip(self.harmonics, value, slope, strict=True):
            m = abs(signed)
            part, along = polynomials[n, m]
            less = m * powers[m - 1] if m else np.zeros_like(ex) + 0j  # of e^m: d/dx + i times it is d/dy
            c, bx, by = (
                (powers[m].real, less.real, -less.imag) if signed >= 0 else (powers[m].imag, less.imag, less.real)
            )
            ds += dphi * part * c
            dmu += phi * along * c
            radial += m * phi * part * c
            gx += phi * part * bx
            gy += phi * part * by
        out = -(ds - dmu * mu - radial) / r
        acceleration = np.stack([out * ex - gx / r, out * ey - gy / r, out * mu - dmu / r])
        ax, ay, az = acceleration.reshape(q.shape)
        return ax[()], ay[()], az[()]


def _flat(x: Any, y: Any, z: Any, t: Any) -> tuple[Array, Array, Array, Array]:
    """Positions in their shape, as (3, n), their radii, and times, one or (n,)."""
    q = np.stack(np.broadcast_arrays(x, y, z)).astype(float)
    flat = q.reshape(3, -1)
    times = np.broadcast_to(t, q.shape[1:]).ravel() if np.ndim(t) else np.asarray(t)
    return q, flat, np.sqrt((flat**2).sum(axis=0) + CENTRE), times


class _Radial:
    """Phi_lm(r) of one time: splines in ln r, and powers of r beyond them."""

    def __init__(self, spline: PPoly, harmonics: list[tuple[int, int]], mean: int) -> None:
        self._spline, self._ends = spline, spline.x[[0, -1]]
        self._values, self._slopes = spline(self._ends), spline(self._ends, 1)
        with np.errstate(invalid="ignore"):  # a mean of zero
            power = spline(self._ends[0], 2)[mean] / self._slopes[0, mean]
        inner = np.full(len(harmonics), min(max(float(np.nan_to_num(power)), 0.1), 2.0))
        self._powers = np.array([inner, [-(n + 1.0) for n, _ in harmonics]])

    def __call__(self, r: Array) -> tuple[Array, Array]:
        """(h, n) Phi_lm at radii r (n,), and their derivatives with respect to ln r."""
        s = np.log(r)
        c = np.clip(s, *self._ends)
        value, slope = self._spline(c), self._spline(c, 1)
        for end, outside in ((0, s < self._ends[0]), (1, s > self._ends[1])):
            k, d = self._powers[end], self._slopes[end]
            growth = np.exp(k * (s[outside] - c[outside])[:, None])
            value[outside] = self._values[end] + d / k * (growth - 1)
            slope[outside] = d * growth
        return value.T, slope.T


def multipole_table(
    *,
    potential: Callable[..., Array] | None = None,
    density: Callable[..., Array] | None = None,
    l_max: int = 8,
    m_max: int | None = None,
    even: bool = False,
    radii: Array | None = None,
    times: Array | None = None,
) -> Any:
    """Return the table of a `multipole` potential, from a potential or a density.

    Parameters
    ----------
    potential, density
        One of them: a function of x, y, z (n,) in kpc that returns (km/s)^2 or Msun/kpc^3, (n,).
    l_max, m_max
        Largest degree and order; m_max is l_max unless given, 0 for an axisymmetric body.
    even
        Leave out what vanishes for a body that is symmetric about its three planes.
    radii
        (k,) in kpc, increasing; 100 from 0.01 to 1000 kpc unless given. A density is taken to continue as a power of
        r inside the first, and to vanish outside the last.
    times
        (T,) in Gyr, 0 today, for a body that changes: the function then takes a time as its fourth argument.

    Returns
    -------
    An `astropy.table.Table` with the columns l, m, r (kpc) and phi (km2 / s2), and t (Gyr) with times: write it with
    ``table.write("halo.ecsv")``, or give it to `Multipoles`. A density's multipoles solve Poisson's equation (Binney &
    Tremaine 2008, eq. 2.95).
    """
    from astropy.table import Table  # slow to import

    given = [function for function in (potential, density) if function is not None]
    if len(given) != 1:
        raise ValueError("expected either a potential or a density")
    r = np.geomspace(0.01, 1000.0, 100) if radii is None else np.asarray(radii, dtype=float)
    harmonics = names(l_max, l_max if m_max is None else m_max, even)
    directions, weights = quadrature(l_max, max(abs(m) for _, m in harmonics))
    x, y, z = (directions[:, None, :] * r[:, None]).reshape(3, -1)
    n, m = np.array(harmonics).T
    weighted = (at_directions(harmonics, directions) * weights).T
    parts = []
    for at_time in [()] if times is None else [(float(t),) for t in times]:
        values = np.broadcast_to(np.asarray(given[0](x, y, z, *at_time), dtype=float), x.shape).reshape(len(r), -1)
        amplitudes = (values @ weighted).T
        if density is not None:
            amplitudes = np.array([_poisson(n, r, amplitude) for n, amplitude in zip(n, amplitudes, strict=True)])
        parts.append(amplitudes.ravel())
    columns = {
        "l": np.tile(np.repeat(n, len(r)), len(parts)),
        "m": np.tile(np.repeat(m, len(r)), len(parts)),
        "r": np.tile(r, len(n) * len(parts)),
        "phi": np.concatenate(parts),
    }
    units = {"r": "kpc", "phi": "km2 / s2"}
    if times is not None:
        columns, units = {"t": np.repeat(times, len(parts[0])), **columns}, {"t": "Gyr", **units}
    return Table(columns, units=units)


def _poisson(degree: int, r: Array, density: Array) -> Array:
    """(k,) Phi_lm at r (k,) of the density rho_lm (k,) there."""
    s = np.log(r)
    inner = CubicSpline(s, density * r ** (degree + 3)).antiderivative()(s)
    outer = CubicSpline(s, density * r ** (2 - degree)).antiderivative()(s)
    here = density[0] * r[0] ** (degree + 3)
    if here != 0.0:  # a power of r inside the first radius
        slope = float(np.log(density[1] / density[0]) / (s[1] - s[0])) if density[1] / density[0] > 0 else 0.0
        inner = inner + here / max(degree + 3 + slope, 0.1)
    return np.asarray(-4 * np.pi * G / (2 * degree + 1) * (inner / r ** (degree + 1) + (outer[-1] - outer) * r**degree))
