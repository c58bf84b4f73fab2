"""The frame of a potential: three angles that turn the axes of its force, and its centre, at rest or in time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, PrivateAttr, field_validator

from streamkit import engine
from streamkit.components.bases import Component
from streamkit.fields import AngleArray, Columns, InTime, Table
from streamkit.stream import Array
from streamkit.units import GYR, Unit

ANGLES = "orientation."  # how the names of its angles begin, where they change in time
VELOCITY = ("vx", "vy", "vz")


class Oriented(Component):
    """The part of a potential that turns its axes and moves its centre.

    Its methods get positions along these axes from that centre, and need not know.
    """

    _force_method: ClassVar[str]
    has_drag: ClassVar[Callable[[], bool]]
    _in_time: Mapping[str, InTime] = PrivateAttr({})
    _origin: Array | None = PrivateAttr(None)

    orientation: AngleArray | None = Field(
        default=None,
        repr=False,
        description="Euler angles alpha, beta, gamma of its axes, as AGAMA's: they are turned about z, then about "
        "their x axis, then about their z axis. Each may have a prior, or change in time. Angles of 0 change nothing.",
    )
    centre: Annotated[
        Table, Columns(t="Gyr", x="kpc", y="kpc", z="kpc").optional(vx="km/s", vy="km/s", vz="km/s").increasing("t", 1)
    ] | None = Field(
        default=None,
        repr=False,
        description="Its centre as a table of time (t = 0 is today) in the frame of the Galaxy: a cubic spline, or the "
        "cubics of the velocities, if given; a straight line after the last row. It must cover the look-back time. "
        "A single row is a place at rest. If all parts of a galaxy have the same one, the host's centre is there.",
    )  # fmt: skip

    @field_validator("orientation")
    @classmethod
    def _three_angles(cls, orientation: Array | None) -> Array | None:
        if orientation is not None and len(orientation) != 3:
            raise ValueError(f"found {len(orientation)} angle(s), expected three: alpha, beta and gamma")
        if orientation is not None and cls._force_method == "pull":
            raise ValueError(f"{cls.kind} is a sphere, which has no orientation: leave it out")
        return orientation

    @field_validator("centre")
    @classmethod
    def _all_velocities(cls, centre: Table | None) -> Table | None:
        if centre is not None and cls.has_drag():
            raise ValueError(f"{cls.kind} has a force that depends on velocity, whose centre is that of the host")
        given = [] if centre is None else [name for name in VELOCITY if name in centre]
        if 0 < len(given) < 3:
            raise ValueError(f"found the column {given[0]!r}, expected all of vx, vy and vz, or none")
        if given and centre is not None and len(centre) == 1:
            raise ValueError("a single row is a place at rest: leave out its velocity, or give a second row")
        return centre

    @property
    def in_time(self) -> Mapping[str, InTime]:
        """The fields that change in time, by name; the instance has their values of today.

        An angle of the orientation is called ``orientation.2``.
        """
        return self._in_time

    @property
    def drifts(self) -> bool:
        """Whether its centre moves."""
        if self._origin is None:
            return self.centre is not None and len(self.centre) > 1
        return len(self.motion().centre) > 1

    @property
    def _turns(self) -> bool:
        """Whether an angle of its orientation changes in time."""
        return any(name.startswith(ANGLES) for name in self._in_time)

    def motion(self) -> engine.Motion:
        """Return how its centre moves and its axes turn, in engine units."""
        angles = tuple(self._angle(number) for number in range(3)) if self._turns else ()
        motion = engine.Motion(angles) if self.centre is None else engine.Motion(angles, _curve(self.centre))
        return motion if self._origin is None else motion.seen_from(self._origin)

    def see_from(self, path: Array) -> None:
        """From now on, count places from a point with this path: cubics, as `engine.Motion.centre` has them.

        A force that depends on velocity stays at the origin, which is the host's centre then too.
        """
        self._origin = None if type(self).has_drag() else path

    def _angle(self, number: int) -> Array:
        """Return the pieces of an angle in time."""
        knots = self._in_time.get(f"{ANGLES}{number}")
        if knots is not None:
            return knots.pieces(GYR, math.pi / 180)
        today = 0.0 if self.orientation is None else float(self.orientation[number])
        return engine.linear(np.zeros(1), np.radians([today]))

    def rotation(self) -> tuple[float, ...] | None:
        """Return the rotation of its axes (9,) that stays: their unit vectors one after the other.

        None without an orientation, and if it changes in time: `motion` has it then.
        """
        if self.orientation is None or self._turns:
            return None
        from scipy.spatial.transform import Rotation  # slow to import, and few potentials need it

        axes = Rotation.from_euler("ZXZ", self.orientation, degrees=True).as_matrix().T
        return tuple(axes.ravel().tolist())

    @classmethod
    def measured(cls) -> dict[str, Unit]:
        """Return the units of the author's fields that are numbers, or arrays of them."""
        return {name: unit for name, unit in super().measured().items() if name != "orientation"}


def _curve(table: Table) -> Array:
    """Return the table of a centre for the engine."""
    from scipy.interpolate import CubicHermiteSpline, CubicSpline  # slow to import, and few potentials need it

    t, q = table["t"] * GYR, np.stack([table[name] for name in "xyz"], axis=1)
    if len(t) == 1:
        row = np.zeros((1, 13))
        row[0, 1::4] = q[0]
        return row
    if "vx" in table:
        return engine.Motion.cubics(t, CubicHermiteSpline(t, q, np.stack([table[name] for name in VELOCITY], axis=1)).c)
    return engine.Motion.cubics(t, CubicSpline(t, q).c)
