"""The compiled loops, cached on disk. They see plain arrays only, so one machine code serves every potential.

Nothing here calls compiled code of another module: numba's disk cache would not notice a change there.
Forces come in as the addresses of C functions (see ``kernels.py``).
"""

from __future__ import annotations

import math

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

OPTIONS = {"cache": True, "error_model": "numpy", "fastmath": {"contract"}}
INLINE = {"inline": "always", "error_model": "numpy"}

BATCH = 512
"""Particles taken together."""
LANES = 8
"""Doubles in the widest vector register: groups of equal steps are padded to a multiple of it."""
DEEPEST = 20
"""Most levels of power-of-two steps."""
LOOK_AGAIN, PARTS = 3, 4
"""Particles of higher levels choose their steps anew after every one of these parts of a block."""
ROW = BATCH + LANES * (DEEPEST + 1)
"""Distance between the x, y and z of a particle in a batch. A constant: it proves to LLVM that rows are apart."""

# Explicit signatures: one machine code each, made once per machine, whatever layout a caller's arrays have.
_F1, _F2, _S2 = types.float64[::1], types.float64[:, ::1], types.float64[:, :]
_I1, _B1, _F, _N = types.int64[::1], types.boolean[::1], types.float64, types.intp
_HEAD = (_I1, _I1, _B1, _F1, _F, _F, _F2)  # address, offset, follows, p, first, step, track


@intrinsic
def call_kernel(typing_context, address, n, t, p, q, a):
    """Call ``void (*)(intp, double*, double*, double*, double*)`` at an integer address, with arrays."""

    def codegen(context, builder, signature, args):
        integer, double = ir.IntType(64), ir.DoubleType().as_pointer()
        function = ir.FunctionType(ir.VoidType(), [integer, double, double, double, double])
        pointer = builder.inttoptr(args[0], function.as_pointer())
        data = [
            context.make_array(kind)(context, builder, value).data
            for kind, value in zip(signature.args[2:], args[2:])  # noqa: B905  numba tuples
        ]
        builder.call(pointer, [args[1], *data])
        return context.get_dummy_value()

    return types.void(types.int64, types.intp, t, p, q, a), codegen


@njit(**INLINE)
def track_at(t, first, step, track, out):
    """Quintic Hermite position of the progenitor at time t from its states (T, 9), into out (3,)."""
    last = track.shape[0] - 2
    i = min(max(int((t - first) / step), 0), last)
    s = (t - first) / step - i
    for k in range(3):
        q0, v0, a0 = track[i, k], track[i, 3 + k] * step, track[i, 6 + k] * step * step
        q1, v1, a1 = track[i + 1, k], track[i + 1, 3 + k] * step, track[i + 1, 6 + k] * step * step
        d = q1 - q0 - v0 - 0.5 * a0
        dv = v1 - v0 - a0
        da = a1 - a0
        c3 = 10.0 * d - 4.0 * dv + 0.5 * da
        c4 = -15.0 * d + 7.0 * dv - da
        c5 = 6.0 * d - 3.0 * dv + 0.5 * da
        out[k] = q0 + s * (v0 + s * (0.5 * a0 + s * (c3 + s * (c4 + s * c5))))


@njit(**INLINE)
def add_forces(address, offset, follows, p, first, step, track, uniform, begin, end, t, x, rel, centre, a):
    """Sum the accelerations of lanes begin to end at x, times t, into a (rows ROW apart); rel is scratch."""
    for k in range(3):
        a[k * ROW + begin : k * ROW + end] = 0.0
    shifted = False
    for c in range(address.shape[0]):
        if not follows[c]:
            call_kernel(address[c], end - begin, t[begin:], p[offset[c] :], x[begin:], a[begin:])
            continue
        if not shifted:
            shifted = True
            if uniform:
                track_at(t[begin], first, step, track, centre)
                for k in range(3):
                    shift = centre[k]
                    from_row, to_row = x[k * ROW + begin : k * ROW + end], rel[k * ROW + begin : k * ROW + end]
                    for i in range(to_row.shape[0]):
                        to_row[i] = from_row[i] - shift
            else:
                for i in range(begin, end):
                    track_at(t[i], first, step, track, centre)
                    for k in range(3):
                        rel[k * ROW + i] = x[k * ROW + i] - centre[k]
        call_kernel(address[c], end - begin, t[begin:], p[offset[c] :], rel[begin:], a[begin:])


