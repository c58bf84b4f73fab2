"""Forces from bicubic patches of a table, which are read particle by particle and computed in lanes of particles.

Each lane reads another cell, whose coefficients would have to be gathered one by one. A patch, however, is contiguous:
for four particles at a time its rows of four numbers are loaded as vectors, evaluated in the first coordinate and
transposed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from streamkit.engine.axes import compiled_from_axes, compiled_to_axes
from streamkit.engine.cache import OPTIONS, UNCALLED
from streamkit.engine.forces import ROW
from streamkit.engine.slices import SIDE, cells_room, making_patches, no_room

BLOCK = 32  # particles whose patches are read before the arithmetic continues with them
LOCATED = 7  # numbers that `Patches.locate` returns

_POINTER = types.CPointer(types.float64)


class Patches(NamedTuple):
    """A force from the patches of a table, which is its only parameter.

    Attributes
    ----------
    number
        Number of patches in a cell, which are contiguous: coefficients (4 powers of f, number, 4 powers of g).
    locate
        ``locate(x, y, z, table)`` returns `LOCATED` numbers, of which the first is the index of the cell's first
        coefficient and the second the place f in it.
    finish
        ``finish(x, y, z, located, values, table)`` returns the force. ``values`` (8 number,) holds, for each patch,
        the four coefficients of powers of g at f, and of their derivative with respect to f.
    at_time
        None unless they change in time. The index is then that of the cell's first point in a slice (`slices`), and
        ``at_time(t, table)`` returns the index of the first of `SLICES` slices, the distances between them and between
        points that follow each other in f, and the weights.
    """

    number: int
    locate: Any
    finish: Any
    at_time: Any = None


def sweep_of(patches: Patches, turning: bool) -> Any:
    """Return the loop of a kernel over particles, with the arguments of `kernels.compiled_kernel`'s."""
    turn, back = (compiled_to_axes, compiled_from_axes) if turning else (_as_it_is, _as_it_is)
    locate, finish = patches.locate, patches.finish
    count, at_time = patches.number, patches.at_time
    located_room, read_room, located_at = _room(LOCATED), _room(2 * SIDE * count), _getter(LOCATED)
    values_at, reader = _getter(2 * SIDE * count), _reader(count)
    read = making_patches(count, reader, at_time) if at_time else _reading(reader)
    room = cells_room(count) if at_time else no_room

    @njit(forceinline=True, **UNCALLED, **OPTIONS)
    def sweep(begin, end, times, place, total, c, fresh, parameters, factor):
        x, y, z = c[0], c[1], c[2]
        table, rotation = parameters[0], parameters[1:]
        located, values, cells = located_room(), read_room(), room()
        for first in range(begin, end, BLOCK):
            n = min(BLOCK, end - first)
            for i in range(n):
                dx, dy, dz = _three(place, first + i)
                u, v, w = turn(rotation, dx - x, dy - y, dz - z)
                _put(located, i, locate(u, v, w, table))
            for i in range(n, (n + SIDE - 1) // SIDE * SIDE):
                _put(located, i, located_at(located, 0))
            for i in range(0, n, SIDE):
                read(table, located, i, values, times[first:], n, cells)
            for i in range(n):
                dx, dy, dz = _three(place, first + i)
                u, v, w = turn(rotation, dx - x, dy - y, dz - z)
                force = finish(u, v, w, located_at(located, i), values_at(values, i), table)
                fx, fy, fz = back(rotation, force[0], force[1], force[2])
                ax, ay, az = factor * fx, factor * fy, factor * fz
                if not fresh:
                    bx, by, bz = _three(total, first + i)
                    ax, ay, az = ax + bx, ay + by, az + bz
                _set_three(total, first + i, (ax, ay, az))

    return sweep


@njit(forceinline=True, **UNCALLED, **OPTIONS)
def _as_it_is(rotation, x, y, z):
    return x, y, z


def _room(count: int) -> Any:
    """Return a function that allocates ``count`` numbers for each particle of a block on the stack."""

    @intrinsic
    def room(typing_context):
        def codegen(context, builder, signature, args):
            with builder.goto_entry_block():
                place = builder.alloca(ir.ArrayType(ir.DoubleType(), count * BLOCK))
            place.align = 64
            return builder.bitcast(place, ir.DoubleType().as_pointer())

        return _POINTER(), codegen

    return room


@intrinsic
def _put(typing_context, room, i, numbers):
    """Store the numbers of particle i, those of one kind together."""

    def codegen(context, builder, signature, args):
        for k, number in enumerate(cgutils.unpack_tuple(builder, args[2])):
            builder.store(number, _element(builder, args[0], args[1], k))
        return context.get_dummy_value()

    return types.void(room, types.intp, numbers), codegen


def _getter(count: int) -> Any:
    """Return a function that returns the numbers of particle i."""

    @intrinsic
    def numbers_at(typing_context, room, i):
        numbers = types.UniTuple(types.float64, count)

        def codegen(context, builder, signature, args):
            loads = [builder.load(_element(builder, args[0], args[1], k)) for k in range(count)]
            return context.make_tuple(builder, numbers, loads)

        return numbers(room, types.intp), codegen

    return numbers_at


@intrinsic
def _three(typing_context, rows, i):
    """Return the three numbers of lane i. An index into an array would check the length of the array."""

    def codegen(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        return context.make_tuple(
            builder, signature.return_type, [builder.load(p) for p in _lane(builder, data, args[1])]
        )

    return types.UniTuple(types.float64, 3)(rows, types.intp), codegen


@intrinsic
def _set_three(typing_context, rows, i, numbers):
    """Store the three numbers of lane i."""

    def codegen(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        for number, place in zip(cgutils.unpack_tuple(builder, args[2]), _lane(builder, data, args[1]), strict=True):
            builder.store(number, place)
        return context.get_dummy_value()

    return types.void(rows, types.intp, numbers), codegen


def _lane(builder, data, i):
    return [builder.gep(data, [builder.add(i, ir.Constant(ir.IntType(64), k * ROW))], inbounds=True) for k in range(3)]


def _element(builder, room, i, kind):
    return builder.gep(room, [builder.add(i, ir.Constant(ir.IntType(64), kind * BLOCK))], inbounds=True)


def _reading(reader: Any) -> Any:
    """Return the function that reads patches that do not change."""

    @njit(forceinline=True, **UNCALLED, **OPTIONS)
    def read(table, located, i, values, times, n, cells):
        reader(table, located, i, values)

    return read


def _reader(count: int) -> Any:
    """Return a function that reads and evaluates the patches of four particles from i on."""

    @intrinsic
    def read(typing_context, table, located, i, values):
        def codegen(context, builder, signature, args):
            data = context.make_array(signature.args[0])(context, builder, args[0]).data
            integer, vector = ir.IntType(64), ir.VectorType(ir.DoubleType(), SIDE)

            def vector_at(pointer, index):
                return builder.bitcast(builder.gep(pointer, [index], inbounds=True), vector.as_pointer())

            def row(cell, k):
                index = builder.add(cell, ir.Constant(integer, SIDE * k))
                return builder.load(vector_at(data, index), align=8)

            def times_plus(a, b, c):
                return builder.fadd(builder.fmul(a, b, flags=["contract"]), c, flags=["contract"])

            cells, places = [], []
            for lane in range(SIDE):
                particle = builder.add(args[2], ir.Constant(integer, lane))
                cells.append(builder.fptosi(builder.load(_element(builder, args[1], particle, 0)), integer))
                f = builder.load(_element(builder, args[1], particle, 1))
                one = builder.insert_element(ir.Constant(vector, ir.Undefined), f, ir.Constant(ir.IntType(32), 0))
                splat = ir.Constant(ir.VectorType(ir.IntType(32), SIDE), [0] * SIDE)
                places.append(builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), splat))
            three = ir.Constant(vector, [3.0] * SIDE)
            for patch in range(count):
                at, along = [], []
                for cell, f in zip(cells, places, strict=True):
                    c0, c1, c2, c3 = (row(cell, patch + power * count) for power in range(SIDE))
                    at.append(times_plus(f, times_plus(f, times_plus(f, c3, c2), c1), c0))
                    twice = builder.fadd(c2, c2)
                    steep = times_plus(builder.fmul(three, f), c3, twice)
                    along.append(times_plus(f, steep, c1))
                for k, lanes in enumerate((*_transposed(builder, at), *_transposed(builder, along))):
                    place = _element(builder, args[3], args[2], 2 * SIDE * patch + k)
                    builder.store(lanes, builder.bitcast(place, vector.as_pointer()), align=32)
            return context.get_dummy_value()

        return types.void(table, located, types.intp, values), codegen

    return read


def _transposed(builder, rows):
    """Four vectors of four, transposed."""

    def mixed(a, b, order):
        return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), SIDE), order))

    low, high = [0, 4, 2, 6], [1, 5, 3, 7]
    pairs = [mixed(rows[k], rows[k + 1], order) for k in (0, 2) for order in (low, high)]
    left, right = [0, 1, 4, 5], [2, 3, 6, 7]
    return [
        mixed(pairs[0], pairs[2], left),
        mixed(pairs[1], pairs[3], left),
        mixed(pairs[0], pairs[2], right),
        mixed(pairs[1], pairs[3], right),
    ]
