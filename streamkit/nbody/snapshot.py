"""N-body snapshots: the satellite's particles at one time, read with units stated, from two layouts.

``.hdf5``, ``.h5``: the Gadget layout. ``PartTypeN/Coordinates`` and ``Velocities``, units as attributes of ``Units``,
``Parameters`` or ``Header`` (``UnitLength_in_cm`` and ``UnitVelocity_in_cm_per_s``, or SWIFT's ``Unit length in cgs
(U_L)`` and ``Unit time in cgs (U_t)``), ``Header/Time``. Optional, and written by streamkit's own N-body plugin:
``PartTypeN/StrippingTime`` (the last time inside the tidal radius, in the file's time; -1 for bound particles),
``PartTypeN/Winding`` (radians, leading positive), ``StrippingOffset`` and ``StrippingVelocity`` (from the core at that
time), and the track of the core, which ends at ``Header/Time``: ``Progenitor/Times``, ``Coordinates``, ``Velocities``.

``.npz``: a plain table. Columns ``x y z`` and ``vx vy vz``; ``meta``, JSON whose ``units`` must name kpc, km/s and Gyr
and whose ``t_gyr`` is the snapshot's time. Optional: ``t_strip`` (Gyr; -1 for bound particles), ``Lam_unwrapped_deg``
(the winding), ``chi`` (kpc Gyr), ``prog_xv`` (6,) and ``orbit_txv`` (T, 7).

Physical coordinates, with the host's centre at the origin and at rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from streamkit.errors import StreamkitError, nearest
from streamkit.stream import Array


class SnapshotError(StreamkitError):
    """A snapshot cannot be used: the file, what was found, what is wanted."""


@dataclass(frozen=True)
class Snapshot:
    """Particles of a satellite at one time, which is t = 0, in engine units."""

    source: str  # the file, for messages
    # (3, n) positions and velocities.
    q: Array
    v: Array
    # (n,) last time inside the tidal radius, NaN for bound particles; None where the file has no such numbers.
    t_strip: Array | None = None
    # (n,) angle swept relative to the progenitor in radians, positive if leading; or None.
    winding: Array | None = None
    chi: Array | None = None  # (n,) phase of Gibbons+ 2014; or None
    # (7, T) track of the satellite's core: t, q, v, up to t = 0, or its present state alone (T = 1); or None.
    core: Array | None = None
    # (3, n) position and velocity relative to the core at the stripping time, Galactocentric; or None.
    dq_strip: Array | None = None
    dv_strip: Array | None = None


def since_today(t: Array, now: float) -> Array:
    """(n,) Times counted from today; NaN for the negative ones, which mark bound particles."""
    return np.where(t < 0, np.nan, t - now)


def core_track(file: Path, name: str, track: Array, now: float) -> Array:
    """(7, T) The track with times from today; it must be in order and end at the snapshot."""
    track = np.array(track, dtype=float)
    if track.ndim != 2 or len(track) != 7 or track.shape[1] < 2 or not (np.diff(track[0]) > 0).all():
        raise SnapshotError(f"{file}: {name}: expected time, position and velocity at two or more increasing times")
    if abs(track[0, -1] - now) > 1e-3 * (track[0, -1] - track[0, 0]):
        raise SnapshotError(
            f"{file}: {name} ends at {track[0, -1]:.4g} and the snapshot is of {now:.4g}: the track must end there"
        )
    track[0] -= track[0, -1]
    return track


def insist_on(where: str | Path, names: tuple[str, ...], content: Mapping[str, Any]) -> None:
    """Refuse a file in which some of the names are missing."""
    absent = [name for name in names if name not in content]
    if absent:
        raise SnapshotError(
            f"{where}: {', '.join(absent)} missing; a snapshot needs positions and velocities ({', '.join(names)}). "
            f"Found {', '.join(sorted(content)) or 'nothing'}.{nearest(absent[0], content)}"
        )
