"""Expansions as forces: the engine takes them in place of potentials that it cannot compile."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any, ClassVar, Self

import numpy as np

from streamkit.engine import Motion, Patches
from streamkit.expansion import forms, slices
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

    @property
    def body(self) -> int:
        """Where the numbers of the table begin that are proportional to the force."""
        return forms.HEAD

    def scaled(self, factor: float) -> Self:
        """Return the force times a factor."""
        table = self.table.copy()
        table[self.body :] *= factor
        return type(self)(table)

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
        """Return nothing: what changes is in the table, and its potential has the growth."""
        return ()

    def rotation(self) -> None:
        """Return None: its potential has the rotation."""

    def motion(self) -> Motion:
        """Return none: its potential has the motion."""
        return Motion()

    def in_loop(self) -> Expansion:
        """Return the expansion itself."""
        return self


class InTime(Expansion):
    """The force of a table that changes in time."""

    @property
    def body(self) -> int:
        """Where the slices begin."""
        return int(self.table[slices.BODY])


class SphereInTime(InTime):
    """The force of a sphere that changes in time, compiled."""

    patches = slices.in_time(forms.SPHERE)


@cache
def form_of(orders: tuple[int, ...], sines: bool, bent: bool, in_time: bool = False) -> type[Expansion]:
    """Return the class of expansions that are no spheres; see `forms.patches_of`. Once per process."""
    patches = forms.patches_of(orders, sines, bent)
    base = InTime if in_time else Expansion
    return type("Expansion", (base,), {"patches": slices.in_time(patches) if in_time else patches})


def expansion_of(grid: Grid, force: Array) -> Expansion:
    """Return the expansion from the acceleration (3, nodes) at ``grid.positions()``, all finite."""
    return _expansion(grid, table_of(grid, force), in_time=False)


def expansion_in_time(grid: Grid, times: Array, forces: Iterable[Array]) -> Expansion:
    """Return the expansion from the accelerations at two increasing times or more."""
    tables = np.array([table_of(grid, force) for force in forces])
    return _expansion(grid, slices.table_in_time(grid, times, tables), in_time=True)


def _expansion(grid: Grid, table: Array, in_time: bool) -> Expansion:
    if grid.form == "spherical":
        return (SphereInTime if in_time else Expansion)(table)
    return form_of(tuple(grid.orders), grid.sines, bool(grid.thickness < np.inf), in_time)(table)