@njit(types.void(*_HEAD, _F1, _F2, _F2), **OPTIONS)
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
def closest_approach(m, x, w):
    """Move offsets x along straight lines x + s w, 0 <= s <= 1, to where they are closest to zero."""
    x0, x1, x2 = x[:m], x[ROW : ROW + m], x[2 * ROW : 2 * ROW + m]
    w0, w1, w2 = w[:m], w[ROW : ROW + m], w[2 * ROW : 2 * ROW + m]
    for i in range(m):
        a, b, c = x0[i], x1[i], x2[i]
        d, e, f = w0[i], w1[i], w2[i]
        s = min(max(-(a * d + b * e + c * f) / (d * d + e * e + f * f + 1e-300), 0.0), 1.0)
        x0[i], x1[i], x2[i] = a + s * d, b + s * e, c + s * f


@njit(**INLINE)
def load(q, v, index, t0, begin, m, x, u, t):
    """Copy m particles into a batch, padded to whole vectors with the last; say whether their times are equal."""
    uniform = True
    for i in range(m):
        j = index[begin + i]
        t[i] = t0[j]
        uniform = uniform and t0[j] == t[0]
        for k in range(3):
            x[k * ROW + i] = q[k, j]
            u[k * ROW + i] = v[k, j]
    whole = (m + LANES - 1) // LANES * LANES
    for i in range(m, whole):
        t[i] = t[m - 1]
        for k in range(3):
            x[k * ROW + i], u[k * ROW + i] = x[k * ROW + m - 1], u[k * ROW + m - 1]
    return uniform


@njit(types.void(*_HEAD, _S2, _S2, _I1, _F1, _F1, _F, _N, _I1), **OPTIONS)
def levels(address, offset, follows, p, first, step, track, q, v, index, t0, t1, eta, deepest, level):
    """Level (n,), the power of two of steps from t0 (n,) to t1 (n,), so that none exceeds eta dynamical times.

    The dynamical time is sqrt(distance / acceleration), about the Galactic centre for the fixed forces and about
    the progenitor for those that follow it, where the particle would come closest to each on a straight line.
    index (n,) names the columns of q and v, index and level those of t0, t1 and level.
    """
    x, u, rel, w, a = np.empty(3 * ROW), np.empty(3 * ROW), np.empty(3 * ROW), np.empty(3 * ROW), np.empty(3 * ROW)
    t, span, rate, centre, ahead = np.empty(ROW), np.empty(ROW), np.empty(ROW), np.empty(3), np.empty(3)
    for begin in range(0, index.shape[0], BATCH):
        m = min(BATCH, index.shape[0] - begin)
        uniform = load(q, v, index, t0, begin, m, x, u, t)
        whole = (m + LANES - 1) // LANES * LANES
        for i in range(m):
            span[i] = t1[index[begin + i]] - t[i]
        span[m:whole] = span[m - 1]
        rate[:whole] = 0.0
        for turn in range(2):
            moving = turn == 1
            found = False
            for c in range(address.shape[0]):
                found = found or follows[c] == moving
            if not found:
                continue
            centre[:], ahead[:] = 0.0, 0.0
            if moving:
                track_at(t[0], first, step, track, centre)
                track_at(t[0] + span[0], first, step, track, ahead)
            for k in range(3):
                rel_k, w_k, x_k, u_k = rel[k * ROW :], w[k * ROW :], x[k * ROW :], u[k * ROW :]
                shift, motion = centre[k], ahead[k] - centre[k]
                for i in range(whole):
                    rel_k[i] = x_k[i] - shift
                    w_k[i] = u_k[i] * span[i] - motion
            if moving and not uniform:
                for i in range(whole):
                    track_at(t[i], first, step, track, centre)
                    track_at(t[i] + span[i], first, step, track, ahead)
                    for k in range(3):
                        j = k * ROW + i
                        rel[j] = x[j] - centre[k]
                        w[j] = u[j] * span[i] - (ahead[k] - centre[k])
            closest_approach(whole, rel, w)
            for k in range(3):
                a[k * ROW : k * ROW + whole] = 0.0
            for c in range(address.shape[0]):
                if follows[c] == moving:
                    call_kernel(address[c], whole, t, p[offset[c] :], rel, a)
            a0, a1, a2 = a[:whole], a[ROW : ROW + whole], a[2 * ROW : 2 * ROW + whole]
            d0, d1, d2 = rel[:whole], rel[ROW : ROW + whole], rel[2 * ROW : 2 * ROW + whole]
            for i in range(whole):
                acceleration2 = a0[i] * a0[i] + a1[i] * a1[i] + a2[i] * a2[i]
                distance2 = d0[i] * d0[i] + d1[i] * d1[i] + d2[i] * d2[i]
                rate[i] = max(rate[i], acceleration2 / (distance2 + 1e-300))
        for i in range(whole):
            rate[i] = span[i] * math.sqrt(math.sqrt(rate[i])) / eta
        for i in range(m):
            j, bound = index[begin + i], 1.0
            level[j] = 0
            while rate[i] > bound and level[j] < deepest:
                level[j] += 1
                bound *= 2.0


