"""Sorting a batch of particles by the number of steps that each one's dynamical time asks for."""

from __future__ import annotations

from numba import njit

from streamkit.engine.cache import INLINE
from streamkit.engine.forces import BATCH, LANES, ROW, call_kernel, track_at


@njit(**INLINE)
def alike(t0, index, begin):
    """Number of particles from begin on that make a batch: of one time, or where only a few are, of any."""
    most = min(BATCH, index.shape[0] - begin)
    first, low, high = t0[index[begin]], 1, most
    if t0[index[begin + most - 1]] == first:
        return most
    while high - low > 1:  # the times never decrease: bisect
        middle = (low + high) // 2
        low, high = (middle, high) if t0[index[begin + middle - 1]] == first else (low, middle)
    return low if low > LANES else most


@njit(**INLINE)
def take(source, index, begin, m, out):
    """Copy the values of m particles into a row of a batch, padded to whole vectors with the last."""
    first = index[begin]
    if index[begin + m - 1] - first == m - 1:  # neighbours, as index increases: a vector copy
        out[:m] = source[first : first + m]
    else:
        for i in range(m):
            out[i] = source[index[begin + i]]
    for i in range(m, (m + LANES - 1) // LANES * LANES):
        out[i] = out[m - 1]


@njit(**INLINE)
def scatter(m, slot, row, out):
    """Copy the lanes of a row that have a slot into it."""
    for i in range(m):
        if slot[i] >= 0:
            out[slot[i]] = row[i]


@njit(**INLINE)
def give_back(m, slot, row, index, begin, out):
    """Copy the slots of a row back to their particles."""
    first = index[begin]
    if index[begin + m - 1] - first == m - 1:
        place = out[first : first + m]
        for i in range(m):
            if slot[i] >= 0:
                place[i] = row[slot[i]]
    else:
        for i in range(m):
            if slot[i] >= 0:
                out[index[begin + i]] = row[slot[i]]


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
def rates(
    address, offset, follows, p, first, step, track, eta, uniform, m, t, span, x, u, rel, w, a, centre, ahead, rate
):  # fmt: skip
    """Square of (acceleration / distance / eta^2) of m lanes during the time span after t, into rate.

    About the Galactic centre for the fixed forces, with eta[0], and about the progenitor for those that follow it,
    with eta[1] and its mass at first; whichever is larger, where the particle would come closest to each on a straight
    line.
    """
    rate[:m] = 0.0
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
            for i in range(m):
                rel_k[i] = x_k[i] - shift
                w_k[i] = u_k[i] * span[i] - motion
        if moving and not uniform:
            for i in range(m):
                track_at(t[i], first, step, track, centre)
                track_at(t[i] + span[i], first, step, track, ahead)
                for k in range(3):
                    j = k * ROW + i
                    rel[j] = x[j] - centre[k]
                    w[j] = u[j] * span[i] - (ahead[k] - centre[k])
        closest_approach(m, rel, w)
        for k in range(3):
            a[k * ROW : k * ROW + m] = 0.0
        for c in range(address.shape[0]):
            if follows[c] == moving:
                call_kernel(address[c], m, t, p[offset[c] :], rel, a)
        a0, a1, a2 = a[:m], a[ROW : ROW + m], a[2 * ROW : 2 * ROW + m]
        d0, d1, d2 = rel[:m], rel[ROW : ROW + m], rel[2 * ROW : 2 * ROW + m]
        scale = eta[turn] ** -4
        for i in range(m):
            acceleration2 = a0[i] * a0[i] + a1[i] * a1[i] + a2[i] * a2[i]
            distance2 = d0[i] * d0[i] + d1[i] * d1[i] + d2[i] * d2[i]
            rate[i] = max(rate[i], scale * acceleration2 / (distance2 + 1e-300))


@njit(**INLINE)
def choose(m, rate, span, deepest, level):
    """Level of m lanes: the power of two of steps so that none exceeds eta dynamical times, rate^(-1/4)."""
    for i in range(m):
        level[i] = 0
        rate[i] = span[i] ** 4 * rate[i]  # the fourth power of the number of steps
    bound = 1.0
    for _ in range(deepest):
        for i in range(m):
            level[i] += 1 if rate[i] > bound else 0
        bound *= 16.0


@njit(**INLINE)
def place(m, level, limit, start, size, slot):
    """Give each of m lanes up to the level limit a slot, grouped by level, stable, groups in multiples of LANES.

    start and size (limit + 1,) receive each level's first slot and its lanes; lanes of higher levels get slot -1.
    """
    size[:] = 0
    for i in range(m):
        size[level[i]] += 1
    place_at = 0
    for k in range(size.shape[0]):
        start[k] = place_at
        place_at += (size[k] + LANES - 1) // LANES * LANES
        size[k] = 0
    for i in range(m):
        k = level[i]
        slot[i] = start[k] + size[k] if k <= limit else -1
        size[k] += 1
