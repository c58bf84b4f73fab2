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

# Explicit signatures: one machine code each, made once per machine, whatever layout a caller's arrays have.
_F1, _F2, _S2 = types.float64[::1], types.float64[:, ::1], types.float64[:, :]
_I1, _B1, _F, _N = types.int64[::1], types.boolean[::1], types.float64, types.intp
_HEAD = (_I1, _I1, _B1, _F1, _F, _F, _F2, _N)  # address, offset, follows, p, first, step, track, width


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


@njit(inline="always", error_model="numpy")
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


@njit(inline="always", error_model="numpy")
def add_forces(address, offset, follows, p, first, step, track, uniform, t, x, rel, centre, a):
    """Sum the accelerations at x (3, m), times t (m,), into a (3, m); rel and centre are scratch."""
    m = x.shape[1]
    for k in range(3):
        for i in range(m):
            a[k, i] = 0.0
    shifted = False
    for c in range(address.shape[0]):
        if not follows[c]:
            call_kernel(address[c], m, t, p[offset[c] :], x, a)
            continue
        if not shifted:
            shifted = True
            if uniform:
                track_at(t[0], first, step, track, centre)
                for k in range(3):
                    shift = centre[k]
                    for i in range(m):
                        rel[k, i] = x[k, i] - shift
            else:
                for i in range(m):
                    track_at(t[i], first, step, track, centre)
                    for k in range(3):
                        rel[k, i] = x[k, i] - centre[k]
        call_kernel(address[c], m, t, p[offset[c] :], rel, a)


@njit(types.void(*_HEAD, _F1, _F2, _F2), **OPTIONS)
def accelerations(address, offset, follows, p, first, step, track, width, t, q, out):
    """Total acceleration at q (3, n), times t (n,), into out (3, n)."""
    n = q.shape[1]
    centre = np.empty(3)
    for begin in range(0, n, width):
        m = min(width, n - begin)
        x = np.empty((3, m))
        rel = np.empty((3, m))
        a = np.empty((3, m))
        times = np.empty(m)
        for i in range(m):
            times[i] = t[begin + i]
            for k in range(3):
                x[k, i] = q[k, begin + i]
        add_forces(address, offset, follows, p, first, step, track, False, times, x, rel, centre, a)
        for k in range(3):
            for i in range(m):
                out[k, begin + i] = a[k, i]


@njit(types.void(*_HEAD, _S2, _S2, _F1, _F, _I1, _I1, _F1, _F1), **OPTIONS)
def advance(address, offset, follows, p, first, step, track, width, q, v, t0, t1, order, substeps, drift, kick):
    """Composition of drifts and kicks, in place, from each particle's t0 to t1.

    ``drift`` (s + 1,) and ``kick`` (s,) are the fractions of a step. Where the first and last drift are zero, a
    step begins with the force that ended the one before. ``order`` (n,) sorts the particles so that
    those with equal ``substeps`` (n,) stand together: a batch never mixes them.
    """
    n = q.shape[1]
    stages = kick.shape[0]
    reuse = drift[0] == 0.0 and drift[stages] == 0.0
    flat_x, flat_v, flat_a, flat_rel = np.empty(3 * width), np.empty(3 * width), np.empty(3 * width), np.empty(3 * width)
    flat_t, flat_h = np.empty(width), np.empty(width)
    centre = np.empty(3)
    begin = 0
    while begin < n:
        steps = substeps[order[begin]]
        end = begin + 1
        while end < n and end - begin < width and substeps[order[end]] == steps:
            end += 1
        m = end - begin
        x = flat_x[: 3 * m].reshape(3, m)
        u = flat_v[: 3 * m].reshape(3, m)
        a = flat_a[: 3 * m].reshape(3, m)
        rel = flat_rel[: 3 * m].reshape(3, m)
        t, h = flat_t[:m], flat_h[:m]
        uniform = True
        for i in range(m):
            j = order[begin + i]
            t[i] = t0[j]
            h[i] = (t1 - t0[j]) / steps
            uniform = uniform and t0[j] == t0[order[begin]]
            for k in range(3):
                x[k, i] = q[k, j]
                u[k, i] = v[k, j]
        for i in range(m):
            t[i] += drift[0] * h[i]
            for k in range(3):
                x[k, i] += drift[0] * h[i] * u[k, i]
        for s in range(steps):
            for j in range(stages):
                if j > 0 or s == 0 or not reuse:
                    add_forces(address, offset, follows, p, first, step, track, uniform, t, x, rel, centre, a)
                c = drift[j + 1]
                if j == stages - 1 and s < steps - 1:
                    c += drift[0]
                d = kick[j]
                for k in range(3):
                    for i in range(m):
                        u[k, i] += d * h[i] * a[k, i]
                        x[k, i] += c * h[i] * u[k, i]
                for i in range(m):
                    t[i] += c * h[i]
        for i in range(m):
            j = order[begin + i]
            for k in range(3):
                q[k, j] = x[k, i]
                v[k, j] = u[k, i]
        begin = end


