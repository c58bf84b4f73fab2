"""Patches that change in time: the patches of a cell are made once for all particles in it at one time.

The table holds slices, of which `SLICES` with weights are the table of one time, and a slice holds the points of cubic
B-splines in the first coordinate f, so that it is a quarter as large as the patches that it stands for.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import carray, njit, types
from numba.extending import intrinsic

from streamkit.engine.cache import OPTIONS, UNCALLED

SLICES = 4
SIDE = 4  # particles that are read together, and points of a cubic


def making_patches(count: int, read: Any, at_time: Any) -> Any:
    """Return a function that makes the ``count`` patches of four particles, and reads them by ``read``.

    ``at_time(t, table)`` is `Patches.at_time`. The patches of each of the four are kept for the particle four further
    on: often it is in the same cell at the same time.
    """
    row, size = 4 * count, 16 * count

    @njit(forceinline=True, **UNCALLED, **OPTIONS)
    def make_and_read(table, located, i, values, times, n, room):
        numbers, cells = carray(located, (i + SIDE,)), carray(room, (SIDE * (size + 2),))
        for lane in range(SIDE):
            cell, t, held = numbers[i + lane], times[min(i + lane, n - 1)], SIDE * size + 2 * lane
            numbers[i + lane] = lane * size
            if cell == cells[held] and t == cells[held + 1]:
                continue
            cells[held], cells[held + 1] = cell, t
            first, length, further, w0, w1, w2, w3 = at_time(t, table)
            out, next_row = np.uint64(lane * size), np.uint64(further)
            a = np.uint64(first) + np.uint64(cell)
            b, c, d = a + np.uint64(length), a + np.uint64(2 * length), a + np.uint64(3 * length)
            for k in range(np.uint64(row)):
                m = k + np.uint64(0)
                p = w0 * table[a + m] + w1 * table[b + m] + w2 * table[c + m] + w3 * table[d + m]
                m += next_row
                q = w0 * table[a + m] + w1 * table[b + m] + w2 * table[c + m] + w3 * table[d + m]
                m += next_row
                r = w0 * table[a + m] + w1 * table[b + m] + w2 * table[c + m] + w3 * table[d + m]
                m += next_row
                s = w0 * table[a + m] + w1 * table[b + m] + w2 * table[c + m] + w3 * table[d + m]
                cells[out + k] = (p + 4.0 * q + r) * (1.0 / 6.0)
                cells[out + k + np.uint64(row)] = 0.5 * (r - p)
                cells[out + k + np.uint64(2 * row)] = 0.5 * (p + r) - q
                cells[out + k + np.uint64(3 * row)] = (s - p) * (1.0 / 6.0) + 0.5 * (q - r)
        read(cells, located, i, values)

    return make_and_read


def cells_room(count: int) -> Any:
    """Return a function that allocates the cells of four particles on the stack, with none made."""
    size = 16 * count

    @intrinsic
    def room(typing_context):  # no function around it: the space would end with that function
        def codegen(context, builder, signature, args):
            with builder.goto_entry_block():
                place = builder.alloca(ir.ArrayType(ir.DoubleType(), SIDE * (size + 2)))
            place.align = 64
            cells, none = builder.bitcast(place, ir.DoubleType().as_pointer()), ir.Constant(ir.DoubleType(), -1.0)
            for lane in range(SIDE):
                builder.store(none, builder.gep(cells, [ir.Constant(ir.IntType(64), SIDE * size + 2 * lane)]))
            return cells

        return types.CPointer(types.float64)(), codegen

    return room


@njit(forceinline=True, **UNCALLED, **OPTIONS)
def no_room():
    """Return nothing, for patches that do not change."""
    return 0
