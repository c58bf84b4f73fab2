"""The host `response`: how a halo deforms, as multipoles without a mean, and an amplitude that may be free."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_validator

from streamkit import GYR, Array, Columns, Component, Multipoles, Number, Potential, Symbol, Table, hookimpl

STREAMKIT_CONTRACT = 1


def _example() -> dict[str, list[float]]:
    """The dipole of a halo whose inner part lags behind its outer part, along x, some (15 km/s)^2 at 30 kpc."""
    r = np.round(np.geomspace(0.03, 300.0, 41), 4)
    dipole = -450.0 * (r / 30.0) / (1.0 + (r / 30.0) ** 3)
    return {"l": [1.0] * 41, "m": [1.0] * 41, "r": r.tolist(), "phi": np.round(dipole, 4).tolist()}


class Response(Potential):
    """The deformation of a halo beside a rigid one: multipoles of its potential of degree 1 and higher.

    A satellite such as the Large Magellanic Cloud pulls a halo out of shape: a wake behind it, and an inner part that
    is displaced against the outer one. ``Phi = amplitude sum over l > 0 and m of Phi_lm(r, t) Y_lm``: the harmonics,
    the columns and what is outside the radii are those of `multipole`. The mass is that of the rigid halo, which this
    host stands beside. `streamkit expand --response` makes a table from a simulation. Energies are those of the
    potential today.
    """

    kind = "response"
    compiled = False
    evaluation = "expansion"
    vanishes = True
    linear = "amplitude"
    example = {"table": _example()}
    reference = "Weinberg 1989, MNRAS 239, 549"

    table: Annotated[Table, Columns(l="", m="", r="kpc", phi="km2/s2").optional(t="Gyr")] = Field(
        description="Phi_lm(r): columns l, m, r and phi, with every pair of l and m at the same four radii or more, "
        "and l from 1 on; and t in Gyr, 0 today, if they change in time, with all other rows at each time."
    )
    amplitude: Annotated[Number, Symbol("$A$")] = Field(
        default=1.0, description="Factor on the deformation: 0 for a rigid host, 1 for that of the table."
    )

    @field_validator("table")
    @classmethod
    def _is_complete(cls, table: Table) -> Table:
        _multipoles(table)
        return table

    def known_times(self) -> Array | None:
        """Return the times in the table."""
        return np.unique(self.table["t"]) if "t" in self.table else None

    def known_order(self) -> int:
        """Return the largest m in the table."""
        return int(np.abs(self.table["m"]).max())

    @staticmethod
    def prepare(table: Table) -> dict[str, Multipoles]:
        """Return the splines."""
        return {"multipoles": _multipoles(table)}

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, multipoles: Multipoles, amplitude: Any) -> Any:
        """Return minus the gradient of the sum."""
        return tuple(amplitude * a for a in multipoles.acceleration(x, y, z, t))

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, multipoles: Multipoles, amplitude: Any) -> Any:
        """Return the sum."""
        return amplitude * multipoles.potential(x, y, z, t)


@lru_cache(maxsize=8)  # a table is validated and prepared in every call of a fit
def _multipoles(table: Table) -> Multipoles:
    """Return the splines, with a mean of zero. Raises ValueError for a table that has a mean, or is not complete."""
    if (table["l"] < 1).any():
        raise ValueError("found rows with l = 0, the mean potential, which is that of the rigid host; expected l > 0")
    times = np.unique(table["t"]) if "t" in table else np.zeros(1)
    radii = np.unique(table["r"])
    zeros = np.zeros(len(radii) * len(times))
    n, m, phi = (np.concatenate([zeros, table[name]]) for name in ("l", "m", "phi"))
    r = np.concatenate([np.tile(radii, len(times)), table["r"]])
    known = np.concatenate([np.repeat(times, len(radii)), table["t"]]) * GYR if "t" in table else None
    return Multipoles(n, m, r, phi, known)


@hookimpl
def streamkit_components() -> list[type[Component]]:
    """List the component."""
    return [Response]
