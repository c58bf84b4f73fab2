"""Bodies that fly past particles: their kicks, and steps that are short enough for them.

Such a body is far from most particles for most of the time, and its force changes over the time in which it crosses its
distance. It kicks a particle once at the beginning and once at the end of each step, and the other forces act between
them (Tuckerman, Berne & Martyna 1992, J. Chem. Phys. 97, 1990): a fifth of the evaluations of other forces. The error
is of second order in the step, of the force of the body alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from streamkit.engine.cache import helper
from streamkit.engine.forces import FORCES, NO_FRAME, NO_TRACKS, ROW, Forces, add_forces, call_kernel
from streamkit.engine.levels import approach
from streamkit.engine.steps import A, H, T, V
from streamkit.stream import Array

PASSING = 0.4  # longest step near a body, in units of the time in which it crosses its distance
BENDING = 0.2  # longest step near a body, in units of the dynamical time about it
MISSED = 0.05  # error of the smallest distance from it, in units of the acceleration times the time span squared
FURTHER = 9  # levels beyond the deepest one that the passage of such a body may ask for


class Passing(NamedTuple):
    """Bodies that fly past: their forces, each on its trajectory, and their sizes (b,) in kpc, which are positive."""

    forces: Forces
    sizes: Array


PASSING_BODIES = types.NamedTuple([FORCES, types.float64[::1]], Passing)
_NONE = np.zeros(0, dtype=np.int64)
NOBODY = Passing(
    Forces(_NONE, np.zeros(1, dtype=np.int64), _NONE, np.zeros(1), 0.0, 1.0, NO_TRACKS, NO_FRAME), np.zeros(0)
)


@helper
def passages(passing, most, uniform, m, lanes, closest, other, centre, path, rate):
    """Raise the `rate` (see `rates`) of those of m lanes that bodies fly past in their time span.

    A passage takes its smallest distance, or the size if that is more, over the relative speed, and no step may be
    longer than that times PASSING, or than the dynamical time there times BENDING. The distance is less by what
    straight pieces and parabolas may miss. Only these rates may ask for more than 2^most steps. `other` is scratch.
    """
    forces, u, t, span, a = passing.forces, lanes[V:], lanes[T:], lanes[H:], lanes[A:]
    b0, b1, b2, s2 = other[:m], other[ROW : ROW + m], other[2 * ROW : 2 * ROW + m], other[3 * ROW : 3 * ROW + m]
    d0, d1, d2 = closest[:m], closest[ROW : ROW + m], closest[2 * ROW : 2 * ROW + m]
    a0, a1, a2 = a[:m], a[ROW : ROW + m], a[2 * ROW : 2 * ROW + m]
    u0, u1, u2, h = u[:m], u[ROW : ROW + m], u[2 * ROW : 2 * ROW + m], span[:m]
    crossing, bending = PASSING**-4, BENDING**-4
    for i in range(m):
        rate[i] = min(rate[i], 0.999 * (2.0**most / (h[i] + 1e-300)) ** 4)
    for b in range(passing.sizes.shape[0]):
        size, together = passing.sizes[b], m if uniform else 1
        for begin in range(0, m, together):
            approach(forces, b, begin, begin + together, lanes, closest, centre, path)
            inverse = 1.0 / (h[begin] + 1e-300)
            w0, w1, w2 = (path[6] - path[0]) * inverse, (path[7] - path[1]) * inverse, (path[8] - path[2]) * inverse
            for i in range(begin, begin + together):
                half = 0.5 * h[i]
                v0, v1, v2 = u0[i] + half * a0[i] - w0, u1[i] + half * a1[i] - w1, u2[i] + half * a2[i] - w2
                s2[i] = v0 * v0 + v1 * v1 + v2 * v2
        centre[:] = 0.0
        fresh = 1
        for c in range(forces.address.shape[0]):
            if forces.trajectory[c] == b:
                p, offset = forces.parameters, forces.offset[c]
                call_kernel(forces.address[c], 0, m, t, p, offset, centre, closest, other, fresh)
                fresh = 0
        for i in range(m):
            missed = MISSED * math.sqrt(a0[i] * a0[i] + a1[i] * a1[i] + a2[i] * a2[i]) * h[i] * h[i]
            distance2 = d0[i] * d0[i] + d1[i] * d1[i] + d2[i] * d2[i]
            distance = max(math.sqrt(distance2) - missed, size)
            pull2 = b0[i] * b0[i] + b1[i] * b1[i] + b2[i] * b2[i]
            passage = s2[i] / (distance * distance)
            rate[i] = max(rate[i], crossing * passage * passage, bending * pull2 / (distance2 + 1e-300))


@helper
def kick(passing, part, uniform, begin, end, lanes, relative, centre, a):
    """Kick lanes [begin, end) by all bodies, over the fraction `part` of their time steps; a is scratch."""
    add_forces(passing.forces, uniform, begin, end, lanes[T:], lanes, relative, centre, a)
    h = lanes[H + begin : H + end]
    for k in range(3):
        u_i, a_i = lanes[V + k * ROW + begin : V + k * ROW + end], a[k * ROW + begin : k * ROW + end]
        for i in range(u_i.shape[0]):
            u_i[i] += part * h[i] * a_i[i]
