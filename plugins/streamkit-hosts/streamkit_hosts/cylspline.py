"""The host `cylspline`: a potential on a grid in R and z, such as AGAMA's expansion of a disc or a bar."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_validator
from scipy.interpolate import make_interp_spline

from streamkit import (
    GYR,
    Angle,
    Array,
    Columns,
    Component,
    G,
    PositiveNumber,
    Potential,
    Symbol,
    Table,
    hookimpl,
)
from streamkit_hosts.cylinder import Cylinder

STREAMKIT_CONTRACT = 1
NUMBERS = ("phi", "dphi_dR", "dphi_dz")
FEWEST = 6  # radii, and heights


def _example() -> dict[str, list[float]]:
    """A Miyamoto-Nagai disc of 6e10 Msun, with a = 3 and b = 0.5 kpc."""
    radius, height = (np.round(np.concatenate([[0.0], np.geomspace(low, 1000, 40)]), 3) for low in (0.2, 0.1))
    x, z = (a.ravel() for a in np.meshgrid(radius, height, indexing="ij"))
    deep = np.sqrt(z**2 + 0.5**2)
    k = G * 6e10 / (x**2 + (3.0 + deep) ** 2) ** 1.5
    columns = {"m": 0 * x, "R": x, "z": z, "phi": -k * (x**2 + (3.0 + deep) ** 2)}
    columns |= {"dphi_dR": k * x, "dphi_dz": k * z * (3.0 + deep) / deep}
    return {name: values.tolist() for name, values in columns.items()}


class CylSpline(Potential):
    """Host from a table of its potential in R and z, one for each harmonic of the azimuth.

    ``Phi = sum over m of Phi_m(R, z) cos(m phi)``, with ``sin(|m| phi)`` for m < 0. Phi_m are AGAMA's splines of the
    fifth degree. Outside the largest sphere inside the grid there is no mass. With a column t the host changes in time:
    the force is a cubic spline in time, and the table must cover the look-back time. `streamkit import-host` makes such
    tables.
    """

    kind = "cylspline"
    compiled = False
    evaluation = "expansion"
    linear = "factor"
    example = {"table": _example()}
    reference = "Vasiliev 2019, MNRAS 482, 1525"

    table: Annotated[
        Table,
        Columns(
            m="", R="kpc", z="kpc", phi="km2 / s2", dphi_dR="km2 / (kpc s2)", dphi_dz="km2 / (kpc s2)"
        ).optional(t="Gyr"),
    ] = Field(
        description="Phi_m(R, z) and its slopes: columns m, R, z, phi, dphi_dR and dphi_dz, with every m on the same "
        "grid of six R or more, from 0 on, and six z or more, from 0 on or about 0; and t in Gyr, 0 today, if they "
        "change in time."
    )  # fmt: skip
    factor: PositiveNumber = Field(default=1.0, description="Factor on the mass.")
    angle: Annotated[Angle, Symbol(r"$\phi$")] = Field(
        default=0.0, description="Angle by which it is turned about the z axis, from x towards y."
    )

    @field_validator("table")
    @classmethod
    def _is_complete(cls, table: Table) -> Table:
        _grid(table)
        return table

    def known_times(self) -> Array | None:
        """Return the times in the table."""
        return np.unique(self.table["t"]) if "t" in self.table else None

    @staticmethod
    def prepare(table: Table) -> dict[str, Cylinders]:
        """Return the splines."""
        return {"cylinders": Cylinders(table)}

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, cylinders: Cylinders, factor: Any, angle: Any) -> Any:
        """Return minus the gradient of the sum."""
        c, s = np.cos(angle), np.sin(angle)
        ax, ay, az = cylinders.at("acceleration", c * x + s * y, c * y - s * x, z, t)
        return factor * (c * ax - s * ay), factor * (s * ax + c * ay), factor * az

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, cylinders: Cylinders, factor: Any, angle: Any) -> Any:
        """Return the sum."""
        c, s = np.cos(angle), np.sin(angle)
        return factor * cylinders.at("potential", c * x + s * y, c * y - s * x, z, t)


class Cylinders:
    """The potential of a table at all of its times, and a cubic spline between them."""

    def __init__(self, table: Table) -> None:
        self._times, orders, radius, height, values = _grid(table)
        self._each = [
            Cylinder(radius, height, {m: tuple(values[:, k, h]) for h, m in enumerate(orders)})  # type: ignore[misc]
            for k in range(len(self._times))
        ]

    def at(self, what: str, x: Any, y: Any, z: Any, t: Any) -> Any:
        """Return the potential or the acceleration at places of one shape, and at times, one or as many."""
        q = np.stack(np.broadcast_arrays(x, y, z)).astype(float)
        flat = q.reshape(3, -1)
        times = np.clip(np.broadcast_to(t, q.shape[1:]).ravel(), self._times[0], self._times[-1])
        parts = np.empty((1 if what == "potential" else 3, flat.shape[1]))
        for now in np.unique(times):
            there = times == now
            parts[:, there] = self._then(what, flat[:, there], float(now))
        shaped = parts.reshape(-1, *q.shape[1:])
        return shaped[0][()] if what == "potential" else tuple(part[()] for part in shaped)

    def _then(self, what: str, q: Array, now: float) -> Array:
        known = np.flatnonzero(np.abs(self._times - now) < 1e-12)
        if len(known):
            return np.asarray(getattr(self._each[known[0]], what)(*q))
        values = np.array([getattr(each, what)(*q) for each in self._each])
        return np.asarray(make_interp_spline(self._times, values, k=min(3, len(self._times) - 1))(now))


def _grid(table: Table) -> tuple[Array, list[int], Array, Array, Array]:
    """Return times (T,) in kpc/(km/s), the m (h,), R (k,), z (j,), and the three numbers (3, T, h, k, j).

    Raises ValueError for a table that is not on a grid.
    """
    columns = [table["t"] * GYR if "t" in table else np.zeros(len(table["R"])), table["m"], table["R"], table["z"]]
    axes = [np.unique(column) for column in columns]
    times, orders, radius, height = axes
    if (orders != np.round(orders)).any() or 0 not in orders:
        raise ValueError(f"found m = {', '.join(f'{m:g}' for m in orders[:5])}; expected whole numbers, 0 among them")
    if len(radius) < FEWEST or len(height) < FEWEST or radius[0] != 0:
        raise ValueError(f"found {len(radius)} R from {radius[0]:g} kpc and {len(height)} z; expected six, R from 0 on")
    if height[0] > 0 or height[-1] <= 0 or (height[0] < 0 and not (height == 0).any()):
        raise ValueError(f"found z from {height[0]:g} to {height[-1]:g} kpc; expected 0 in them, and z above it")
    values = np.full((3, *map(len, axes)), np.nan)
    places = tuple(np.searchsorted(axis, column) for axis, column in zip(axes, columns, strict=True))
    for number, name in zip(values, NUMBERS, strict=True):
        number[places] = table[name]
    if len(columns[0]) != values[0].size or not np.isfinite(values).all():
        raise ValueError(f"found {len(columns[0])} rows; expected each of {values[0].size}: all t, m, R and z once")
    return times, [int(m) for m in orders], radius, height, values


@hookimpl
def streamkit_components() -> list[type[Component]]:
    """List the component."""
    return [CylSpline]
