"""A potential on a grid in R and z, with harmonics of the azimuth, as AGAMA's `CylSpline`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.interpolate import CubicSpline

from streamkit import Array, Multipoles, multipole_table
from streamkit_hosts.quintic import Quintic

L_OUTSIDE = 12  # degrees outside the grid


class Cylinder:
    """``Phi = sum over m of Phi_m(R, z) cos(m phi)``, with ``sin(|m| phi)`` for m < 0.

    Phi_m are quintics in asinh R and asinh z: of log(-Phi_0) where the mean is negative, and of the others over it
    (Vasiliev 2019, MNRAS 482, 1525). Outside the largest sphere in the grid there is no mass.

    Parameters
    ----------
    radius, height
        (k,) from 0 on and (j,) in kpc. A grid of heights from 0 on is mirrored.
    tables
        For each m, Phi_m (k, j) in (km/s)^2, dPhi_m/dR and dPhi_m/dz.
    """

    def __init__(self, radius: Array, height: Array, tables: Mapping[int, tuple[Array, Array, Array]]) -> None:
        both: dict[int, list[Array]] = {m: list(table) for m, table in tables.items()}
        if height[0] == 0:
            signs = (1, 1, -1)
            for m, table in both.items():
                both[m] = [np.concatenate([k * t[:, :0:-1], t], axis=1) for k, t in zip(signs, table, strict=True)]
            height = np.concatenate([-height[:0:-1], height])
        base, base_r, base_z = both[0]
        middle, edge = base[0, len(height) // 2], base[-1, len(height) // 2] * radius[-1]
        self._scale = float(edge / middle if middle < 0 and edge < 0 else radius[len(radius) // 2])
        self._radius, self._height = np.arcsinh(radius / self._scale), np.arcsinh(height / self._scale)
        self._is_log = bool((base < 0).all())
        along_r, along_z = np.sqrt(radius**2 + self._scale**2)[:, None], np.sqrt(height**2 + self._scale**2)[None]
        self._tables: dict[int, tuple[Quintic, Quintic]] = {}
        for m, table in both.items():
            value, dr, dz = table
            if self._is_log and m == 0:
                value, dr, dz = np.log(-value), dr / value, dz / value
            elif self._is_log:
                value = value / base
                dr, dz = (dr - value * base_r) / base, (dz - value * base_z) / base
            dr, dz = dr * along_r, dz * along_z
            one, other = _rate(self._height, dr, 1), _rate(self._radius, dz, 0)
            mixed = 0.5 * (one + other)
            # a spline is poor at its own ends
            mixed[[0, -1], 1:-1], mixed[1:-1, [0, -1]] = one[[0, -1], 1:-1], other[1:-1, [0, -1]]
            self._tables[m] = Quintic(self._height, value.T, dz.T), Quintic(self._height, dr.T, mixed.T)
        self._reach = float(min(radius[-1], height[-1], -height[0])) * (1 - 1e-9)
        near = np.geomspace(0.9, 1 - 1e-6, 5) * self._reach
        m_max = min(max(abs(m) for m in both), L_OUTSIDE)
        table = multipole_table(potential=self.potential, l_max=L_OUTSIDE, m_max=m_max, radii=near)
        self._outside = Multipoles(*(np.asarray(table[name]) for name in ("l", "m", "r", "phi")))

    def potential(self, x: Array, y: Array, z: Array) -> Array:
        """(n,) The potential in (km/s)^2 at places (n,) in kpc."""
        return self._called(x, y, z)[0]

    def acceleration(self, x: Array, y: Array, z: Array) -> Array:
        """(3, n) Minus its gradient in (km/s)^2/kpc."""
        return self._called(x, y, z)[1]

    def _called(self, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        out = np.sqrt(x**2 + y**2 + z**2) > self._reach
        value, force = np.empty(len(x)), np.empty((3, len(x)))
        if not out.all():
            value[~out], force[:, ~out] = self._inside(x[~out], y[~out], z[~out])
        if out.any():
            value[out] = self._outside.potential(x[out], y[out], z[out])
            force[:, out] = self._outside.acceleration(x[out], y[out], z[out])
        return value, force

    def _inside(self, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Return the potential and minus its gradient."""
        r = np.maximum(np.hypot(x, y), 1e-6 * self._scale)
        c, s = x / r, y / r
        place, height = np.arcsinh(r / self._scale), np.arcsinh(z / self._scale)
        value, dr, dz, around = np.zeros((4, len(r)))
        base = base_r = base_z = np.ones(len(r))
        for m in sorted(self._tables, key=abs):
            along, slope = self._tables[m]
            (rows, rows_z), (rates, rates_z) = along(height), slope(height)
            part, part_r = Quintic(self._radius, rows.T, rates.T).each(place)
            part_z, _ = Quintic(self._radius, rows_z.T, rates_z.T).each(place)
            if m == 0 and self._is_log:
                base, base_r, base_z = -np.exp(part), part_r, part_z
                value, dr, dz = base.copy(), base * base_r, base * base_z
                continue
            if self._is_log:
                part_r, part_z, part = base * (part_r + part * base_r), base * (part_z + part * base_z), base * part
            turn = (c + 1j * s) ** abs(m)
            wave, rate = (turn.real, -m * turn.imag) if m >= 0 else (turn.imag, -m * turn.real)
            value += part * wave
            dr += part_r * wave
            dz += part_z * wave
            around += part * rate
        dr /= np.sqrt(r**2 + self._scale**2)
        dz /= np.sqrt(z**2 + self._scale**2)
        around /= r
        return value, -np.stack([c * dr - s * around, s * dr + c * around, dz])


def _rate(nodes: Array, values: Array, axis: int) -> Array:
    """Return the slope of a cubic spline along an axis, at its nodes."""
    return np.asarray(CubicSpline(nodes, values, axis=axis, bc_type="natural")(nodes, 1))
