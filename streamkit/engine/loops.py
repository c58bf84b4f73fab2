"""The compiled loops. They see plain arrays only, so one machine code serves every potential and composition.

Forces come in as the addresses of C functions (see ``kernels.py``); compiled once per machine (see ``cache.py``).
"""

from __future__ import annotations

import numpy as np
from numba import njit, types

from streamkit.engine.cache import INLINE, cached
from streamkit.engine.forces import BATCH, LANES, LEVELS, ROW, add_forces
from streamkit.engine.levels import alike, choose, give_back, place, rates, scatter, take

WORK, NUMBERS = 26 * ROW, 2 * ROW
"""Doubles and integers of scratch that `advance` needs. Its caller keeps them: to allocate costs as much as to use."""

LOOK_AGAIN, PARTS = 4, 4
"""Particles of higher levels choose their steps anew in every one of these parts of a block."""

_F1, _F2, _S2 = types.float64[::1], types.float64[:, ::1], types.float64[:, :]
_I1, _B1, _F, _N = types.int64[::1], types.boolean[::1], types.float64, types.intp
_STATE = (_F1,) * 6  # rows of positions and velocities
_HEAD = (_I1, _I1, _B1, _F1, _F, _F, _F2)  # address, offset, follows, p, first, step, track


@cached(types.void(*_HEAD, _F1, _F2, _F2))
def accelerations(address, offset, follows, p, first, step, track, t, q, out):
    """Total acceleration at q (3, n), times t (n,), into out (3, n)."""
    x, rel, a = np.zeros(3 * ROW), np.zeros(3 * ROW), np.empty(3 * ROW)
    times, centre = np.zeros(ROW), np.empty(3)
    for begin in range(0, q.shape[1], BATCH):
        m = min(BATCH, q.shape[1] - begin)
        for k in range(3):
            for i in range(m):
                x[k * ROW + i] = q[k, begin + i]
        for i in range(m):
            times[i] = t[begin + i]
        add_forces(address, offset, follows, p, first, step, track, False, 0, m, times, x, rel, centre, a)
        for k in range(3):
            for i in range(m):
                out[k, begin + i] = a[k * ROW + i]


@njit(**INLINE)
def compose(
    address, offset, follows, p, first, step, track, uniform, begin, end, steps, t, h, x, u, rel, centre, a, known,
    drift, kick,
):  # fmt: skip
    """Steps of drifts and kicks for the lanes begin to end, each with its own step h; known: a is that at first."""
    stages = kick.shape[0]
    reuse = drift[0] == 0.0 and drift[stages] == 0.0
    if not reuse:
        for i in range(begin, end):
            t[i] += drift[0] * h[i]
            for k in range(3):
                x[k * ROW + i] += drift[0] * h[i] * u[k * ROW + i]
    for s in range(steps):
        for j in range(stages):
            if j > 0 or not reuse or (s == 0 and not known):
                add_forces(address, offset, follows, p, first, step, track, uniform, begin, end, t, x, rel, centre, a)
            c, d = drift[j + 1], kick[j]
            if j == stages - 1 and s < steps - 1:
                c += drift[0]
                d += kick[0] if reuse else 0.0  # the next step begins with this same force
            if reuse and j == 0 and s > 0:
                d = 0.0
            h_i, t_i = h[begin:end], t[begin:end]
            for k in range(3):
                x_i = x[k * ROW + begin : k * ROW + end]
                u_i = u[k * ROW + begin : k * ROW + end]
                a_i = a[k * ROW + begin : k * ROW + end]
                for i in range(x_i.shape[0]):
                    y = u_i[i] + d * h_i[i] * a_i[i]
                    u_i[i] = y
                    x_i[i] += c * h_i[i] * y
            for i in range(t_i.shape[0]):
                t_i[i] += c * h_i[i]


AHEAD = 0.2, 2 / 3 - 0.2, 1 / 3, 0.0
"""From each stage of Nystrom's method to the time of the next, in units of its step."""


