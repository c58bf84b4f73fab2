"""All particles of a live satellite over one block of time, in equal steps of leapfrog.

Each step drifts, kicks and drifts with one force. All particles have the same time, and go in batches that fit into the
fastest cache. Where the moving force is a `streamkit.Monopole`, its force, the kick and the drift are one pass over the
particles. The host's force changes more slowly: it kicks once in several steps, in the middle of them (Tuckerman, Berne
& Martyna 1992, J. Chem. Phys. 97, 1990). This is symmetric and symplectic as leapfrog is.
"""

from __future__ import annotations

import math
from functools import cache, cached_property

import numpy as np
from numba import types

from streamkit.engine.arguments import layout_of, pack
from streamkit.engine.cache import cached
from streamkit.engine.field import Field, build_field
from streamkit.engine.forces import FORCES, LANES, ROW, add_forces, centre_at
from streamkit.engine.kernels import Force
from streamkit.engine.loops import Scratch
from streamkit.engine.methods import LEAPFROG
from streamkit.engine.steps import METHOD, A, H, Method, T, V, compose
from streamkit.engine.velocity_forces import DRAGGED
from streamkit.stream import Array, Orbit
from streamkit.units import G

TOGETHER = 256  # particles of a batch
HOST_COST = 3  # cost of the host's force in units of the cost of a step

_F1, _F = types.float64[::1], types.float64
_MARCH = METHOD, _F1, types.UniTuple(_F1, 6), _F, _F


@cached(types.void(FORCES, *_MARCH), types.void(DRAGGED, *_MARCH), nogil=True)
def _march(forces, method, lanes, particles, t0, t1):
    """Advance the rows x, y, z, u, v, w of all particles, in place, from t0 to t1; lanes are scratch."""
    relative, centre = np.empty(3 * ROW), np.empty(3)
    n, steps = particles[0].shape[0], method.most
    h = (t1 - t0) / steps
    for begin in range(0, n, TOGETHER):
        m = min(TOGETHER, n - begin)
        whole = (m + LANES - 1) // LANES * LANES
        for row, source in enumerate(particles):
            lane, part = lanes[row * ROW : row * ROW + whole], source[begin : begin + m]
            for i in range(m):
                lane[i] = part[i]
            for i in range(m, whole):
                lane[i] = part[m - 1]
        lanes[T : T + whole] = t0
        lanes[H : H + whole] = h
        compose(forces, method, True, 0, whole, steps, False, lanes, relative, centre)
        for row, out in enumerate(particles):
            lane, part = lanes[row * ROW : row * ROW + m], out[begin : begin + m]
            for i in range(m):
                part[i] = lane[i]


@cached(types.void(FORCES, _F1, _F1, types.UniTuple(_F1, 6), _F, _F, types.intp, types.intp), nogil=True)
def _march_sphere(forces, sphere, lanes, particles, t0, t1, kicks, each):
    """As `_march`, with a sphere c0 ... c8, b, e (11,) on the last trajectory: ``each`` steps for one kick."""
    c0, c1, c2, c3, c4 = sphere[0], sphere[1], sphere[2], sphere[3], sphere[4]
    c5, c6, c7, c8, b, e = sphere[5], sphere[6], sphere[7], sphere[8], sphere[9], sphere[10]
    b2, e2 = b * b, e * e
    relative, centre, place = np.empty(3 * ROW), np.empty(3), np.empty(3)
    n, steps, last = particles[0].shape[0], kicks * each, forces.tracks.shape[0] - 1
    h = (t1 - t0) / steps
    rest = 0.5 * h if each % 2 == 0 else 0.0  # from a kick of the host to the force of the sphere
    for begin in range(0, n, TOGETHER):
        m = min(TOGETHER, n - begin)
        whole = (m + LANES - 1) // LANES * LANES
        for row, source in enumerate(particles):
            lane, part = lanes[row * ROW : row * ROW + whole], source[begin : begin + m]
            for i in range(m):
                lane[i] = part[i]
            for i in range(m, whole):
                lane[i] = part[m - 1]
        for s in range(steps):
            now = t0 + (s + 0.5) * h
            drift = h if s > 0 else 0.5 * h
            centre_at(forces, last, now, place)
            p0, p1, p2 = place[0], place[1], place[2]
            if s % each == each // 2:
                drift -= rest
                for i in range(whole):
                    lanes[i] += drift * lanes[V + i]
                    lanes[ROW + i] += drift * lanes[V + ROW + i]
                    lanes[2 * ROW + i] += drift * lanes[V + 2 * ROW + i]
                lanes[T : T + whole] = now - rest
                add_forces(forces, True, 0, whole, lanes[T:], lanes, relative, centre, lanes[A:])
                for i in range(whole):
                    lanes[V + i] += each * h * lanes[A + i]
                    lanes[V + ROW + i] += each * h * lanes[A + ROW + i]
                    lanes[V + 2 * ROW + i] += each * h * lanes[A + 2 * ROW + i]
                drift = rest
            for i in range(whole):  # one array with constant offsets: vectors
                u, v, w = lanes[V + i], lanes[V + ROW + i], lanes[V + 2 * ROW + i]
                x, y, z = lanes[i] + drift * u, lanes[ROW + i] + drift * v, lanes[2 * ROW + i] + drift * w
                dx, dy, dz = x - p0, y - p1, z - p2
                d2 = dx * dx + dy * dy + dz * dz
                wide, narrow = d2 + b2, d2 + e2
                inverse = 1.0 / (wide * narrow)
                q = b2 * narrow * inverse
                f = c0 + q * (c1 + q * (c2 + q * (c3 + q * (c4 + q * (c5 + q * (c6 + q * (c7 + q * c8)))))))
                k = -h * G * f * math.sqrt(narrow) * inverse
                lanes[i], lanes[ROW + i], lanes[2 * ROW + i] = x, y, z
                lanes[V + i], lanes[V + ROW + i], lanes[V + 2 * ROW + i] = u + k * dx, v + k * dy, w + k * dz
        for i in range(whole):
            lanes[i] += 0.5 * h * lanes[V + i]
            lanes[ROW + i] += 0.5 * h * lanes[V + ROW + i]
            lanes[2 * ROW + i] += 0.5 * h * lanes[V + 2 * ROW + i]
        for row, out in enumerate(particles):
            lane, part = lanes[row * ROW : row * ROW + m], out[begin : begin + m]
            for i in range(m):
                part[i] = lane[i]


