"""All particles over one block of time in equal steps of leapfrog: for satellites whose every particle is followed.

Each step drifts, kicks and drifts with one force. Particles of one time go in batches that fit into the nearest cache.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
from numba import types

from streamkit.engine.arguments import layout_of, pack
from streamkit.engine.cache import also_for, cached
from streamkit.engine.field import Field, build_field
from streamkit.engine.forces import FORCES, LANES, ROW
from streamkit.engine.kernels import Force
from streamkit.engine.methods import LEAPFROG
from streamkit.engine.steps import METHOD, ROWS, H, Method, T, compose
from streamkit.engine.velocity_forces import DRAGGED
from streamkit.stream import Array, Orbit

TOGETHER = 256  # particles of a batch

_F1, _F = types.float64[::1], types.float64
_MARCH = METHOD, _F1, types.UniTuple(_F1, 6), _F, _F


@cached(types.void(FORCES, *_MARCH), nogil=True)
def _march(forces, method, lanes, particles, t0, t1):
    """Advance the rows x, y, z, u, v, w of all particles, in place, from t0 to t1; lanes are scratch."""
    relative, centre = np.empty(3 * ROW), np.empty(3)
    n, steps = particles[0].shape[0], method.most
    h = (t1 - t0) / steps
    for begin in range(0, n, TOGETHER):
        m = min(TOGETHER, n - begin)
        whole = (m + LANES - 1) // LANES * LANES
        for row, source in enumerate(particles):
            lanes[row * ROW : row * ROW + m] = source[begin : begin + m]
            for i in range(m, whole):
                lanes[row * ROW + i] = source[begin + m - 1]
        lanes[T : T + whole] = t0
        lanes[H : H + whole] = h
        compose(forces, method, True, 0, whole, steps, False, lanes, relative, centre)
        for row, out in enumerate(particles):
            out[begin : begin + m] = lanes[row * ROW : row * ROW + m]


@cache
def _compile_with_drag() -> None:
    also_for(_march, types.void(DRAGGED, *_MARCH))


def march(field: Field, q: Array, v: Array, t0: float, t1: float, steps: int) -> None:
    """Advance q, v (3, n), whose rows have no gaps, in place, all from t0 to t1 in equal steps of leapfrog.

    With as many threads as the field allows; the particles do not depend on their number.
    """
    method = Method(LEAPFROG.drift, LEAPFROG.kick, np.zeros(2), steps, np.empty(0))
    rows = (*q, *v)
    if field.drag is not None:
        _compile_with_drag()
    pieces = field.pieces(q.shape[1])
    if len(pieces) == 1:
        field.run(_march, method, np.empty(ROWS * ROW), rows, t0, t1)
        return
    forces = field.whole
    with ThreadPoolExecutor(len(pieces)) as pool:

        def carry(piece: slice) -> None:
            _march(forces, method, np.empty(ROWS * ROW), tuple(row[piece] for row in rows), t0, t1)

        list(pool.map(carry, pieces))


class MovingForce:
    """A field and a force about what moves in it, which may be another one in every block of time."""

    def __init__(self, field: Field, orbit: Orbit) -> None:
        self._base, self._orbit = field, orbit
        self._made: tuple[object, Field] | None = None

    def field_with(self, force: Force) -> Field:
        """Return the field with this force about the moving centre: the last one's no longer holds.

        A compiled force of the same class and with as many parameters as the last one replaces its numbers.
        """
        values = force.in_engine_units() if force.compiled and force.growth_table() is None else None
        if values is None:
            return self._base.with_moving(build_field([force]), self._orbit)
        packed = pack(values)
        shape = type(force), layout_of(values), len(packed)
        if self._made is None or self._made[0] != shape:
            self._made = shape, self._base.with_moving(build_field([force]), self._orbit)
        field = self._made[1]
        first = int(self._base.forces.offset[-1])
        field.forces.parameters[first : first + len(packed)] = packed
        return field