@njit(**INLINE)
def nystrom(
    address, offset, follows, p, first, step, track, uniform, begin, end, steps, t, h, x, u, rel, centre, k1, k2, k3, y,
):  # fmt: skip
    """Steps of Nystrom's fifth-order method; k1 is the acceleration at first, k2, k3 and y are scratch.

    Hairer, Norsett & Wanner 1993, Solving Ordinary Differential Equations I, table II.14.2. Four forces a step, of
    which the first is known already where a particle takes one: it was needed to choose the step.
    """
    for s in range(steps):
        t_i, h_i = t[begin:end], h[begin:end]
        for stage in range(4):  # one call for all stages: what is inlined four times takes long to compile
            if stage > 0 or s > 0:
                place = x if stage == 0 else y
                out = k1 if stage == 0 else k3 if stage == 2 else k2
                add_forces(
                    address, offset, follows, p, first, step, track, uniform, begin, end, t, place, rel, centre, out
                )
            for k in range(3):
                low, high = k * ROW + begin, k * ROW + end
                x_i, u_i, y_i = x[low:high], u[low:high], y[low:high]
                a, b, c = k1[low:high], k2[low:high], k3[low:high]
                if stage == 0:
                    for i in range(x_i.shape[0]):
                        y_i[i] = x_i[i] + h_i[i] * (0.2 * u_i[i] + h_i[i] * (0.02 * a[i]))
                elif stage == 1:
                    for i in range(x_i.shape[0]):
                        y_i[i] = x_i[i] + h_i[i] * (2 / 3 * u_i[i] + h_i[i] * (7 / 27 * b[i] - 1 / 27 * a[i]))
                elif stage == 2:
                    for i in range(x_i.shape[0]):
                        h1, x1, u1, a1, b1, c1 = h_i[i], x_i[i], u_i[i], a[i], b[i], c[i]
                        y_i[i] = x1 + h1 * (u1 + h1 * (0.3 * a1 - 2 / 35 * b1 + 9 / 35 * c1))
                        x_i[i] = x1 + h1 * (u1 + h1 * (1 / 24 * a1 + 25 / 84 * b1 + 9 / 56 * c1))
                        u_i[i] = u1 + h1 * (1 / 24 * a1 + 125 / 336 * b1 + 27 / 56 * c1)
                else:
                    for i in range(x_i.shape[0]):
                        u_i[i] += 5 / 48 * h_i[i] * b[i]
            for i in range(t_i.shape[0]):
                t_i[i] += AHEAD[stage] * h_i[i]


@cached(_N(*_HEAD, *_STATE, _I1, _F1, _F1, _F1, _F1, _F1, _N, _N, _I1, _F1, _I1))
def sweep(
    address, offset, follows, p, first, step, track, q0, q1, q2, v0, v1, v2, index, t0, t1, drift, kick, eta, most,
    limit, later, work, numbers,
):  # fmt: skip
    """Compositions of drifts and kicks, in place, of the particles index (n,) from their t0 to their t1.

    With eta (2,) zero all take ``most`` steps. Otherwise each takes the power of two, up to 2^most, that its dynamical
    time asks for; where one step would do, one or two of Nystrom's of half the length, which are cheaper and better.
    Those beyond the level ``limit`` are left where they are and put into ``later`` (n,), and their number is returned.
    Particles of a level march together, padded to whole vectors with copies whose results are dropped. work and
    numbers are scratch.
    """
    x, u, xs, us = work, work[3 * ROW :], work[6 * ROW :], work[9 * ROW :]
    a, rel, force, centre, path = work[12 * ROW :], work[15 * ROW :], work[18 * ROW :], np.empty(3), np.empty(9)
    t, span, ts, hs = work[21 * ROW :], work[22 * ROW :], work[23 * ROW :], work[24 * ROW :]
    rate, level, slot, kept = work[25 * ROW :], numbers, numbers[ROW:], 0
    x0, x1, x2, u0, u1, u2 = x, x[ROW:], x[2 * ROW :], u, u[ROW:], u[2 * ROW :]
    xs0, xs1, xs2, us0, us1, us2 = xs, xs[ROW:], xs[2 * ROW :], us, us[ROW:], us[2 * ROW :]
    start, size = np.empty(LEVELS, np.int64), np.empty(LEVELS, np.int64)
    adapts = eta[0] > 0.0
    begin, m = 0, 0
    while begin + m < index.shape[0]:
        begin += m
        m = alike(t0, index, begin)
        whole = (m + LANES - 1) // LANES * LANES
        for source, out in ((q0, x0), (q1, x1), (q2, x2), (v0, u0), (v1, u1), (v2, u2), (t0, t), (t1, span)):
            take(source, index, begin, m, out)
        uniform = t[0] == t[m - 1]  # times never decrease
        for i in range(whole):
            span[i] -= t[i]
        level[:m], size[:], size[0] = 0, 0, m
        if adapts:
            add_forces(address, offset, follows, p, first, step, track, uniform, 0, whole, t, x, rel, centre, a)
            rates(
                address, offset, follows, p, first, step, track, eta, uniform, whole, t, span, x, u, a, rel, force,
                centre, path, rate,
            )  # fmt: skip
            choose(m, rate, span, most + 1, level, size)
        place(m, level, limit, start, size, slot)
        for i in range(m):
            if slot[i] < 0:
                later[kept] = index[begin + i]
                kept += 1
        for rows, source, out in ((6, x, xs), (3, a, force), (2, t, ts)):  # u is behind x, span behind t
            scatter(rows, m, slot, source, out)
        for group in range(limit + 1):
            if size[group] == 0:
                continue
            begins, ends = start[group], start[group] + size[group]
            last = (ends + LANES - 1) // LANES * LANES
            for i in range(ends, last):
                ts[i], hs[i] = ts[ends - 1], hs[ends - 1]
                for k in range(3):
                    xs[k * ROW + i], us[k * ROW + i] = xs[k * ROW + ends - 1], us[k * ROW + ends - 1]
                    force[k * ROW + i] = force[k * ROW + ends - 1]
            calm = adapts and group < 2
            steps = 1 << (group if calm else group - 1) if adapts else most
            for i in range(begins, last):
                hs[i] /= steps
            if calm:
                nystrom(
                    address, offset, follows, p, first, step, track, uniform, begins, last, steps, ts, hs, xs, us, rel,
                    centre, force, x, u, a,
                )  # fmt: skip
            else:
                compose(
                    address, offset, follows, p, first, step, track, uniform, begins, last, steps, ts, hs, xs, us, rel,
                    centre, force, adapts, drift, kick,
                )  # fmt: skip
        for row, out in ((xs0, q0), (xs1, q1), (xs2, q2), (us0, v0), (us1, v1), (us2, v2)):
            give_back(m, slot, row, index, begin, out)
    return kept