@cache
def split_kicks(steps: int, kicks: int) -> tuple[int, int]:
    """Return how often the host kicks and the number of steps to each of its kicks, at the least cost."""
    choices = [(k, max((steps + k - 1) // k, 1)) for k in range(kicks, max(steps, kicks) + 1)]
    return min(choices, key=lambda pair: pair[0] * (HOST_COST + pair[1]))


class MovingForce:
    """A host, and the force of a moving progenitor in it, which may be another one in every block of time.

    A force with an attribute ``sphere`` (11,), the numbers c_0 ... c_8, b, e of a `streamkit.Monopole`, is computed
    within the loop over the particles. Any other force, and a host with drag, takes the general loop.
    """

    def __init__(self, host: Field, orbit: Orbit) -> None:
        self._host, self._orbit = host, orbit
        self._made: tuple[object, Field] | None = None

    def advance(self, force: Force, q: Array, v: Array, t0: float, t1: float, steps: int, kicks: int) -> None:
        """Advance q, v (3, n), whose rows have no gaps, in place, all from t0 to t1 in equal steps.

        There are at least so many ``steps``, and at least so many ``kicks`` by the host. The loop uses as many threads
        as the field allows; the result does not depend on their number.
        """
        sphere = None if self._host.drag is not None else getattr(force, "sphere", None)
        field = self._field_with(force) if sphere is None else self._bare
        method = Method(LEAPFROG.drift, LEAPFROG.kick, np.zeros(2), max(steps, kicks), np.empty(0))

        def march(piece: slice, scratch: Scratch) -> None:
            rows = tuple(row[piece] for row in (*q, *v))
            if sphere is None:
                _march(field.all_forces, method, scratch.work, rows, t0, t1)
            else:
                _march_sphere(field.forces, sphere, scratch.work, rows, t0, t1, *split_kicks(steps, kicks))

        field.spread(q.shape[1], march)

    @cached_property
    def _bare(self) -> Field:
        """The host with the trajectory, on which no force moves."""
        return self._host.with_moving(build_field([]), self._orbit)

    def _field_with(self, force: Force) -> Field:
        """Return the host with this force: the numbers of a compiled one of the same class replace the last one's."""
        if force.changes() or not force.compiled:
            return self._host.with_moving(build_field([force]), self._orbit)
        rotation = force.rotation()
        values = force.in_engine_units() + (rotation or ())
        packed = pack(values)
        shape = type(force), layout_of(values), len(packed), rotation is None
        if self._made is None or self._made[0] != shape:
            self._made = shape, self._host.with_moving(build_field([force]), self._orbit)
        field = self._made[1]
        first = int(self._host.forces.offset[-1])
        field.forces.parameters[first : first + len(packed)] = packed
        return field