@njit(**INLINE)
def place(m, index, begin, steps, start, size, slot):
    """Give each of m lanes a slot, grouped by its power of two of steps, stable, each group a multiple of LANES.

    start and size (groups,) receive each group's first slot and its lanes. Returns the number of groups: 1 where
    all steps are equal, which then need not be a power of two.
    """
    equal = True
    for i in range(m):
        equal = equal and steps[index[begin + i]] == steps[index[begin]]
    if equal:
        start[0], size[0] = 0, m
        for i in range(m):
            slot[i] = i
        return 1
    size[:] = 0
    for i in range(m):
        size[bit(steps[index[begin + i]])] += 1
    place_at = 0
    for k in range(size.shape[0]):
        start[k] = place_at
        place_at += (size[k] + LANES - 1) // LANES * LANES
        size[k] = 0
    for i in range(m):
        k = bit(steps[index[begin + i]])
        slot[i] = start[k] + size[k]
        size[k] += 1
    return size.shape[0]


@njit(**INLINE)
def bit(steps):
    """Position of the highest bit of a positive integer."""
    k = 0
    while steps > 1:
        steps >>= 1
        k += 1
    return k


@njit(**INLINE)
def compose(
    address, offset, follows, p, first, step, track, uniform, begin, end, steps, t, h, x, u, rel, centre, a, drift, kick
):  # fmt: skip
    """Steps of drifts and kicks for the lanes begin to end, each with its own step h."""
    stages = kick.shape[0]
    reuse = drift[0] == 0.0 and drift[stages] == 0.0
    if not reuse:
        for i in range(begin, end):
            t[i] += drift[0] * h[i]
            for k in range(3):
                x[k * ROW + i] += drift[0] * h[i] * u[k * ROW + i]
    for s in range(steps):
        for j in range(stages):
            if j > 0 or s == 0 or not reuse:
                add_forces(
                    address, offset, follows, p, first, step, track, uniform, begin, end, t, x, rel, centre, a
                )
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


