"""Bodies that fly past particles: their kicks, and steps that are short enough for them.

Such a body is far from most particles for most of the time, and its force changes over the time in which it crosses its
distance. Kicks by the bodies stand between steps of the other forces (Tuckerman, Berne & Martyna 1992, J. Chem. Phys.
97, 1990), which saves four fifths of the evaluations. The error is of second order in the step, of the force of the
body alone. Each body kicks as often as its own passage asks for: one that is far away, or too light to be noticed,
kicks once in the middle of a block, while another one kicks the same particle hundreds of times. What one particle asks
for does not depend on the others.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types
from numba.extending import overload

from streamkit.engine.cache import OPTIONS, helper
from streamkit.engine.forces import (
    BATCH,
    FORCES,
    LEVELS,
    ROW,
    Forces,
    call_kernel,
    positions_about,
)  # fmt: skip
from streamkit.engine.levels import approach, follow, foot, nearest
from streamkit.engine.steps import A, H, T, V
from streamkit.engine.views import axes_view, fill, largest, rest, row_view, view
from streamkit.stream import Array, IntArray

PASSING = 0.4  # longest step near a body, in units of the time in which it crosses its distance
BENDING = 0.2  # longest step near a body, in units of the dynamical time about it
NOTICED = 0.03  # km/s; a passage that changes the velocity by less has longer steps, of an error of a tenth of it
MISSED = 0.05  # error of the smallest distance from it, in units of the acceleration times the time span squared
FURTHER = 9  # levels beyond the deepest one that the passage of such a body may ask for
FEW = 4  # bodies for which chunks of particles are not looked at together
HALF = 0.5**4  # fourth power of the number of steps beyond which a body asks for two
CHUNK = 64  # neighbours in the order of their release that are far from most bodies together, in two arms
CHUNKS = BATCH // CHUNK + 1


class Passing(NamedTuple):
    """Bodies that fly past particles.

    Attributes
    ----------
    forces
        Their forces, those of each body together, each body on its trajectory.
    sizes
        (b,) their sizes in kpc, which are positive.
    strengths
        (b,) G times their masses, in kpc (km/s)^2.
    first
        (b + 1,) where the forces of each body begin.
    """

    forces: Forces
    sizes: Array
    strengths: Array
    first: IntArray


_F1, _I1 = types.float64[::1], types.int64[::1]
PASSING_BODIES = types.NamedTuple([FORCES, _F1, _F1, _I1], Passing)


class Nobody(NamedTuple):
    """No bodies: a type of its own, so that loops for it have no code for bodies, which takes seconds to compile."""

    sizes: Array


NOBODY, NO_BODIES = Nobody(np.zeros(0)), types.NamedUniTuple(_F1, 1, Nobody)


def passages(passing, most, uniform, m, lanes, closest, other, centre, path, rate, asked):
    """Raise the rates of lanes that bodies fly past, see `_look_for_passages`."""


def how_often(passing, adapts, m, level, slot, asked, asks, often):
    """Store how often bodies kick, see `_how_often`."""


def kick(passing, asks, often, level, piece, pieces, uniform, begin, end, lanes, relative, centre, a):
    """Kick lanes by the bodies, see `_kick`."""


@helper
def _look_for_passages(passing, most, uniform, m, lanes, closest, other, centre, path, rate, asked):
    """Raise the `rate` (see `rates`) of those of m lanes that bodies fly past in their time span.

    A passage takes its smallest distance, or the size if that is more, over the relative speed, and no step may be
    longer than that times PASSING, or than the dynamical time there times BENDING; for a passage that changes the
    velocity by less than NOTICED it may be longer, by the root of their ratio. The distance is less by what straight
    pieces and parabolas may miss. Only these rates may ask for more than 2^most steps.

    asked (b, ROW + CHUNKS) receives the level that each body asks for, 0 where one step for the time span is enough.
    Its last columns say of each chunk of lanes whether such levels are there; if not, they are all 0. `other` is
    scratch.
    """
    forces, u, t, span, a = passing.forces, rest(lanes, V), rest(lanes, T), rest(lanes, H), rest(lanes, A)
    crossing, bending, noticed = PASSING**-4, BENDING**-4, 4.0 / NOTICED**2
    missed, span4 = view(other, 8 * ROW, 8 * ROW + m), view(other, 9 * ROW, 9 * ROW + m)
    initial2, pull2 = view(other, 5 * ROW, 5 * ROW + m), view(other, 6 * ROW, 6 * ROW + m)
    u0, u1, u2 = axes_view(u, 0, m, ROW)
    a0, a1, a2 = axes_view(a, 0, m, ROW)
    for i in range(m):
        initial2[i] = u0[i] * u0[i] + u1[i] * u1[i] + u2[i] * u2[i]
        pull2[i] = a0[i] * a0[i] + a1[i] * a1[i] + a2[i] * a2[i]
    span_i, highest = view(span, 0, m), 0.999 * 2.0 ** (4 * most)
    for i in range(m):
        missed[i] = MISSED * math.sqrt(pull2[i]) * span_i[i] * span_i[i]
        span4[i] = span_i[i] ** 4
        rate[i] = min(rate[i], highest / (span4[i] + 1e-300))
    fastest, pulled, reach = math.sqrt(largest(initial2)), math.sqrt(largest(pull2)), 0.0
    duration = span[0] if uniform else t[m - 1] + span[m - 1] - t[0]
    arms = np.empty((2 * CHUNKS if uniform and passing.sizes.shape[0] > FEW else 0, 11))
    if arms.shape[0] > 0:
        enclose(m, lanes, missed, arms)
    for b in range(passing.sizes.shape[0]):
        size, strength2 = passing.sizes[b], passing.strengths[b] ** 2
        for begin in range(0, m, CHUNK):
            end, chunk = min(begin + CHUNK, m), begin // CHUNK
            if begin == 0 or not uniform:
                follow(forces, b, t[0], duration, centre, path)
            if arms.shape[0] > 0:
                asked[b, ROW + chunk] = is_close(arms, chunk, path, duration, size, passing.strengths[b])
            else:
                if begin == 0:
                    reach = reach_of(path, duration, span[0], size, passing.strengths[b], fastest, pulled)
                asked[b, ROW + chunk] = some_within(reach, begin, end, lanes, path)
            if asked[b, ROW + chunk] == 0:
                continue
            together = end - begin if uniform else 1
            for first in range(begin, end, together):
                last = first + together
                if uniform:
                    nearest(first, last, lanes, path, closest)
                else:
                    approach(forces, b, first, last, lanes, closest, centre, path)
                inverse = 1.0 / (span[first] + 1e-300)
                w0, w1, w2 = (path[6] - path[0]) * inverse, (path[7] - path[1]) * inverse, (path[8] - path[2]) * inverse
                u0, u1, u2 = axes_view(u, first, last, ROW)
                a0, a1, a2 = axes_view(a, first, last, ROW)
                speed2, h = view(other, 3 * ROW + first, 3 * ROW + last), view(span, first, last)
                for i in range(speed2.shape[0]):
                    v0, v1, v2 = u0[i] + 0.5 * h[i] * a0[i], u1[i] + 0.5 * h[i] * a1[i], u2[i] + 0.5 * h[i] * a2[i]
                    speed2[i] = (v0 - w0) ** 2 + (v1 - w1) ** 2 + (v2 - w2) ** 2 + 1e-300
            speed2, near2 = view(other, 3 * ROW + begin, 3 * ROW + end), view(other, 4 * ROW + begin, 4 * ROW + end)
            d0, d1, d2 = axes_view(closest, begin, end, ROW)
            missed_i, span4_i = view(missed, begin, end), view(span4, begin, end)
            more = 0
            for i in range(near2.shape[0]):  # as if the mass were in a point
                near = max(math.sqrt(d0[i] * d0[i] + d1[i] * d1[i] + d2[i] * d2[i]) - missed_i[i], size)
                inverse2 = 1.0 / (near * near)
                passage, bend = speed2[i] * inverse2, strength2 * inverse2 * inverse2 * inverse2
                unnoticed = min(noticed * strength2 * inverse2, speed2[i])
                near2[i] = near * near
                wanted = max(crossing * passage * inverse2 * unnoticed, bending * bend)
                more += 1 if wanted * span4_i[i] > HALF else 0
            asked[b, ROW + chunk] = more > 0
            if more == 0:
                continue
            fill(centre, 0, 3, 0.0)
            fresh = 1
            for c in range(passing.first[b], passing.first[b + 1]):
                p, offset = forces.parameters, forces.offset[c]
                call_kernel(forces.address[c], begin, end - begin, t, p, offset, centre, closest, other, fresh)
                fresh = 0
            for i in range(end - begin):
                b0, b1, b2 = other[begin + i], other[ROW + begin + i], other[2 * ROW + begin + i]
                force2, distance2 = b0 * b0 + b1 * b1 + b2 * b2, d0[i] * d0[i] + d1[i] * d1[i] + d2[i] * d2[i]
                passage = speed2[i] / near2[i]
                unnoticed = min(noticed * force2 / passage, 1.0)
                wanted = max(crossing * passage * passage * unnoticed, bending * force2 / (distance2 + 1e-300))
                steps, bound, level = wanted * span4_i[i], 16.0, 0
                if steps > HALF:
                    rate[begin + i] = max(rate[begin + i], wanted)
                    level = 2
                    while steps > bound and level < LEVELS:
                        level += 1
                        bound *= 16.0
                asked[b, begin + i] = level


@helper
def enclose(m, lanes, missed, arms):
    """Store in arms (2 * CHUNKS, 11) spheres that hold the lanes of even and of odd number of each chunk of m.

    Their centre at the beginning, the middle and the end of the time span, which all lanes share, their radius, and the
    largest velocity relative to the centre. Schemes release particles into both arms in turn.
    """
    u, a, span = rest(lanes, V), rest(lanes, A), lanes[H]
    for arm in range(2 * ((m + CHUNK - 1) // CHUNK)):
        begin, end = arm // 2 * CHUNK + arm % 2, min(arm // 2 * CHUNK + CHUNK, m)
        count, radius2, most_missed = (end - begin + 1) // 2, 0.0, 0.0
        for k in range(9):
            arms[arm, k] = 0.0
        for i in range(begin, end, 2):
            for k in range(9):
                j, s = k % 3 * ROW + i, 0.5 * (k // 3) * span
                arms[arm, k] += (lanes[j] + s * (u[j] + 0.5 * s * a[j])) / count
        for i in range(begin, end, 2):
            for node in range(3):
                r2, s = 0.0, 0.5 * node * span
                for k in range(3):
                    j = k * ROW + i
                    r2 += (lanes[j] + s * (u[j] + 0.5 * s * a[j]) - arms[arm, 3 * node + k]) ** 2
                radius2 = max(radius2, r2)
            most_missed = max(most_missed, missed[i])
        arms[arm, 9] = math.sqrt(radius2) + most_missed
        arms[arm, 10] = 2.0 * math.sqrt(radius2) / (span + 1e-300)


@helper
def is_close(arms, chunk, path, span, size, strength):
    """Return 1 if a body on a path may ask lanes of a chunk for a level, or else 0."""
    inverse = 1.0 / (span + 1e-300)
    for arm in range(2 * chunk, 2 * chunk + 2):
        b0, b1, b2 = arms[arm, 0] - path[0], arms[arm, 1] - path[1], arms[arm, 2] - path[2]
        m0, m1, m2 = arms[arm, 3] - path[3], arms[arm, 4] - path[4], arms[arm, 5] - path[5]
        e0, e1, e2 = arms[arm, 6] - path[6], arms[arm, 7] - path[7], arms[arm, 8] - path[8]
        _, _, _, first = foot(b0, b1, b2, m0, m1, m2)
        _, _, _, second = foot(e0, e1, e2, m0, m1, m2)
        near = max(math.sqrt(min(first, second)) - arms[arm, 9], size)
        speed = math.sqrt((e0 - b0) ** 2 + (e1 - b1) ** 2 + (e2 - b2) ** 2) * inverse + arms[arm, 10]
        steps2, bends2 = (span * speed / (PASSING * near)) ** 2, strength * (span / BENDING) ** 2 / near**3
        if steps2 * min(2.0 * strength / (near * speed * NOTICED + 1e-300), 1.0) > 0.25 or bends2 > 0.25:
            return 1
    return 0


@helper
def reach_of(path, duration, span, size, strength, fastest, pulled):
    """Return the distance of the middles of paths beyond which a body asks no lane for a level.

    path (9,) is that of the body in a duration in which all lanes have their time spans, and span the longest of these.
    At its beginning no lane is faster than `fastest`, or has a larger acceleration than `pulled`.
    """
    b0, b1, b2 = path[0] - path[3], path[1] - path[4], path[2] - path[5]
    e0, e1, e2 = path[6] - path[3], path[7] - path[4], path[8] - path[5]
    aside = math.sqrt(max(b0 * b0 + b1 * b1 + b2 * b2, e0 * e0 + e1 * e1 + e2 * e2))
    bend = math.sqrt((b0 + e0) ** 2 + (b1 + e1) ** 2 + (b2 + e2) ** 2)
    fastest += 0.5 * span * pulled
    speed = fastest + (2.0 * aside + bend) / (duration + 1e-300)
    crossed = 2.0 * span * speed / PASSING  # this and the others as in `is_close`
    unnoticed = (2.0 * crossed * crossed * strength / (speed * NOTICED)) ** (1 / 3)
    bent = (4.0 * strength * (span / BENDING) ** 2) ** (1 / 3)
    near = max(min(crossed, unnoticed), bent)
    return near + aside + 0.5 * span * fastest + (0.125 + MISSED) * span * span * pulled if near > size else 0.0


@helper
def some_within(reach, begin, end, lanes, path):
    """Return 1 if one of the lanes [begin, end) is within reach of a body in the middle of their paths, or else 0."""
    x0, x1, x2 = axes_view(lanes, begin, end, ROW)
    u0, u1, u2 = axes_view(rest(lanes, V), begin, end, ROW)
    a0, a1, a2 = axes_view(rest(lanes, A), begin, end, ROW)
    h, c0, c1, c2, reach2, count = view(lanes, H + begin, H + end), path[3], path[4], path[5], reach * reach, 0
    for i in range(h.shape[0]):
        s, r = 0.5 * h[i], 0.125 * h[i] * h[i]
        d0, d1 = x0[i] + s * u0[i] + r * a0[i] - c0, x1[i] + s * u1[i] + r * a1[i] - c1
        d2 = x2[i] + s * u2[i] + r * a2[i] - c2
        count += 1 if d0 * d0 + d1 * d1 + d2 * d2 < reach2 else 0
    return 1 if count > 0 else 0


@helper
def _how_often(adapts, m, level, slot, asked, asks, often):
    """Store in often (levels, b) the highest level that each body asks of those of m lanes that have a level.

    asks (b, ROW) receives the level that it asks of each lane, in the order of the slots.
    If the steps do not adapt, all bodies kick at every step.
    """
    often[:] = 0 if adapts else LEVELS
    if not adapts:
        asks[:] = LEVELS
        return
    for b in range(asked.shape[0]):
        asks[b, :] = 0
        for begin in range(0, m, CHUNK):
            if asked[b, ROW + begin // CHUNK] > 0:
                for i in range(begin, min(begin + CHUNK, m)):
                    often[level[i], b] = max(often[level[i], b], asked[b, i])
                    if slot[i] >= 0:
                        asks[b, slot[i]] = asked[b, i]


@helper
def _kick(passing, asks, often, level, piece, pieces, uniform, begin, end, lanes, relative, centre, a):
    """Kick lanes [begin, end) of a level before a piece of their time span, or after the last; a is scratch.

    A body kicks each of them before every 1, 2, 4 ... pieces, as often as this lane asks for. Where one kick is enough
    for all pieces, it stands in their middle: that costs half of two at the ends, and the error is half as large.
    """
    forces, t, h = passing.forces, rest(lanes, T), view(lanes, H + begin, H + end)
    weight = 0.5 if piece == 0 or piece == pieces else 1.0
    once = pieces if 2 * piece == pieces else 0 if pieces > 1 else 0.5
    for b in range(passing.sizes.shape[0]):  # one after the other: the sum does not depend on the other lanes
        finest = max(pieces >> max(often[level, b] - 1, 0), 1)
        if once == 0 and (finest == pieces or piece & (finest - 1) != 0):  # a power of two
            continue
        q = positions_about(forces, b, uniform, begin, end, t, lanes, relative, centre)
        fresh = 1
        for c in range(passing.first[b], passing.first[b + 1]):
            p, offset = forces.parameters, forces.offset[c]
            call_kernel(forces.address[c], begin, end - begin, t, p, offset, centre, q, a, fresh)
            fresh = 0
        part, asks_i = view(relative, begin, end), row_view(asks, b, begin, end)
        for i in range(part.shape[0]):
            part[i] = once * h[i]
        for i in range(part.shape[0] if often[level, b] > 1 else 0):
            stride = max(pieces >> max(asks_i[i] - 1, 0), 1)
            if stride < pieces:
                part[i] = stride * weight * h[i] if piece & (stride - 1) == 0 else 0.0
        for k in range(3):
            u_i, a_i = view(lanes, V + k * ROW + begin, V + k * ROW + end), view(a, k * ROW + begin, k * ROW + end)
            for i in range(u_i.shape[0]):
                u_i[i] += part[i] * a_i[i]


@overload(passages, jit_options=OPTIONS)
def _passages(passing, most, uniform, m, lanes, closest, other, centre, path, rate, asked):
    if passing.instance_class is Nobody:
        return lambda passing, most, uniform, m, lanes, closest, other, centre, path, rate, asked: None

    def call(passing, most, uniform, m, lanes, closest, other, centre, path, rate, asked):
        _look_for_passages(passing, most, uniform, m, lanes, closest, other, centre, path, rate, asked)

    return call


@overload(how_often, jit_options=OPTIONS)
def _how_often_if_any(passing, adapts, m, level, slot, asked, asks, often):
    if passing.instance_class is Nobody:
        return lambda passing, adapts, m, level, slot, asked, asks, often: None

    def call(passing, adapts, m, level, slot, asked, asks, often):
        _how_often(adapts, m, level, slot, asked, asks, often)

    return call


@overload(kick, jit_options=OPTIONS)
def _kick_if_any(passing, asks, often, level, piece, pieces, uniform, begin, end, lanes, relative, centre, a):
    if passing.instance_class is Nobody:
        return lambda passing, asks, often, level, piece, pieces, uniform, begin, end, lanes, relative, centre, a: None

    def call(passing, asks, often, level, piece, pieces, uniform, begin, end, lanes, relative, centre, a):
        _kick(passing, asks, often, level, piece, pieces, uniform, begin, end, lanes, relative, centre, a)

    return call
