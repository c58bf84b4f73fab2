"""A force with a frame of its own: its centre moves, and its axes turn, along curves in time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numba import njit

from streamkit.engine.cache import OPTIONS, UNCALLED
from streamkit.engine.changing import row_at, value_at, values_at
from streamkit.stream import Array, IntArray, to_axes

_INLINED: dict[str, Any] = {"forceinline": True, **UNCALLED, **OPTIONS}
# Whether the axes turn, and whether the centre moves: with the layout they decide the machine code.
Moves: TypeAlias = tuple[bool, bool]
AT_REST: Moves = (False, False)


NOWHERE = np.zeros((0, 13))
LATER = 1e-9  # kpc/(km/s): a year


class Motion(NamedTuple):
    """The frame of a force in time, in engine units. `Motion()` is that of a force at rest at the origin.

    Attributes
    ----------
    angles
        The pieces of the Euler angles alpha, beta and gamma in time, as `Changes` has them; empty if they do not
        change, and the force has its `rotation`.
    centre
        (k, 13) cubics of the centre, as `cubics` makes them: the time from which a row holds, and four coefficients of
        powers of the time since then for each of x, y and z. The first row holds at all times before the second one
        too. (0, 13) at the origin.
    """

    angles: tuple[Array, ...] = ()
    centre: Array = NOWHERE

    @property
    def moves(self) -> Moves:
        """Whether the axes turn, and whether the centre is not the origin."""
        return bool(self.angles), len(self.centre) > 0

    @property
    def tables(self) -> tuple[Array, ...]:
        """The pieces, which follow all other arguments in compiled code."""
        return self.angles + ((self.centre,) if len(self.centre) else ())

    @staticmethod
    def cubics(times: Array, coefficients: Array) -> Array:
        """(k + 1, 13) Return the table of a centre: straight lines beyond the ends of k - 1 cubics between k times.

        The coefficients (4, k - 1, 3) are those of falling powers of the time since the beginning of each, as SciPy's.
        """
        rows = np.zeros((len(times) + 1, 13))
        rows[:, 0] = times[np.maximum(np.arange(len(times) + 1) - 1, 0)]
        rows[1:-1, 1:] = coefficients[::-1].transpose(1, 2, 0).reshape(-1, 12)
        powers = (times[-1] - times[-2]) ** np.arange(4)
        for k in range(3):
            first, last = slice(1 + 4 * k, 3 + 4 * k), rows[-2, 1 + 4 * k : 5 + 4 * k]
            rows[0, first] = rows[1, first]
            rows[-1, first] = last @ powers, last[1:] @ (np.arange(1, 4) * powers[:3])
        return rows

    def seen(self, q: Array, t: Array, rotation: Sequence[float] | None) -> tuple[Array, Sequence[Any] | None]:
        """Return positions q (3, n) at times t (n,) from the centre along the axes, and the rotation then.

        The given one is that of axes that do not turn.
        """
        if len(self.centre):
            q = q - self.centres_at(t)
        if self.angles:
            rotation = rotation_of(*(values_at(t, pieces) for pieces in self.angles))
        return np.ascontiguousarray(q if rotation is None else np.stack(to_axes(rotation, *q))), rotation

    def centres_at(self, t: Array) -> Array:
        """(3, n) Return positions of a centre that is not the origin at times (n,)."""
        rows = self.centre[np.searchsorted(self.centre[1:, 0], t, side="right")].T
        s = t - rows[0]
        c = rows[1:].reshape(3, 4, -1)
        return np.asarray(c[:, 0] + s * (c[:, 1] + s * (c[:, 2] + s * c[:, 3])))

    def state_at(self, t: float) -> tuple[Array, Array]:
        """Return position and velocity (3,) of the centre at one time."""
        times = np.array([t])
        cubics = _begun_at(times, self.centre, np.searchsorted(self.centre[1:, 0], times, side="right"))
        return cubics[0, ::4], cubics[0, 1::4]

    def seen_from(self, centre: Array) -> Motion:
        """Return the same motion as seen from another centre, which moves too: cubics (k, 13) with times of their own.

        Where both centres are the same the force is at the origin.
        """
        if np.array_equal(self.centre, centre):
            return Motion(self.angles)
        knots = np.unique(np.concatenate([self.centre[1:, 0], centre[1:, 0]]))
        first = knots[np.maximum(np.arange(len(knots) + 1) - 1, 0)] if len(knots) else np.zeros(1)
        mine, its = (_begun_at(first, each, _rows_from(first, each)) for each in (self.centre, centre))
        moved = mine - its
        return Motion(self.angles, np.ascontiguousarray(np.concatenate([first[:, None], moved], axis=1)))

    def pushes(self) -> tuple[Array, ...]:
        """Return minus the acceleration of the centre: the pieces (k, 6) of x, y and z in time, as `Changes` has them.

        The straight line after the end begins a year later: the last step of a stream ends there, and has no jump.
        """
        pieces = np.zeros((3, len(self.centre), 6))
        pieces[:, :, 0] = self.centre[:, 0]
        c = self.centre[:, 1:].reshape(-1, 3, 4).transpose(1, 0, 2)
        pieces[:, :, 1], pieces[:, :, 2] = -2.0 * c[:, :, 2], -6.0 * c[:, :, 3]
        pieces[:, -1, 0] += LATER
        return tuple(pieces)


STILL = Motion()


def _rows_from(first: Array, centre: Array) -> IntArray:
    """(n,) Return the rows of a centre from rising times (n,) on; the first is for all times before too."""
    rows = np.searchsorted(centre[1:, 0], first, side="right")
    rows[0] = 0
    return rows


def _begun_at(first: Array, centre: Array, rows: IntArray) -> Array:
    """(n, 12) Coefficients of these rows (n,) of a centre's cubics, in powers of the time since times (n,)."""
    if not len(centre):
        return np.zeros((len(first), 12))
    s, c = (first - centre[rows, 0])[:, None], centre[rows, 1:].reshape(-1, 3, 4).transpose(2, 0, 1)
    cubics = (
        c[0] + s * (c[1] + s * (c[2] + s * c[3])),
        c[1] + s * (2 * c[2] + s * 3 * c[3]),
        c[2] + s * 3 * c[3],
        c[3],
    )
    return np.stack(cubics, axis=-1).reshape(-1, 12)