@njit(types.void(*_HEAD, _S2, _S2, _I1, _F1, _F1, _F1, _F1, _I1), **OPTIONS)
def advance(address, offset, follows, p, first, step, track, q, v, index, t0, t1, drift, kick, steps):
    """Compositions of drifts and kicks, in place, of the particles index (n,) from their t0 to their t1.

    ``drift`` (s + 1,) and ``kick`` (s,) are the fractions of a step. Where the first and last drift are zero, a
    step begins with the force that ended the one before. Particles of equal ``steps`` march together, padded to
    whole vectors with copies whose results are dropped; steps are powers of two, or the same for all.
    """
    x, u, xs, us = np.empty(3 * ROW), np.empty(3 * ROW), np.empty(3 * ROW), np.empty(3 * ROW)
    a, rel, centre = np.empty(3 * ROW), np.empty(3 * ROW), np.empty(3)
    t, ts, hs = np.empty(ROW), np.empty(ROW), np.empty(ROW)
    slot, start, size = np.empty(ROW, np.int64), np.empty(DEEPEST + 2, np.int64), np.empty(DEEPEST + 2, np.int64)
    for begin in range(0, index.shape[0], BATCH):
        m = min(BATCH, index.shape[0] - begin)
        uniform = load(q, v, index, t0, begin, m, x, u, t)
        groups = place(m, index, begin, steps, start, size, slot)
        for k in range(3):
            for i in range(m):
                xs[k * ROW + slot[i]] = x[k * ROW + i]
                us[k * ROW + slot[i]] = u[k * ROW + i]
        for i in range(m):
            ts[slot[i]] = t[i]
            hs[slot[i]] = t1[index[begin + i]] - t[i]
        for group in range(groups):
            begins, ends = start[group], start[group] + size[group]
            last = (ends + LANES - 1) // LANES * LANES
            for i in range(ends, last):
                ts[i], hs[i] = ts[ends - 1], hs[ends - 1]
                for k in range(3):
                    xs[k * ROW + i], us[k * ROW + i] = xs[k * ROW + ends - 1], us[k * ROW + ends - 1]
            if size[group] > 0:
                count = steps[index[begin]] if groups == 1 else 1 << group
                for i in range(begins, last):
                    hs[i] /= count
                compose(
                    address, offset, follows, p, first, step, track, uniform, begins, last, count, ts, hs, xs, us,
                    rel, centre, a, drift, kick,
                )  # fmt: skip
        for k in range(3):
            for i in range(m):
                q[k, index[begin + i]] = xs[k * ROW + slot[i]]
                v[k, index[begin + i]] = us[k * ROW + slot[i]]


@njit(types.void(*_HEAD, _S2, _S2, _F1, _F, _F1, _F1, _F, _N), **OPTIONS)
def adapt(address, offset, follows, p, first, step, track, q, v, t0, t1, drift, kick, eta, deepest):
    """Advance all particles from t0 (n,) to t1, each with the steps that its dynamical time asks for.

    Those that need many steps, deep in the progenitor, look again after every eighth of the block: their
    closest approach is over in a short part of it.
    """
    n = t0.shape[0]
    every, ends, level = np.arange(n), np.full(n, t1), np.zeros(n, np.int64)
    levels(address, offset, follows, p, first, step, track, q, v, every, t0, ends, eta, deepest, level)
    many = level > np.int64(LOOK_AGAIN)
    near, far = every[many], every[~many]
    steps = np.empty(n, np.int64)
    for i in far:
        steps[i] = 1 << level[i]
    advance(address, offset, follows, p, first, step, track, q, v, far, t0, ends, drift, kick, steps)
    now = t0.copy()
    for part in range(PARTS):
        if near.shape[0] == 0:
            break
        for i in near:
            ends[i] = t1 if part == PARTS - 1 else t0[i] + (t1 - t0[i]) * (part + 1) / PARTS
        levels(address, offset, follows, p, first, step, track, q, v, near, now, ends, eta, max(deepest - 3, 0), level)
        for i in near:
            steps[i] = 1 << level[i]
        advance(address, offset, follows, p, first, step, track, q, v, near, now, ends, drift, kick, steps)
        for i in near:
            now[i] = ends[i]