@njit(inline="always", error_model="numpy")
def closest_approach(x, w):
    """Move offsets x (3, m) along straight lines x + s w, 0 <= s <= 1, to where they are closest to zero."""
    for i in range(x.shape[1]):
        a, b, c = x[0, i], x[1, i], x[2, i]
        d, e, f = w[0, i], w[1, i], w[2, i]
        s = min(max(-(a * d + b * e + c * f) / (d * d + e * e + f * f + 1e-300), 0.0), 1.0)
        x[0, i], x[1, i], x[2, i] = a + s * d, b + s * e, c + s * f


@njit(types.void(*_HEAD, _S2, _S2, _F1, _F, _F, _N, _I1, _I1), **OPTIONS)
def levels(address, offset, follows, p, first, step, track, width, q, v, t0, t1, eta, deepest, substeps, order):
    """Powers of two of substeps (n,), so that no step exceeds eta times the shortest dynamical time in the block.

    The dynamical time is sqrt(distance / acceleration), about the Galactic centre for the fixed forces and about
    the progenitor for those that follow it, where the particle would come closest to each on a straight line.
    order (n,) sorts the particles by their number of substeps, 1 to 2^deepest, and is stable.
    """
    n = q.shape[1]
    flat_x, flat_w, flat_a = np.empty(3 * width), np.empty(3 * width), np.empty(3 * width)
    flat_t, flat_rate = np.empty(width), np.empty(width)
    begin_centre, end_centre = np.empty(3), np.empty(3)
    track_at(t1, first, step, track, end_centre)
    followers = False
    for c in range(address.shape[0]):
        followers = followers or follows[c]
    starts = np.zeros(deepest + 2, np.int64)
    for begin in range(0, n, width):
        m = min(width, n - begin)
        x, w, a = flat_x[: 3 * m].reshape(3, m), flat_w[: 3 * m].reshape(3, m), flat_a[: 3 * m].reshape(3, m)
        t, rate = flat_t[:m], flat_rate[:m]
        rate[:] = 0.0
        for turn in range(2 if followers else 1):
            for i in range(m):
                t[i] = t0[begin + i]
                if turn == 1 and (i == 0 or t[i] != t[i - 1]):
                    track_at(t[i], first, step, track, begin_centre)
                for k in range(3):
                    x[k, i] = q[k, begin + i]
                    w[k, i] = v[k, begin + i] * (t1 - t[i])
                    if turn == 1:
                        x[k, i] -= begin_centre[k]
                        w[k, i] -= end_centre[k] - begin_centre[k]
            closest_approach(x, w)
            a[:] = 0.0
            for c in range(address.shape[0]):
                if follows[c] == (turn == 1):
                    call_kernel(address[c], m, t, p[offset[c] :], x, a)
            for i in range(m):
                acceleration2 = a[0, i] ** 2 + a[1, i] ** 2 + a[2, i] ** 2
                distance2 = x[0, i] ** 2 + x[1, i] ** 2 + x[2, i] ** 2
                rate[i] = max(rate[i], acceleration2 / (distance2 + 1e-300))
        for i in range(m):
            wanted = (t1 - t[i]) * math.sqrt(math.sqrt(rate[i])) / eta
            steps, level = 1, 0
            while steps < wanted and level < deepest:
                steps *= 2
                level += 1
            substeps[begin + i] = steps
            starts[level + 1] += 1
    for level in range(deepest):
        starts[level + 1] += starts[level]
    for i in range(n):
        steps, level = substeps[i], 0
        while steps > 1:
            steps >>= 1
            level += 1
        order[starts[level]] = i
        starts[level] += 1


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


@njit(types.void(_I1, _I1, _B1, _F1, _F1, _F1, _F, _F, types.intp, _F1, _F1, _F2), **OPTIONS)
def carry(address, offset, follows, p, q0, v0, t0, step, substeps, drift, kick, out):
    """March one orbit in the fixed components, writing its states (T, 9) at t0 + k * step (step may be negative)."""
    count = out.shape[0]
    x, u, a, rel = np.empty((3, 1)), np.empty((3, 1)), np.empty((3, 1)), np.empty((3, 1))
    t, centre = np.empty(1), np.empty(3)
    track = np.empty((2, 9))
    h = step / substeps
    t[0] = t0
    for k in range(3):
        x[k, 0], u[k, 0] = q0[k], v0[k]
    for node in range(count):
        t[0] = t0 + node * step
        add_forces(address, offset, follows, p, 0.0, 1.0, track, True, t, x, rel, centre, a)
        for k in range(3):
            out[node, k], out[node, 3 + k], out[node, 6 + k] = x[k, 0], u[k, 0], a[k, 0]
        if node == count - 1:
            break
        for _ in range(substeps):
            for j in range(kick.shape[0]):
                t[0] += drift[j] * h
                for k in range(3):
                    x[k, 0] += drift[j] * h * u[k, 0]
                add_forces(address, offset, follows, p, 0.0, 1.0, track, True, t, x, rel, centre, a)
                for k in range(3):
                    u[k, 0] += kick[j] * h * a[k, 0]
            t[0] += drift[-1] * h
            for k in range(3):
                x[k, 0] += drift[-1] * h * u[k, 0]