def centre_in_time(t: Any, table: Any) -> Any:
    """Return the place of the centre at one time."""
    k = row_at(t, table)
    s = t - table[k, 0]
    return (
        table[k, 1] + s * (table[k, 2] + s * (table[k, 3] + s * table[k, 4])),
        table[k, 5] + s * (table[k, 6] + s * (table[k, 7] + s * table[k, 8])),
        table[k, 9] + s * (table[k, 10] + s * (table[k, 11] + s * table[k, 12])),
    )


def rotation_of(alpha: Any, beta: Any, gamma: Any) -> tuple[Any, ...]:
    """Return the rotation (9,) of axes turned about z, then their x axis, then their z axis (radians); elementwise."""
    ca, cb, cg = np.cos(alpha), np.cos(beta), np.cos(gamma)
    sa, sb, sg = np.sin(alpha), np.sin(beta), np.sin(gamma)
    return (
        ca * cg - sa * cb * sg, sa * cg + ca * cb * sg, sb * sg,
        -ca * sg - sa * cb * cg, -sa * sg + ca * cb * cg, sb * cg,
        sa * sb, -ca * sb, cb,
    )  # fmt: skip


def compiled_motion(now: Any, first: int, moves: Moves) -> tuple[Any, Any]:
    """Return two compiled functions of a time, and of the arguments with the tables of a motion from ``first`` on.

    The first returns the arguments at that time, by ``now``, and the rotation if the axes turn. The second takes a
    centre too, and returns the sum of both centres.
    """
    turns, shifts = moves
    value, turn, place = (njit(**_INLINED)(function) for function in (value_at, rotation_of, centre_in_time))
    a, b, c, d = (first, first + 1, first + 2, first + 3 if turns else first)

    def turned(t, packed):
        return now(t, packed) + turn(value(t, packed[a]), value(t, packed[b]), value(t, packed[c]))

    def shifted(t, packed, centre):
        x, y, z = place(t, packed[d])
        return centre[0] + x, centre[1] + y, centre[2] + z

    there = njit(lambda t, packed, centre: (centre[0], centre[1], centre[2]), **_INLINED)
    return (njit(**_INLINED)(turned) if turns else now), (njit(**_INLINED)(shifted) if shifts else there)
