"""Sorting a batch of particles by the number of steps that their dynamical times need."""

from __future__ import annotations

from numba import njit

from streamkit.engine.cache import INLINE, helper
from streamkit.engine.forces import BATCH, LANES, ROW, call_kernel, centre_at
from streamkit.engine.steps import ROWS, A, H, T, V
from streamkit.engine.views import axes_view, fill, rest, view

CROSSING = 1.25  # longest step near a disc's plane, in units of the time in which its height is crossed
NEAR_PLANE = 2.0  # largest distance from a disc's plane that counts as near, in units of that height


@njit(**INLINE)
def next_batch(t0, index, begin):
    """Number of particles from begin on that make a batch: those of one time, or of any times if these are few."""
    most = min(BATCH, index.shape[0] - begin)
    first, low, high = t0[index[begin]], 1, most
    if t0[index[begin + most - 1]] == first:
        return most
    while high - low > 1:  # the times never decrease: bisect
        middle = (low + high) // 2
        low, high = (middle, high) if t0[index[begin + middle - 1]] == first else (low, middle)
    return low if low > LANES else most


@helper
def gather(source, index, begin, m, out):
    """Copy the values of m particles into a row of a batch, padded to whole vectors with the last."""
    first = index[begin]
    if index[begin + m - 1] - first == m - 1:  # neighbours, as index increases: a vector copy
        near = view(source, first, first + m)
        for i in range(m):  # to assign a slice compiles an error message, for longer than all the rest
            out[i] = near[i]
    else:
        for i in range(m):
            out[i] = source[index[begin + i]]
    for i in range(m, (m + LANES - 1) // LANES * LANES):
        out[i] = out[m - 1]


@helper
def scatter(m, slot, lanes, slots):
    """Copy each of m lanes that has a slot into it."""
    for i in range(m):
        j = slot[i]
        if j >= 0:
            for k in range(ROWS):
                slots[k * ROW + j] = lanes[k * ROW + i]


@helper
def give_back(m, slot, row, index, begin, out):
    """Copy the slots of a row back to their particles."""
    first = index[begin]
    if index[begin + m - 1] - first == m - 1:
        place = view(out, first, first + m)
        for i in range(m):
            if slot[i] >= 0:
                place[i] = row[slot[i]]
    else:
        for i in range(m):
            if slot[i] >= 0:
                out[index[begin + i]] = row[slot[i]]


@helper
def nearest(begin, end, lanes, path, closest):
    """Store in `closest` where lanes [begin, end) come closest to a moving centre, as offsets from it.

    A particle's path is the parabola of its initial acceleration, approximated by two straight pieces. path (9,) holds
    the centre at the beginning, the middle and the end of the time span.
    """
    x, u, span, a = lanes, rest(lanes, V), rest(lanes, H), rest(lanes, A)
    c0, c1, c2, d0, d1, d2 = path[0], path[1], path[2], path[3], path[4], path[5]
    e0, e1, e2 = path[6], path[7], path[8]
    x0, x1, x2 = axes_view(x, begin, end, ROW)
    u0, u1, u2 = axes_view(u, begin, end, ROW)
    a0, a1, a2 = axes_view(a, begin, end, ROW)
    n0, n1, n2 = axes_view(closest, begin, end, ROW)
    h = view(span, begin, end)
    for i in range(h.shape[0]):
        s, r = 0.5 * h[i], 0.125 * h[i] * h[i]
        w0, w1, w2 = s * u0[i], s * u1[i], s * u2[i]
        b0, b1, b2 = r * a0[i], r * a1[i], r * a2[i]
        f0, f1, f2 = x0[i] - c0, x1[i] - c1, x2[i] - c2  # at the beginning, the middle and the end
        m0, m1, m2 = x0[i] + w0 + b0 - d0, x1[i] + w1 + b1 - d1, x2[i] + w2 + b2 - d2
        l0, l1, l2 = (
            x0[i] + 2.0 * w0 + 4.0 * b0 - e0,
            x1[i] + 2.0 * w1 + 4.0 * b1 - e1,
            x2[i] + 2.0 * w2 + 4.0 * b2 - e2,
        )
        f0, f1, f2, first = foot(f0, f1, f2, m0, m1, m2)
        l0, l1, l2, last = foot(l0, l1, l2, m0, m1, m2)
        n0[i] = f0 if first < last else l0
        n1[i] = f1 if first < last else l1
        n2[i] = f2 if first < last else l2


@njit(**INLINE)
def foot(a, b, c, d, e, f):
    """Point of the straight piece from (a, b, c) to (d, e, f) that is closest to zero, and its distance squared."""
    d, e, f = d - a, e - b, f - c
    s = min(max(-(a * d + b * e + c * f) / (d * d + e * e + f * f + 1e-300), 0.0), 1.0)
    a, b, c = a + s * d, b + s * e, c + s * f
    return a, b, c, a * a + b * b + c * c


@helper
def approach(forces, b, begin, end, lanes, closest, centre, path):
    """Store in `closest` and in path (9,) what `nearest` does, for trajectory b and lanes [begin, end) of one time."""
    follow(forces, b, lanes[T + begin], lanes[H + begin], centre, path)
    nearest(begin, end, lanes, path, closest)


@helper
def follow(forces, b, t, duration, centre, path):
    """Store in path (9,) where trajectory b is at a time, half a duration later, and a whole one later."""
    for k in range(3):
        centre_at(forces, b, t + 0.5 * k * duration, centre)
        path[3 * k], path[3 * k + 1], path[3 * k + 2] = centre[0], centre[1], centre[2]


@helper
def rates(forces, eta, heights, uniform, m, lanes, closest, a, centre, path, rate):
    """Store in `rate` the square of (acceleration / distance / eta^2) of m lanes in their time span.

    It is the largest of these levels: about the Galactic centre, with eta[0], and about each trajectory, for the forces
    that move on it with their initial mass, with eta[1]. Each level is computed where the particle, with its initial
    acceleration, comes closest. The host's force there is not evaluated: it is the initial force times the inverse
    square of the distances, which no spherical host exceeds. If the host has a disc of these `heights`, see
    `crossings`.
    """
    address, trajectory, t = forces.address, forces.trajectory, rest(lanes, T)
    fill(rate, 0, m, 0.0)
    fixed = False
    for c in range(address.shape[0]):
        fixed = fixed or trajectory[c] < 0
    if fixed:
        fill(path, 0, 9, 0.0)
        nearest(0, m, lanes, path, closest)
        a0, a1, a2 = axes_view(lanes, A, A + m, ROW)
        d0, d1, d2 = axes_view(closest, 0, m, ROW)
        x0, x1, x2 = axes_view(lanes, 0, m, ROW)
        scale = eta[0] ** -4
        for i in range(m):
            acceleration2 = a0[i] * a0[i] + a1[i] * a1[i] + a2[i] * a2[i]
            distance2 = d0[i] * d0[i] + d1[i] * d1[i] + d2[i] * d2[i] + 1e-300
            now2 = x0[i] * x0[i] + x1[i] * x1[i] + x2[i] * x2[i]
            rate[i] = scale * acceleration2 * now2 * now2 / (distance2 * distance2 * distance2)
    if heights.shape[0] > 0:
        crossings(heights, m, lanes, rate)
    for b in range(forces.tracks.shape[0]):
        together = m if uniform else 1
        for i in range(0, m, together):
            approach(forces, b, i, i + together, lanes, closest, centre, path)
        fill(centre, 0, 3, 0.0)
        fresh = 1
        for c in range(address.shape[0]):
            if trajectory[c] == b:
                call_kernel(address[c], 0, m, t, forces.parameters, forces.offset[c], centre, closest, a, fresh)
                fresh = 0
        a0, a1, a2 = axes_view(a, 0, m, ROW)
        d0, d1, d2 = axes_view(closest, 0, m, ROW)
        scale = eta[1] ** -4
        for i in range(m):
            acceleration2 = a0[i] * a0[i] + a1[i] * a1[i] + a2[i] * a2[i]
            distance2 = d0[i] * d0[i] + d1[i] * d1[i] + d2[i] * d2[i]
            rate[i] = max(rate[i], scale * acceleration2 / (distance2 + 1e-300))


@helper
def crossings(heights, m, lanes, rate):
    """Raise the `rate` of those of m lanes that come near the plane of the host's disc in their time span.

    A crossing takes heights / v_z, and no step may be longer than that times CROSSING. Paths are parabolas of the
    initial acceleration; the bend of a path in z serves as the error of its position.
    """
    x, u, span, a = lanes, rest(lanes, V), rest(lanes, H), rest(lanes, A)
    for i in range(m):
        s, r = 0.5 * span[i], 0.125 * span[i] * span[i]
        z = x[2 * ROW + i]
        step, bend = s * u[2 * ROW + i], 2.0 * r * a[2 * ROW + i]
        middle, end = z + step + 0.5 * bend, z + 2.0 * (step + bend)
        x1, y1 = x[i] + s * u[i] + r * a[i], x[ROW + i] + s * u[ROW + i] + r * a[ROW + i]
        x2, y2 = x[i] + 2.0 * s * u[i] + 4.0 * r * a[i], x[ROW + i] + 2.0 * s * u[ROW + i] + 4.0 * r * a[ROW + i]
        radius2 = min(x[i] * x[i] + x[ROW + i] * x[ROW + i], x1 * x1 + y1 * y1, x2 * x2 + y2 * y2)
        k = 0
        while k < heights.shape[0] - 1 and radius2 >= 4.0:
            radius2 *= 0.25
            k += 1
        height = heights[k]
        least = 0.0 if z * middle <= 0.0 or middle * end <= 0.0 else min(abs(z), abs(middle), abs(end))
        if least < NEAR_PLANE * height + abs(bend):
            fastest = max(abs(middle - z), abs(end - middle)) / (s + 1e-300)
            rate[i] = max(rate[i], (fastest / (CROSSING * height)) ** 4)


@helper
def choose_levels(m, rate, span, deepest, level, size):
    """Level of m lanes: the power of two of half steps so that no step exceeds eta dynamical times, rate^(-1/4).

    On entry all levels are zero and size (levels,), the number of lanes of each level, is m, 0, 0 ...
    """
    for i in range(m):
        rate[i] = span[i] ** 4 * rate[i]  # the fourth power of the number of steps
    bound = 0.5**4
    for k in range(deepest):
        more = 0
        for i in range(m):
            above = 1 if rate[i] > bound else 0
            level[i] += above
            more += above
        size[k] -= more
        size[k + 1] = more
        if more == 0:
            break
        bound *= 16.0


@helper
def assign_slots(m, level, limit, start, size, slot):
    """Give each of m lanes up to the level limit a slot, grouped by level, stable, groups in multiples of LANES.

    start (levels,) receives each level's first slot, from its lanes in size; lanes of higher levels get slot -1.
    """
    place_at = 0
    for k in range(size.shape[0]):
        start[k] = place_at
        place_at += (size[k] + LANES - 1) // LANES * LANES
    for i in range(m):
        k = level[i]
        slot[i] = start[k] if k <= limit else -1
        start[k] += 1
    for k in range(size.shape[0]):
        start[k] -= size[k]
