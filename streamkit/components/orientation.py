"""The orientation of a component: three angles that turn the axes of its force."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field, field_validator

from streamkit.components.bases import Component
from streamkit.fields import AngleArray
from streamkit.stream import Array
from streamkit.units import Unit


class Oriented(Component):
    """The part of a potential that turns its axes. Its methods get positions along these axes, and need not know."""

    _force_method: ClassVar[str]

    orientation: AngleArray | None = Field(
        default=None,
        repr=False,
        description="Euler angles alpha, beta, gamma of its axes, as AGAMA's: they are turned about z, then about "
        "their x axis, then about their z axis. Each may have a prior. Angles of 0 change nothing.",
    )

    @field_validator("orientation")
    @classmethod
    def _three_angles(cls, orientation: Array | None) -> Array | None:
        if orientation is not None and len(orientation) != 3:
            raise ValueError(f"found {len(orientation)} angle(s), expected three: alpha, beta and gamma")
        if orientation is not None and cls._force_method == "pull":
            raise ValueError(f"{cls.kind} is a sphere, which has no orientation: leave it out")
        return orientation

    def rotation(self) -> tuple[float, ...] | None:
        """Return the rotation of its axes (9,): their unit vectors one after the other; None without an orientation."""
        if self.orientation is None:
            return None
        from scipy.spatial.transform import Rotation  # slow to import, and few potentials need it

        axes = Rotation.from_euler("ZXZ", self.orientation, degrees=True).as_matrix().T
        return tuple(axes.ravel().tolist())

    @classmethod
    def measured(cls) -> dict[str, Unit]:
        """Return the units of the author's fields that are numbers, or arrays of them."""
        return {name: unit for name, unit in super().measured().items() if name != "orientation"}
