"""The observer: the place and the motion of the Sun, from which a stream is seen."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from streamkit.stream.arrays import Array


@dataclass(frozen=True)
class Observer:
    """The Sun in right-handed Galactocentric axes, at (-r0, 0, 0) if z = 0.

    Attributes
    ----------
    r0, z
        Distance from the Galactic centre and height above the plane, kpc.
    velocity
        Galactocentric velocity (towards the centre, along the rotation, towards the north Galactic pole), km/s.
    centre
        Where the host's centre is today along these axes, kpc: it is the origin, unless the run file gives it a path.
    """

    r0: float = 8.0
    z: float = 0.0
    velocity: tuple[float, float, float] = (11.1, 237.0 + 12.24, 7.25)
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def tilt(self) -> Array:
        """(3, 3) Rotation about y that lifts the Sun from (-r0, 0, 0) to height z, as astropy does."""
        s = self.z / self.r0
        c = math.sqrt(1.0 - s * s)
        return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])

    @property
    def q(self) -> Array:
        """(3,) Position from the host's centre, kpc."""
        return np.asarray(self.tilt @ np.array([-self.r0, 0.0, 0.0]) - np.array(self.centre))

    @property
    def v(self) -> Array:
        """(3,) Galactocentric velocity, km/s."""
        return np.array(self.velocity)


GIBBONS14 = Observer()  # the Sun of Gibbons, Belokurov & Evans 2014
