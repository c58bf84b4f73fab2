"""Forces that are carried along orbits, and their sum with other forces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from streamkit.engine.forces import NO_FRAME, Forces
from streamkit.stream import Array, Orbit


def carried(bodies: Sequence[tuple[Forces, Orbit]]) -> Forces:
    """Return the forces of bodies, fixed at the origin, each on its orbit. The orbits have one grid of times."""
    t = bodies[0][1].t
    return Forces(
        address=np.concatenate([one.address for one, _ in bodies]),
        offset=np.cumsum([0, *(count for one, _ in bodies for count in np.diff(one.offset))]),
        trajectory=np.concatenate([np.full(len(one.address), b) for b, (one, _) in enumerate(bodies)]),
        parameters=np.concatenate([*(one.parameters[: one.offset[-1]] for one, _ in bodies), np.zeros(1)]),
        first=float(t[0]),
        step=float((t[-1] - t[0]) / (len(t) - 1)),
        tracks=_tracks([orbit for _, orbit in bodies]),
        frame=NO_FRAME,
    )


def _tracks(orbits: Sequence[Orbit]) -> Array:
    """(b, T, 20) The rows of `Forces.tracks` of bodies on their orbits."""
    tracks = np.empty((len(orbits), len(orbits[0].t) - 1, 20))
    for track, orbit in zip(tracks, orbits, strict=True):
        track[:, :18] = orbit.polynomials.reshape(18, -1).T
        track[:, 18], track[:, 19] = orbit.mass_left[:-1], np.diff(orbit.mass_left)
    return tracks


def beside(forces: Forces, more: Forces) -> Forces:
    """Return the forces with those of bodies that are carried on the same grid of times."""
    if not len(more.tracks):
        return forces
    trajectory = np.concatenate([forces.trajectory, len(forces.tracks) + more.trajectory])
    return Forces(
        address=np.concatenate([forces.address, more.address]),
        offset=np.concatenate([forces.offset, forces.offset[-1] + more.offset[1:]]),
        trajectory=trajectory,
        parameters=np.concatenate([forces.parameters[: forces.offset[-1]], more.parameters]),
        first=more.first,
        step=more.step,
        tracks=np.concatenate([forces.tracks, more.tracks]) if len(forces.tracks) else more.tracks,
        frame=forces.frame,
    )
