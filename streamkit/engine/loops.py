"""The compiled loops. They see plain arrays only, so one machine code serves every potential and composition.

The way of a particle through `advance`, which carries all particles over one block of time:

particles
    All that are released before the end of this block: rows x, y, z and u, v, w of n doubles, in the order of their
    release.
batch
    At most 4096 of them, few enough to stay in the cache: neighbours of one starting time where there are enough.
lanes
    The batch copied into rows of scratch, a column for each particle: position, velocity, time, time step,
    acceleration. A vector instruction takes 8 lanes at once, so they are padded to multiples of 8 with copies.
level
    From the acceleration at each lane follows how often its time span must be halved: that is its level.
slots
    The lanes sorted by level into a second set of rows. Each level takes its equal steps as one contiguous piece,
    without a branch. Then the slots go back to their particles; those of the padding are dropped.

Particles of a high level are postponed: they choose a level anew in each of four parts of the block. Forces are passed
as the addresses of C functions (see ``kernels.py``). The loops are compiled once per machine (see ``cache.py``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, types

from streamkit.engine.cache import INLINE, cached
from streamkit.engine.forces import BATCH, FORCES, LANES, LEVELS, ROW, add_forces
from streamkit.engine.levels import assign_slots, choose_levels, gather, give_back, next_batch, rates, scatter
from streamkit.engine.passing import CHUNKS, FURTHER, NO_BODIES, PASSING_BODIES, how_often, kick, passages
from streamkit.engine.steps import METHOD, ROWS, A, H, Method, T, compose, nystrom
from streamkit.engine.velocity_forces import DRAGGED, is_dragged
from streamkit.engine.views import fill, rest, view
from streamkit.stream import Array, IntArray

HIGHEST_LEVEL = 4  # highest level in the first pass over a block: particles of higher levels are postponed
PARTS = 4  # parts of a block in which the postponed particles choose their level anew


class Scratch(NamedTuple):
    """Work space of `advance`, allocated once by its caller: an allocation takes as long as the use of the space."""

    work: Array
    numbers: IntArray


WORK, NUMBERS = (2 * ROWS + 4) * ROW, 2 * ROW  # doubles and integers in it

_F1, _F2 = types.float64[::1], types.float64[:, ::1]
_I1, _F = types.int64[::1], types.float64
_PARTICLES = types.UniTuple(_F1, 6)  # rows of positions and velocities
_SCRATCH = types.NamedTuple([_F1, _I1], Scratch)


@cached(types.void(FORCES, _F1, _F2, _F2))
def accelerations(forces, t, q, out):
    """Total acceleration at q (3, n), times t (n,), into out (3, n)."""
    x, relative, a = np.empty(3 * ROW), np.empty(3 * ROW), np.empty(3 * ROW)
    times, centre = np.empty(ROW), np.empty(3)
    for begin in range(0, q.shape[1], BATCH):
        m = min(BATCH, q.shape[1] - begin)
        for k in range(3):
            for i in range(m):
                x[k * ROW + i] = q[k, begin + i]
        for i in range(m):
            times[i] = t[begin + i]
        add_forces(forces, False, 0, m, times, x, relative, centre, a)
        for k in range(3):
            for i in range(m):
                out[k, begin + i] = a[k * ROW + i]


_ADVANCE = METHOD, _SCRATCH, _PARTICLES, _F1, _F


@njit(**INLINE)
def sweep(forces, passing, method, scratch, particles, index, t0, t1, limit, postponed):
    """Advance the particles index (n,), in place, from their t0 to their t1 with steps of their own levels.

    Level 0 takes one step of Nystrom's method, and level 1 two: they are cheaper and more accurate there. A higher
    level g takes 2^(g - 1) steps of the given method. Particles above the level ``limit`` are not moved: their indices
    are written into ``postponed`` (n,), and their number is returned.
    """
    work, level, slot, count = scratch.work, scratch.numbers, rest(scratch.numbers, ROW), 0
    lanes, slots = view(work, 0, ROWS * ROW), view(work, ROWS * ROW, 2 * ROWS * ROW)
    relative, rate = rest(work, 2 * ROWS * ROW), rest(work, (2 * ROWS + 3) * ROW)
    centre, path = np.empty(3), np.empty(9)
    t, span = rest(lanes, T), rest(lanes, H)
    start, size = np.empty(LEVELS, np.int64), np.empty(LEVELS, np.int64)
    adapts = method.eta[0] > 0.0
    bodies = passing.sizes.shape[0]
    asked, asks = np.empty((bodies, ROW + CHUNKS), np.int8), np.empty((bodies, ROW), np.int8)
    often = np.empty((LEVELS, bodies), np.int64)
    begin, m = 0, 0
    while begin + m < index.shape[0]:
        begin += m
        m = next_batch(t0, index, begin)
        whole = (m + LANES - 1) // LANES * LANES
        for row, source in enumerate((*particles, t0, t1)):
            gather(source, index, begin, m, rest(lanes, row * ROW))
        uniform = t[0] == t[m - 1]  # times never decrease
        for i in range(whole):
            span[i] -= t[i]
        fill(level, 0, m, 0)
        fill(size, 0, LEVELS, 0)
        size[0] = m
        if adapts:
            add_forces(forces, uniform, 0, whole, t, lanes, relative, centre, rest(lanes, A))
            rates(forces, method.eta, method.heights, uniform, whole, lanes, relative, slots, centre, path, rate)
            deepest = method.most + 1
            if bodies > 0:
                passages(passing, method.most, uniform, whole, lanes, relative, slots, centre, path, rate, asked)
                deepest = min(deepest + FURTHER, LEVELS - 1)
            choose_levels(m, rate, span, deepest, level, size)
        assign_slots(m, level, limit, start, size, slot)
        how_often(passing, adapts, m, level, slot, asked, asks, often)
        for i in range(m):
            if slot[i] < 0:
                postponed[count] = index[begin + i]
                count += 1
        scatter(m, slot, lanes, slots)
        for group in range(limit + 1):
            if size[group] == 0:
                continue
            first, last = start[group], start[group] + size[group] - 1
            end = first + (size[group] + LANES - 1) // LANES * LANES
            calm = adapts and group < 2 and not is_dragged(forces)
            steps = 1 << (group if calm or group == 0 else group - 1) if adapts else method.most
            for k in range(ROWS):
                for i in range(last + 1, end):
                    slots[k * ROW + i] = slots[k * ROW + last]
            for i in range(first, end):
                slots[H + i] /= steps
            has_acceleration = adapts and not is_dragged(forces)
            pieces = steps if bodies > 0 else 1  # a kick by the bodies before and after each
            each = steps // pieces
            for piece in range(pieces + 1):
                where = uniform, first, end
                kick(passing, asks, often, group, piece, pieces, *where, slots, relative, centre, rest(lanes, A))
                if piece == pieces:
                    break
                if calm:
                    if piece > 0:
                        add_forces(forces, uniform, first, end, rest(slots, T), slots, relative, centre, rest(slots, A))
                    nystrom(forces, uniform, first, end, each, slots, lanes, relative, centre)
                else:
                    compose(forces, method, uniform, first, end, each, has_acceleration, slots, relative, centre)
        for row, out in enumerate(particles):
            give_back(m, slot, rest(slots, row * ROW), index, begin, out)
    return count


@cached(
    *(types.void(forces, bodies, *_ADVANCE) for forces in (FORCES, DRAGGED) for bodies in (NO_BODIES, PASSING_BODIES)),
    nogil=True,
)
def advance(forces, passing, method, scratch, particles, t0, t1):
    """Advance all particles, in place, from t0 (n,), which never decrease, to t1.

    With method.eta (2,) zero all take method.most equal steps. Otherwise each takes the power of two, up to 2^most,
    that its dynamical time asks for. Particles that need many steps, deep in the progenitor, choose anew in every
    part of the block, because their closest approach lasts for a short part of it.
    """
    most = method.most
    n = t0.shape[0]
    indices, postponed, ends, now = np.empty(n, np.int64), np.empty(n, np.int64), t0.copy(), t0.copy()
    for i in range(n):
        indices[i] = i
    shorter = Method(method.drift, method.kick, method.eta, max(most - 2, 0), method.heights)
    lowest = np.int64(0) if method.eta[0] == 0.0 else min(HIGHEST_LEVEL, most + 1)
    for part in range(PARTS + 1):  # the whole block, then its parts for the postponed; one call is compiled once
        for i in indices:
            ends[i] = t1 if part == 0 or part == PARTS else t0[i] + (t1 - t0[i]) * part / PARTS
        limit, how = (lowest, method) if part == 0 else (LEVELS - 1, shorter)
        count = sweep(forces, passing, how, scratch, particles, indices, now, ends, limit, postponed)
        if part == 0:
            if count == 0:
                return
            indices = postponed[:count].copy()
        else:
            for i in indices:
                now[i] = ends[i]
