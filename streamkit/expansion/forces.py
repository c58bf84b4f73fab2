"""Expansions as forces: the engine takes them in place of potentials that it cannot compile."""

from __future__ import annotations

from functools import cache
from typing import Any, ClassVar

import numpy as np

from streamkit.engine import Patches
from streamkit.expansion import forms
from streamkit.expansion.grid import Grid
from streamkit.expansion.tables import table_of
from streamkit.stream import Array


class Expansion:
    """The force of a table, compiled."""

    kind: ClassVar[str] = "expansion"
    compiled: ClassVar[bool] = True
    patches: ClassVar[Patches | None] = None

    def __init__(self, table: Array) -> None:
        self.table = table

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, table: Any) -> Any:
        """Return ``(ax, ay, az)`` of a sphere; the other forms have `patches` in its place."""
        return forms.spherical(x, y, z, table)

    @staticmethod
    def drag(x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any, t: Any, *parameters: Any) -> Any:
        """Unused: no part of an expansion depends on velocity."""
        raise NotImplementedError

    @classmethod
    def has_drag(cls) -> bool:
        """Return False."""
        return False

    def in_engine_units(self) -> tuple[Array]:
        """Return the table."""
        return (self.table,)

    def changes(self) -> tuple[()]:
        """Return nothing: an expansion is constant in time; its potential has the growth."""
        return ()

    def rotation(self) -> None:
        """Return None: its potential has the rotation."""

    def in_loop(self) -> Expansion:
        """Return the expansion itself."""
        return self


@cache
def form_of(orders: tuple[int, ...], sines: bool, bent: bool) -> type[Expansion]:
    """Return the class of expansions that are no spheres; see `forms.patches_of`. Once per process."""
    return type("Expansion", (Expansion,), {"patches": forms.patches_of(orders, sines, bent)})


def expansion_of(grid: Grid, force: Array) -> Expansion:
    """Return the expansion from the acceleration (3, nodes) at ``grid.positions()``, all finite."""
    table = table_of(grid, force)
    if grid.form == "spherical":
        return Expansion(table)
    return form_of(tuple(grid.orders), grid.sines, bool(grid.thickness < np.inf))(table)