@njit(types.void(_F1, _F, _S2, _S2, _F1, _F, _F2, _I1, _S2, _F1, _F1, _F1, _S2, _S2), **OPTIONS)
def record(t0, t1, q, v, state, r_tidal, plane, revolutions, planar, chi, gap, t_strip, dq_strip, dv_strip):
    """Update the particles' records at the end of a block: revolutions, phase chi, last time inside r_t.

    t0 (n,) is the time of each particle's previous sample, state (9,) the progenitor at t1, r_tidal its tidal
    radius there. plane (2, 3) spans the orbital plane; planar (2, n) holds the previous projection on it.
    revolutions (n,) counts crossings of the negative first axis, so that the angle swept needs no unwrapping.
    gap (n,) is the previous distance to the progenitor minus the tidal radius.
    """
    r_progenitor = math.sqrt(state[0] ** 2 + state[1] ** 2 + state[2] ** 2)
    for i in range(q.shape[1]):
        x, y, z = q[0, i], q[1, i], q[2, i]
        e = plane[0, 0] * x + plane[0, 1] * y + plane[0, 2] * z
        f = plane[1, 0] * x + plane[1, 1] * y + plane[1, 2] * z
        e0, f0 = planar[0, i], planar[1, i]
        if f0 >= 0.0 and f < 0.0:
            if e0 * f - e * f0 > 0.0:  # the chord crosses the axis at a negative first coordinate
                revolutions[i] += 1
        elif f0 < 0.0 and f >= 0.0:
            if e0 * f - e * f0 < 0.0:
                revolutions[i] -= 1
        planar[0, i], planar[1, i] = e, f
        chi[i] += (t1 - t0[i]) * (math.sqrt(x * x + y * y + z * z) - r_progenitor)
        dx, dy, dz = x - state[0], y - state[1], z - state[2]
        new = math.sqrt(dx * dx + dy * dy + dz * dz) - r_tidal
        old = gap[i]
        if new <= 0.0:
            t_strip[i] = t1
        elif old <= 0.0:
            # left during this block: the crossing by linear interpolation of the gap, smooth in the parameters
            t_strip[i] = t0[i] + (t1 - t0[i]) * (old / (old - new))
            dq_strip[0, i], dq_strip[1, i], dq_strip[2, i] = dx, dy, dz
            for k in range(3):
                dv_strip[k, i] = v[k, i] - state[3 + k]
        gap[i] = new


@njit(types.void(_I1, _I1, _B1, _F1, _F1, _F1, _F, _F, _N, _F1, _F1, _F2), **OPTIONS)
def carry(address, offset, follows, p, q0, v0, t0, step, substeps, drift, kick, out):
    """March one orbit in fixed forces, writing its states (T, 9) at t0 + k * step (step may be negative)."""
    x, u, a, rel = np.zeros(3 * ROW), np.zeros(3 * ROW), np.zeros(3 * ROW), np.zeros(3 * ROW)
    t, h, centre, track = np.empty(1), np.empty(1), np.empty(3), np.empty((2, 9))
    h[0] = step / substeps
    for k in range(3):
        x[k * ROW], u[k * ROW] = q0[k], v0[k]
    for node in range(out.shape[0]):
        t[0] = t0 + node * step
        add_forces(address, offset, follows, p, 0.0, 1.0, track, True, 0, 1, t, x, rel, centre, a)
        for k in range(3):
            out[node, k], out[node, 3 + k], out[node, 6 + k] = x[k * ROW], u[k * ROW], a[k * ROW]
        if node < out.shape[0] - 1:
            compose(
                address, offset, follows, p, 0.0, 1.0, track, True, 0, 1, substeps, t, h, x, u, rel, centre, a,
                drift, kick,
            )  # fmt: skip
