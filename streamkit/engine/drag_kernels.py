"""One C function from the elementwise `drag`s of all components: the mean acceleration over a kick.

The function has the form of the kernels of forces (see `streamkit.engine.kernels`), but ``q`` holds whole lanes,
``centre[0]`` is the length of the kick in time steps, and ``a`` holds the forces that do not depend on velocity.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
from numba import carray, njit

from streamkit.engine.arguments import ENDLESS, layout_of, pack, unpacker
from streamkit.engine.axes import turned_drag
from streamkit.engine.cache import OPTIONS, UNCALLED
from streamkit.engine.changing import arguments_at, compiled_arguments, numbers_of, tables_of
from streamkit.engine.forces import ROW
from streamkit.engine.kernels import Force, NumpyKernel, machine_code
from streamkit.engine.velocity_forces import LANES_ROWS
from streamkit.stream import Array, from_axes, to_axes

# A component, the dimensions of what its `drag` gets after t, which of these change, and whether its axes are turned,
# as in `compiled_kernel`.
Part = tuple[type[Force], tuple[int, ...], tuple[int, ...], bool]


def drag_kernel(forces: Sequence[Force]) -> tuple[Any, Array]:
    """Return the kernel of the forces' drags together, and its packed parameters.

    The kernel runs in NumPy if one of the forces is not compiled. Raises `PluginError` if numba cannot compile an
    author's function.
    """
    if not all(force.compiled for force in forces):
        return NumpyDrag(forces), np.zeros(1)
    parts, packed = [], []
    for force in forces:
        rotation, changes = force.rotation(), force.changes()
        values = force.in_engine_units() + (rotation or ()) + tables_of(changes)
        parts.append((type(force), layout_of(values), numbers_of(changes), rotation is not None))
        packed.append(pack(values))
    begins = np.cumsum([len(forces), *map(len, packed)])[:-1].astype(float)
    return compiled_drag(tuple(parts)), np.concatenate([begins, *packed, np.zeros(1)])


@cache
def compiled_drag(parts: tuple[Part, ...]) -> Any:
    """Return the machine code for a combination of components; compiled once per process."""
    inlined = njit(forceinline=True, **UNCALLED, **OPTIONS)
    total = inlined(lambda x, y, z, u, v, w, t, p: (0.0, 0.0, 0.0))
    for number, (cls, layout, changing, turning) in enumerate(parts):
        drag = turned_drag(cls.drag) if turning else cls.drag
        now = compiled_arguments(len(layout) - len(changing), changing) if changing else None
        total = _with(total, inlined(drag), unpacker(layout), now, number)

    @inlined
    def mean(x, y, z, u, v, w, t, h, p, ax, ay, az):
        a0, b0, c0 = total(x, y, z, u, v, w, t, p)
        a0, b0, c0 = ax + a0, ay + b0, az + c0
        a1, b1, c1 = total(x, y, z, u + 0.5 * h * a0, v + 0.5 * h * b0, w + 0.5 * h * c0, t, p)
        a1, b1, c1 = ax + a1, ay + b1, az + c1
        a2, b2, c2 = total(x, y, z, u + 0.5 * h * a1, v + 0.5 * h * b1, w + 0.5 * h * c1, t, p)
        a2, b2, c2 = ax + a2, ay + b2, az + c2
        a3, b3, c3 = total(x, y, z, u + h * a2, v + h * b2, w + h * c2, t, p)
        a3, b3, c3 = ax + a3, ay + b3, az + c3
        return (a0 + 2 * (a1 + a2) + a3) / 6, (b0 + 2 * (b1 + b2) + b3) / 6, (c0 + 2 * (c1 + c2) + c3) / 6

    def kernel(n, t, p, centre, q, a, fresh):
        packed, lanes = carray(p, (ENDLESS,)), carray(q, (LANES_ROWS * ROW,))
        part, out = carray(centre, (3,))[0], carray(a, (3 * ROW,))
        if part == 0.0:  # two loops: a branch inside one would prevent its vectorisation
            for i in range(n):
                dx, dy, dz = total(
                    lanes[i], lanes[ROW + i], lanes[2 * ROW + i],
                    lanes[3 * ROW + i], lanes[4 * ROW + i], lanes[5 * ROW + i], lanes[6 * ROW + i], packed,
                )  # fmt: skip
                out[i], out[ROW + i], out[2 * ROW + i] = out[i] + dx, out[ROW + i] + dy, out[2 * ROW + i] + dz
            return
        for i in range(n):
            out[i], out[ROW + i], out[2 * ROW + i] = mean(
                lanes[i], lanes[ROW + i], lanes[2 * ROW + i],
                lanes[3 * ROW + i], lanes[4 * ROW + i], lanes[5 * ROW + i],
                lanes[6 * ROW + i], part * lanes[7 * ROW + i], packed,
                out[i], out[ROW + i], out[2 * ROW + i],
            )  # fmt: skip

    return machine_code(
        kernel, [(cls, cls.drag) for cls, *_ in parts], [(layout, *changes) for _, layout, *changes in parts]
    )


def _with(before: Any, drag: Any, unpack: Any, now: tuple[Any, Any] | None, number: int) -> Any:
    """Add the drag of the component with this number to those of the components before it."""
    inlined = njit(forceinline=True, **UNCALLED, **OPTIONS)

    def total(x, y, z, u, v, w, t, p):
        ax, ay, az = before(x, y, z, u, v, w, t, p)
        bx, by, bz = drag(x, y, z, u, v, w, t, *unpack(p[int(p[number]) :]))
        return ax + bx, ay + by, az + bz

    if now is None:
        return inlined(total)
    arguments, factor = now

    def changing_total(x, y, z, u, v, w, t, p):
        ax, ay, az = before(x, y, z, u, v, w, t, p)
        packed = unpack(p[int(p[number]) :])
        bx, by, bz = drag(x, y, z, u, v, w, t, *arguments(t, packed))
        k = factor(t, packed)
        return ax + k * bx, ay + k * by, az + k * bz

    return inlined(changing_total)


class NumpyDrag(NumpyKernel):
    """The drags of all components in Python, called once per batch and stage, if one component is not compiled."""

    def __init__(self, forces: Sequence[Force]) -> None:
        super().__init__(forces[0])
        self._parts = [(f.drag, f.in_engine_units(), f.changes(), f.rotation()) for f in forces]

    def _fill(self, q: Callable[[int], Array], times: Array, about: list[float], total: Array, fresh: int) -> None:
        lanes = q(LANES_ROWS)
        x, v, now, h = lanes[:3], lanes[3:6], lanes[6], about[0] * lanes[7]
        gravity = total.copy()
        a0 = gravity + self._drag(x, v, now)
        if about[0] == 0.0:
            total[:] = a0
            return
        a1 = gravity + self._drag(x, v + 0.5 * h * a0, now)
        a2 = gravity + self._drag(x, v + 0.5 * h * a1, now)
        a3 = gravity + self._drag(x, v + h * a2, now)
        total[:] = (a0 + 2 * (a1 + a2) + a3) / 6

    def _drag(self, x: Array, v: Array, t: Array) -> Array:
        total = np.zeros_like(v)
        for drag, arguments, changes, rotation in self._parts:
            now, factor = arguments_at(t, arguments, changes) if changes else (arguments, 1.0)
            if rotation is None:
                part = np.stack(np.broadcast_arrays(*drag(*x, *v, t, *now)))
            else:
                place, motion = to_axes(rotation, *x), to_axes(rotation, *v)
                part = np.stack(from_axes(rotation, *np.broadcast_arrays(*drag(*place, *motion, t, *now))))
            total += factor * part
        return total
