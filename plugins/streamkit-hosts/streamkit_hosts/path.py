"""The path of a simulated galaxy's centre, as the field `centre` of a potential has it."""

from __future__ import annotations

import numpy as np

from streamkit import Array

LEAST = 3  # rows: through two of them goes a straight line, on which a galaxy is at rest


def path_of(times: Array, centres: Array) -> dict[str, list[float]]:
    """Return the columns of a path from centres (T, 3) in kpc at times (T,) in Gyr; none through fewer than 3 rows.

    Its origin is the centre today, t = 0, with the velocity of today: places and velocities in a run file are then
    from the galaxy, as they are for one at rest.
    """
    from scipy.interpolate import CubicSpline  # slow to import

    if len(times) < LEAST:
        return {}
    spline = CubicSpline(times, centres)
    moved = centres - spline(0.0) - np.outer(times, spline(0.0, 1))
    return {"t": times.tolist(), **{name: column.tolist() for name, column in zip("xyz", moved.T, strict=True)}}


def moved_by(centres: Array) -> float:
    """Return the largest distance of centres (T, 3) from the last one, in their unit."""
    return float(np.sqrt(((centres - centres[-1]) ** 2).sum(axis=1)).max())


def told(moved: float, path: dict[str, list[float]]) -> str:
    """Return what to say of a centre that moves by up to ``moved`` kpc."""
    head = f"the centre moves by up to {moved:.3g} kpc"
    if not path:
        return f"{head}, and the host is put at rest: the force of its own acceleration is left out"
    return (
        f"{head}: its path is a table of its own, and the host moves along it. Leave out the line `centre` where a "
        "[body.NAME] of the run file moves the host"
    )
