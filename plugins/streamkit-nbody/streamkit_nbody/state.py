"""The content of a checkpoint: the particles and the satellite's track. Engine units; times since the start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit import Array, BoolArray, IntArray
from streamkit.stream import angle_in_plane


@dataclass(frozen=True)
class Track:
    """The satellite at each record so far, k of them."""

    t: Array  # (k,) times since the start
    # (3, k) Galactocentric position and velocity of the core: the mean of the most bound half.
    q: Array
    v: Array
    mass: Array  # (k,) bound mass; 0 once the satellite is gone
    # (k,) tidal radius for that mass. Where the host has none, it is the previous one; at the start, the distance from
    # the Galactic centre.
    r_tidal: Array
    energy: Array  # (k,) total energy of all particles in Msun (km/s)^2; NaN if the host gives no potential energy

    def and_then(self, t: float, q: Array, v: Array, mass: float, r_tidal: float, energy: float) -> Track:
        """Return the track with one more record."""
        return Track(
            np.append(self.t, t),
            np.column_stack([self.q, q]),
            np.column_stack([self.v, v]),
            np.append(self.mass, mass),
            np.append(self.r_tidal, r_tidal),
            np.append(self.energy, energy),
        )


@dataclass(frozen=True)
class State:
    """The whole state at a record; the run continues from it bit for bit."""

    # (3, n) Galactocentric positions, velocities and accelerations.
    q: Array
    v: Array
    a: Array
    bound: BoolArray  # (n,) bound to the satellite
    gap: Array  # (n,) distance from the satellite's core minus the tidal radius
    t_strip: Array  # (n,) last time inside the tidal radius, since the start
    # (3, n) position and velocity relative to the core at the last record inside, along x, y, z.
    dq_strip: Array
    dv_strip: Array
    # (n,) whole turns of the particle about the Galactic centre in the orbital plane: the swept angle is the present
    # angle plus 2 pi times this number.
    revolutions: IntArray
    track: Track
    binding: float  # binding energy of the isolated satellite, the unit of the energy error; Msun (km/s)^2

    @property
    def record(self) -> int:
        """Number of the record, 0 at the start."""
        return len(self.track.t) - 1

    @property
    def time(self) -> float:
        """Time since the start."""
        return float(self.track.t[-1])

    @property
    def energy_error(self) -> float:
        """Largest change of the total energy so far, in units of the binding energy; NaN if it is not known."""
        return float(np.abs(self.track.energy - self.track.energy[0]).max() / self.binding)

    def winding(self, plane: Array) -> Array:
        """(n,) Angle swept in the plane (2, 3) minus the angle swept by the satellite, radians; positive = leading."""
        swept = np.unwrap(angle_in_plane(plane, self.track.q))[-1]
        return np.asarray(angle_in_plane(plane, self.q) + 2.0 * np.pi * self.revolutions - swept)
