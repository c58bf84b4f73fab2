"""A built-in host of any shape from a table: spherical harmonics with splines in radius."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_validator

from streamkit import GYR, Angle, Array, Columns, Multipoles, PositiveNumber, Potential, Symbol, Table


def _example() -> dict[str, list[float]]:
    """A flattened logarithmic halo, v_c = 220 km/s, as a monopole and a quadrupole."""
    r = np.round(np.geomspace(0.03, 3000.0, 73), 4)
    deep = 0.5 * 220.0**2
    monopole, quadrupole = deep * np.log(1.0 + r * r), 0.08 * deep * r * r / (1.0 + r * r) / (1.0 + r / 100.0)
    return {
        "l": [0.0] * 73 + [2.0] * 73,
        "m": [0.0] * 146,
        "r": r.tolist() * 2,
        "phi": np.round(np.concatenate([monopole, quadrupole]), 3).tolist(),
    }


class Multipole(Potential):
    """Host of any shape from a table of the multipoles of its potential, as N-body simulations give them.

    ``Phi = sum over l, m of Phi_lm(r) P_lm(cos theta) cos(m phi)``, with ``sin(|m| phi)`` for m < 0. The mean square of
    every harmonic over the sphere is 1, so that Phi_00 is the mean potential. Phi_lm are cubic splines in ln r. Inside
    the first radius all are power laws, with the power of r of Phi_00. Outside the last radius there is no mass.
    With a column t the host changes in time: Phi_lm are cubic splines in t too, and the table must cover the look-back
    time. Energies are then those of the potential today, and no orbit keeps its own. `streamkit.multipole_table` makes
    such a table from a potential or a density.
    """

    kind = "multipole"
    compiled = False
    evaluation = "expansion"
    linear = "factor"
    example = {"table": _example()}
    reference = "Binney & Tremaine 2008, eq. 2.95"

    table: Annotated[Table, Columns(l="", m="", r="kpc", phi="km2/s2").optional(t="Gyr")] = Field(
        description="Phi_lm(r): columns l, m, r and phi, with every pair of l and m at the same four radii or more; "
        "and t in Gyr, 0 today, if they change in time, with all other rows at each time."
    )
    factor: PositiveNumber = Field(default=1.0, description="Factor on the mass.")
    angle: Annotated[Angle, Symbol(r"$\phi$")] = Field(
        default=0.0, description="Angle by which it is turned about the z axis, from x towards y."
    )

    @field_validator("table")
    @classmethod
    def _is_complete(cls, table: Table) -> Table:
        _multipoles(table)
        return table

    def known_times(self) -> Array | None:
        """Return the times in the table."""
        return np.unique(self.table["t"]) if "t" in self.table else None

    @staticmethod
    def prepare(table: Table) -> dict[str, Multipoles]:
        """Return the splines."""
        return {"multipoles": _multipoles(table)}

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, multipoles: Multipoles, factor: Any, angle: Any) -> Any:
        """Return minus the gradient of the sum."""
        c, s = np.cos(angle), np.sin(angle)
        ax, ay, az = multipoles.acceleration(c * x + s * y, c * y - s * x, z, t)
        return factor * (c * ax - s * ay), factor * (s * ax + c * ay), factor * az

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, multipoles: Multipoles, factor: Any, angle: Any) -> Any:
        """Return the sum."""
        c, s = np.cos(angle), np.sin(angle)
        return factor * multipoles.potential(c * x + s * y, c * y - s * x, z, t)


@lru_cache(maxsize=8)  # a table is validated and prepared in every call of a fit
def _multipoles(table: Table) -> Multipoles:
    times = table["t"] * GYR if "t" in table else None
    return Multipoles(table["l"], table["m"], table["r"], table["phi"], times)
