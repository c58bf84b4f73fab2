"""The records of particles from their release to today."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from streamkit.engine import ParticleRecords
from streamkit.stream import Array, BoolArray, Orbit, angle_in_plane, orbital_plane


@dataclass(frozen=True)
class Records:
    """The results of n particles; `streamkit.Stream` describes each."""

    q: Array
    v: Array
    t_strip: Array
    dq_strip: Array
    dv_strip: Array
    winding: Array
    chi: Array
    bound: BoolArray


class Beginning(NamedTuple):
    """The records of n particles at their release, and the zero point of their winding.

    The winding today is ``offset``, plus the angle in ``plane``, plus all revolutions, minus ``swept``.

    Attributes
    ----------
    plane
        (2, 3) axes of the orbital plane.
    offset
        (n,) zero point: with it the winding at the release is the angle to the progenitor, in (-pi, pi].
    swept
        Angle in radians of the progenitor today, unwrapped.
    records
        The records that the engine updates.
    """

    plane: Array
    offset: Array
    swept: float
    records: ParticleRecords


def begin_records(orbit: Orbit, released: Orbit, q: Array, v: Array, counter: Any) -> Beginning:
    """Begin the records of particles that are released at q, v (3, n).

    Parameters
    ----------
    orbit
        The progenitor from the look-back time to today.
    released
        The progenitor at the release times, with tidal radii: n states, or one for all particles.
    q, v
        (3, n) Galactocentric positions and velocities at the release.
    counter
        Type of the numbers of revolutions.
    """
    n = q.shape[1]
    plane = orbital_plane(orbit)
    swept = np.unwrap(angle_in_plane(plane, orbit.q))
    angle = angle_in_plane(plane, q)
    progenitor_angle = np.interp(released.t, orbit.t, swept)
    lag = angle - progenitor_angle
    distance = np.sqrt(((q - released.q) ** 2).sum(axis=0))
    records = ParticleRecords(
        revolutions=np.zeros(n, dtype=counter),
        planar=np.ascontiguousarray(plane @ q),
        chi=np.zeros(n),
        gap=np.minimum(distance - released.r_tidal, 0.0),  # inside the tidal radius until a block ends outside
        t_strip=np.array(np.broadcast_to(released.t, n)),
        dq_strip=q - released.q,
        dv_strip=v - released.v,
    )
    offset = lag - 2 * np.pi * np.round(lag / (2 * np.pi)) - angle + progenitor_angle
    return Beginning(plane, offset, float(swept[-1]), records)