@cached(types.void(*_HEAD, *_STATE, _F1, _F, _F1, _F1, _F1, _N, _F1, _I1))
def advance(
    address, offset, follows, p, first, step, track, q0, q1, q2, v0, v1, v2, t0, t1, drift, kick, eta, most, work,
    numbers,
):  # fmt: skip
    """Advance all particles, in place, from t0 (n,) to t1, in ``most`` equal steps (eta (2,) zero) or adaptively.

    ``drift`` (s + 1,) and ``kick`` (s,) are the fractions of a step. Where the first and last drift are zero, a
    step begins with the force that ended the one before. Particles that need many steps, deep in the progenitor,
    choose anew in every part of the block: their closest approach is over in a short part of it.
    """
    n = t0.shape[0]
    every, later, ends, now = np.arange(n), np.empty(n, np.int64), np.full(n, t1), t0.copy()
    limit = np.int64(0) if eta[0] == 0.0 else min(LOOK_AGAIN, most + 1)
    kept = sweep(
        address, offset, follows, p, first, step, track, q0, q1, q2, v0, v1, v2, every, t0, ends, drift, kick, eta,
        most, limit, later, work, numbers,
    )  # fmt: skip
    near = later[:kept].copy()
    if kept == 0:
        return
    for part in range(PARTS):
        for i in near:
            ends[i] = t1 if part == PARTS - 1 else t0[i] + (t1 - t0[i]) * (part + 1) / PARTS
        sweep(
            address, offset, follows, p, first, step, track, q0, q1, q2, v0, v1, v2, near, now, ends, drift, kick, eta,
            max(most - 2, 0), LEVELS - 1, later, work, numbers,
        )  # fmt: skip
        for i in near:
            now[i] = ends[i]


@cached(types.void(_I1, _I1, _B1, _F1, _F1, _F1, _F, _F, _F1, _F1, _F2))
def carry(address, offset, follows, p, q0, v0, t0, step, drift, kick, out):
    """March one orbit in fixed forces, writing its states (T, 9) at t0 + k * step (step may be negative).

    By a method that begins and ends with a kick: the force that ends a step is that of the next state.
    """
    x, u, a, rel = np.zeros(3 * ROW), np.zeros(3 * ROW), np.zeros(3 * ROW), np.zeros(3 * ROW)
    t, h, centre, track = np.empty(1), np.empty(1), np.empty(3), np.zeros((1, 20))
    h[0] = step
    for k in range(3):
        x[k * ROW], u[k * ROW] = q0[k], v0[k]
    t[0] = t0
    add_forces(address, offset, follows, p, 0.0, 1.0, track, True, 0, 1, t, x, rel, centre, a)
    for node in range(out.shape[0]):
        for k in range(3):
            out[node, k], out[node, 3 + k], out[node, 6 + k] = x[k * ROW], u[k * ROW], a[k * ROW]
        if node == out.shape[0] - 1:
            break  # no force is asked for beyond the last state
        t[0] = t0 + node * step
        compose(
            address, offset, follows, p, 0.0, 1.0, track, True, 0, 1, 1, t, h, x, u, rel, centre, a, True, drift, kick
        )
