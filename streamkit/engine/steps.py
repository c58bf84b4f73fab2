"""The compiled steps over lanes: `compose` for any method of `streamkit.engine.methods`, `nystrom` for Nystrom's.

Lanes are rows of ROW doubles, one particle to a column: see the head of `streamkit.engine.loops`.
"""

from __future__ import annotations

from typing import NamedTuple

from numba import types

from streamkit.engine.cache import helper
from streamkit.engine.forces import ROW, add_forces
from streamkit.engine.velocity_forces import add_drag
from streamkit.engine.views import rest, view
from streamkit.stream import Array

# First element of the velocities, times, time steps and accelerations in an array of lanes; positions begin at 0.
V, T, H, A = 3 * ROW, 6 * ROW, 7 * ROW, 8 * ROW
ROWS = 11


class Method(NamedTuple):
    """A method and its step: drift (s + 1,) and kick (s,) of `Splitting`; eta (2,) and most as in `loops.advance`.

    heights are those of the host's disc (`streamkit.engine.discs`), empty if it has none.
    """

    drift: Array
    kick: Array
    eta: Array
    most: int
    heights: Array


_F1 = types.float64[::1]
METHOD = types.NamedTuple([_F1, _F1, _F1, types.intp, _F1], Method)


@helper
def compose(forces, method, uniform, begin, end, steps, has_acceleration, lanes, relative, centre):
    """Take steps of drifts and kicks, in place, for lanes [begin, end), each with its own time step.

    With `has_acceleration` the lanes already hold the initial acceleration. `relative` and centre are scratch of
    `add_forces`. With forces that depend on velocity a kick is the flow of the velocity alone, so that the method keeps
    its order; the lanes then do not hold the acceleration of the next step at the end.
    """
    x, u, t, h, a = lanes, rest(lanes, V), rest(lanes, T), rest(lanes, H), rest(lanes, A)
    drift, kick = method.drift, method.kick
    stages = kick.shape[0]
    reuse = drift[0] == 0.0 and drift[stages] == 0.0
    if not reuse:
        for i in range(begin, end):
            t[i] += drift[0] * h[i]
            for k in range(3):
                x[k * ROW + i] += drift[0] * h[i] * u[k * ROW + i]
    for s in range(steps):
        for j in range(stages):
            if j > 0 or not reuse or (s == 0 and not has_acceleration):
                add_forces(forces, uniform, begin, end, t, x, relative, centre, a)
            c, d = drift[j + 1], kick[j]
            if j == stages - 1 and s < steps - 1:
                c += drift[0]
                d += kick[0] if reuse else 0.0  # the next step begins with this same force
            if reuse and j == 0 and s > 0:
                d = 0.0
            if d != 0.0:
                add_drag(forces, d, begin, end, lanes, a, centre)
            h_i, t_i = view(h, begin, end), view(t, begin, end)
            for k in range(3):
                low, high = k * ROW + begin, k * ROW + end
                x_i, u_i, a_i = view(x, low, high), view(u, low, high), view(a, low, high)
                for i in range(x_i.shape[0]):
                    y = u_i[i] + d * h_i[i] * a_i[i]
                    u_i[i] = y
                    x_i[i] += c * h_i[i] * y
            for i in range(t_i.shape[0]):
                t_i[i] += c * h_i[i]


# From each stage of Nystrom's method to the time of the next, in units of its step.
AHEAD = 0.2, 2 / 3 - 0.2, 1 / 3, 0.0


@helper
def nystrom(forces, uniform, begin, end, steps, lanes, spare, relative, centre):
    """Take steps of Nystrom's fifth-order method for lanes [begin, end), which already hold the initial acceleration.

    Hairer, Norsett & Wanner 1993, Solving Ordinary Differential Equations I, table II.14.2. A step needs
    four forces; the choice of the step has computed the first one of the first step. `spare` (other lanes), `relative`
    and centre are scratch.
    """
    x, u, t, h, k1 = lanes, rest(lanes, V), rest(lanes, T), rest(lanes, H), rest(lanes, A)
    y, k2, k3 = spare, rest(spare, V), rest(spare, A)
    for s in range(steps):
        t_i, h_i = view(t, begin, end), view(h, begin, end)
        for stage in range(4):  # one inlined call for all stages: four would take long to compile
            if stage > 0 or s > 0:
                place = x if stage == 0 else y
                out = k1 if stage == 0 else k3 if stage == 2 else k2
                add_forces(forces, uniform, begin, end, t, place, relative, centre, out)
            for k in range(3):
                low, high = k * ROW + begin, k * ROW + end
                x_i, u_i, y_i = view(x, low, high), view(u, low, high), view(y, low, high)
                a, b, c = view(k1, low, high), view(k2, low, high), view(k3, low, high)
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
