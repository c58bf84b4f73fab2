"""Centres that move in each other's field: the host and the bodies about it, in an inertial frame.

Each is a centre of forces and feels the forces of the others. The host may also slow a body down by Chandrasekhar's
dynamical friction. Friction depends on the velocity, so the method is the classical one of Runge and Kutta, of fourth
order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit, types

from streamkit.engine.cache import INLINE, cached, helper
from streamkit.engine.field import NO_DRAG_OF_BODIES, build_field
from streamkit.engine.forces import FORCES, ROW, call_kernel
from streamkit.engine.kernels import Force
from streamkit.engine.velocity_forces import DRAGGED, drag_centres
from streamkit.engine.views import fill
from streamkit.stream import Array, Orbit
from streamkit.units import G

# Largest motion of two centres in a step, in units of their distance or of sqrt(distance / acceleration).
FINEST = 0.03
PARTS = 100  # most steps between two nodes


class Friction(NamedTuple):
    """Density and velocity dispersion of the host, for the dynamical friction on a body.

    Attributes
    ----------
    table
        (T, K, 8) cubics in ln r, in units of the step, of r^2 times the density and of the squared dispersion: four
        coefficients each, at every one of the times.
    first, step
        ln r where the table begins, and of each piece.
    times
        (T,) increasing; linear between them, constant beyond. One for a host that does not change.
    """

    table: Array
    first: float
    step: float
    times: Array


NO_FRICTION = Friction(np.zeros((1, 0, 8)), 0.0, 1.0, np.zeros(1))

_F1, _F2, _F = types.float64[::1], types.float64[:, ::1], types.float64
_FRICTION = types.NamedTuple([types.float64[:, :, ::1], _F, _F, _F1], Friction)


@dataclass(frozen=True)
class Centre:
    """A body whose orbit is integrated.

    Attributes
    ----------
    force
        Its own field.
    q, v
        (3,) where it is at t = 0, from the host's centre.
    pulls_host
        Whether the host moves because of it.
    slowed_mass, extent
        The mass that the host slows down by friction, 0 for none, in Msun, and the body's scale length in kpc, 0 for a
        point mass.
    """

    force: Force
    q: Array
    v: Array
    pulls_host: bool = True
    slowed_mass: float = 0.0
    extent: float = 0.0


@njit(**INLINE)  # no `helper`: a separate function is rounded differently, and streams with drag would change
def friction_at(friction, t, d, speed, mass, extent):
    """Deceleration by the host at time t of a mass at distance d over its speed.

    Chandrasekhar's formula (Binney & Tremaine 2008, eq. 8.13), with ln(d / b)^(1/2) for the Coulomb logarithm and b
    twice the scale length, which follows N-body simulations best (Vasiliev, Belokurov & Erkal 2021, MNRAS 501, 2279);
    b = G M / v^2 for a point mass.
    """
    b = 2.0 * extent if extent > 0.0 else G * mass / (speed * speed)
    if not d > b:
        return 0.0
    since = (math.log(d) - friction.first) / friction.step
    i = min(max(int(since), 0), friction.table.shape[1] - 1)
    s = min(max(since - i, 0.0), 1.0)
    now, last, share = 0, friction.times.shape[0] - 1, 0.0
    if last > 0:
        while now < last - 1 and friction.times[now + 1] <= t:
            now += 1
        share = (t - friction.times[now]) / (friction.times[now + 1] - friction.times[now])
        share = min(max(share, 0.0), 1.0)
    density = dispersion2 = 0.0
    for k in range(now, min(now + 1, last) + 1):
        c, weight = friction.table[k, i], share if k > now else 1.0 - share
        density += weight * (c[0] + s * (c[1] + s * (c[2] + s * c[3])))
        dispersion2 += weight * (c[4] + s * (c[5] + s * (c[6] + s * c[7])))
    density = max(density, 0.0) / (d * d)
    x = speed / math.sqrt(2.0 * max(dispersion2, 1e-30))
    if x < 0.01:  # the difference below cancels
        slower = 4.0 / 3.0 / math.sqrt(math.pi) * x**3 * (1.0 - 0.6 * x * x)
    else:
        slower = math.erf(x) - 2.0 / math.sqrt(math.pi) * x * math.exp(-x * x)
    return 4.0 * math.pi * G * G * mass * density * math.sqrt(math.log(d / b)) * slower / max(speed, 1e-10) ** 3


@helper
def pull(forces, friction, traits, n, t, x, u, centre, a):
    """Store in a the accelerations of n centres at x with velocities u, rows ROW apart, the host in front.

    traits (n, 3) holds for each centre: 1 if it pulls the host, the mass that is slowed down, its scale length.
    """
    for j in range(n):
        for i in range(3):
            a[i * ROW + j] = 0.0
    for c in range(forces.address.shape[0]):
        k = forces.trajectory[c]
        for i in range(3):
            centre[i] = x[i * ROW + k]
        p, offset, first = forces.parameters, forces.offset[c], 0 if traits[k, 0] > 0.0 else 1
        for begin, end in ((first, k), (k + 1, n)):
            if end > begin:
                call_kernel(forces.address[c], begin, end - begin, t, p, offset, centre, x, a, 0)
    for j in range(1, n):
        if traits[j, 1] > 0.0:
            d2 = speed2 = 0.0
            for i in range(3):
                d2 += (x[i * ROW + j] - x[i * ROW]) ** 2
                speed2 += (u[i * ROW + j] - u[i * ROW]) ** 2
            rate = friction_at(friction, t[0], math.sqrt(d2), math.sqrt(speed2), traits[j, 1], traits[j, 2])
            for i in range(3):
                a[i * ROW + j] -= rate * (u[i * ROW + j] - u[i * ROW])
    drag_centres(forces, n, t, x, u, a, centre)


@njit(**INLINE)
def parts_of(n, x, u, a, step):
    """Number of steps to take in one of length ``step``, as `FINEST` asks for."""
    rate2 = 0.0
    for j in range(n):
        for k in range(j):
            d2 = speed2 = a2 = 0.0
            for i in range(3):
                d2 += (x[i * ROW + j] - x[i * ROW + k]) ** 2
                speed2 += (u[i * ROW + j] - u[i * ROW + k]) ** 2
                a2 += (a[i * ROW + j] - a[i * ROW + k]) ** 2
            rate2 = max(rate2, (speed2 + math.sqrt(a2 * d2)) / (d2 + 1e-300))
    parts = abs(step) * math.sqrt(rate2) / FINEST
    return int(parts) + 1 if parts < PARTS else PARTS


_FOLLOW = _FRICTION, _F2, _F2, _F, _F, types.float64[:, :, ::1]


@cached(types.void(FORCES, *_FOLLOW), types.void(DRAGGED, *_FOLLOW))
def follow(forces, friction, traits, today, t0, step, out):
    """Integrate n centres from today (n, 6) and write their states (n, T, 9) at t0 + k * step.

    The trajectory of a force is the number of its centre; traits as in `pull`.
    """
    n = today.shape[0]
    x, u, a, t = np.zeros(3 * ROW), np.zeros(3 * ROW), np.zeros(3 * ROW), np.empty(n)
    y, w, b, centre = np.zeros(3 * ROW), np.zeros(3 * ROW), np.zeros(3 * ROW), np.empty(3)
    dx, du = np.empty((3, n)), np.empty((3, n))
    for j in range(n):
        for i in range(3):
            x[i * ROW + j], u[i * ROW + j] = today[j, i], today[j, 3 + i]
    fill(t, 0, n, t0)
    pull(forces, friction, traits, n, t, x, u, centre, a)
    for node in range(out.shape[1]):
        for j in range(n):
            for i in range(3):
                row = i * ROW + j
                out[j, node, i], out[j, node, 3 + i], out[j, node, 6 + i] = x[row], u[row], a[row]
        if node == out.shape[1] - 1:
            break  # no force is evaluated beyond the last state
        parts = parts_of(n, x, u, a, step)
        h = step / parts
        for part in range(parts):
            begin = t0 + node * step + part * h
            dx[:], du[:] = 0.0, 0.0
            for stage in range(4):
                ahead = 0.0 if stage == 0 else h if stage == 3 else 0.5 * h
                weight = h / 3.0 if stage == 1 or stage == 2 else h / 6.0
                for j in range(n):
                    for i in range(3):
                        row = i * ROW + j
                        before, faster = w[row], b[row]  # velocity and acceleration of the stage before
                        y[row] = x[row] + ahead * before if stage > 0 else x[row]
                        w[row] = u[row] + ahead * faster if stage > 0 else u[row]
                fill(t, 0, n, begin + ahead)
                if stage == 0:
                    for i in range(3):
                        for j in range(n):
                            b[i * ROW + j] = a[i * ROW + j]
                else:
                    pull(forces, friction, traits, n, t, y, w, centre, b)
                for j in range(n):
                    for i in range(3):
                        dx[i, j] += weight * w[i * ROW + j]
                        du[i, j] += weight * b[i * ROW + j]
            for j in range(n):
                for i in range(3):
                    x[i * ROW + j] += dx[i, j]
                    u[i * ROW + j] += du[i, j]
            pull(forces, friction, traits, n, t, x, u, centre, a)


def follow_bodies(
    host: Sequence[Force], bodies: Sequence[Centre], friction: Friction, t1: float, max_step: float
) -> tuple[Orbit, list[Orbit]]:
    """Follow the host and the bodies from today to t1, with nodes at most ``max_step`` apart.

    Returns the host's orbit in the inertial frame in which it rests at the origin today, and those of the bodies
    as seen from it. Raises ValueError for a body whose own force depends on velocity.
    """
    if any(body.force.has_drag() for body in bodies):
        raise ValueError(NO_DRAG_OF_BODIES)
    field = build_field([*host, *(body.force for body in bodies)])
    owner = np.concatenate([np.zeros(len(host)), 1 + np.arange(len(bodies))]).astype(np.int64)
    today = np.array([np.zeros(6), *(np.concatenate([body.q, body.v]) for body in bodies)])
    traits = np.array([(0, 0, 0), *((body.pulls_host, body.slowed_mass, body.extent) for body in bodies)], dtype=float)
    count = max(int(np.ceil(abs(t1) / max_step)), 2)
    step = t1 / count
    out = np.empty((len(today), count + 1, 9))
    follow(field.all_forces._replace(trajectory=owner), friction, traits, today, 0.0, step, out)
    field.check()
    t: Array = step * np.arange(count + 1, dtype=float)
    t[-1] = t1
    out[1:] -= out[0]
    if step < 0:
        t, out = np.ascontiguousarray(t[::-1]), out[:, ::-1]
    nowhere = np.full(count + 1, np.nan)
    states = [np.ascontiguousarray(path.T) for path in out]
    orbits = [Orbit(t, s[:3], s[3:6], s[6:], nowhere) for s in states]
    return orbits[0], orbits[1:]
