"""From an elementwise `acceleration` to a C function over a batch, cached on disk by content.

Every force in the hot loop is ``void kernel(n, t[n], p[k], centre[3], q, a, fresh)``: the acceleration at ``q`` about
a centre replaces what is in ``a`` if fresh, and is added to it otherwise. The rows x, y, z of both are ``ROW`` doubles
apart.
"""

from __future__ import annotations

import ctypes
import functools
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, ClassVar, Protocol

import numpy as np
from numba import carray, njit, types
from numba.core import sigutils
from numba.core.ccallback import CFunc
from numba.core.compiler import Compiler
from numba.core.errors import NumbaError

from streamkit.engine import vector  # noqa: F401  its overloads are what the elementary functions compile to
from streamkit.engine.arguments import ENDLESS, unpacker
from streamkit.engine.axes import turned
from streamkit.engine.cache import OPTIONS, UNCALLED, content_digest, disk_cache, uncollected
from streamkit.engine.changing import Changes, arguments_at, compiled_arguments
from streamkit.engine.forces import ROW
from streamkit.engine.motion import AT_REST, STILL, Motion, Moves, compiled_motion
from streamkit.engine.patches import sweep_of
from streamkit.errors import PluginError
from streamkit.stream import Array, from_axes, read_only
from streamkit.units import CENTRE

_POINTER = types.CPointer(types.float64)
SIGNATURE = types.void(types.intp, *[_POINTER] * 5, types.intp)


class Force(Protocol):
    """The part of `streamkit.Potential` that the engine needs."""

    kind: ClassVar[str]
    compiled: ClassVar[bool]

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, *parameters: Any) -> Any:
        """Return ``(ax, ay, az)``, elementwise."""

    @staticmethod
    def drag(x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any, t: Any, *parameters: Any) -> Any:
        """Return the part that depends on velocity, elementwise; used if it `has_drag`."""

    @classmethod
    def has_drag(cls) -> bool:
        """Say whether a part of the force depends on velocity."""

    def in_engine_units(self) -> tuple[Any, ...]:
        """Return the arguments of `acceleration` after t: numbers and arrays; any object if it is not compiled."""

    def changes(self) -> Changes:
        """Return the arguments of `acceleration` after t that change in time, and the factor on the force."""

    def rotation(self) -> tuple[float, ...] | None:
        """Return the rotation matrix of the axes, row by row (9,); None if they are those of the Galaxy."""

    def motion(self) -> Motion:
        """Return how its centre moves and its axes turn in time."""

    def in_loop(self) -> Force:
        """Return the force in a loop: the potential itself, or an expansion of it."""


class _NoAliasCompiler(Compiler):  # type: ignore[misc]  # numba is untyped here
    """Tell LLVM that the arguments of a kernel do not overlap, so that loops that read tables are vectorised."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.flags.noalias = True


@functools.cache
def compiled_kernel(
    cls: type[Force],
    layout: tuple[int, ...],
    changing: tuple[int, ...] = (),
    turning: bool = False,
    moves: Moves = AT_REST,
) -> Any:
    """Return the machine code of a potential class: an object with an ``address``. Once per class and process.

    Parameters
    ----------
    cls
        The potential.
    layout
        Dimensions of the arguments after t, as `layout_of` gives them, and of the pieces of those that change.
    changing
        The numbers of the arguments that change in time, as `Changes` has them. Their pieces follow the others.
    turning
        Whether the nine arguments before these are the rotation of its axes.
    moves
        What changes in the frame of the force: the tables of a `Motion` are the last arguments.

    Raises `PluginError` if numba cannot compile the author's function.
    """
    unpack, patches, pull = unpacker(layout), getattr(cls, "patches", None), getattr(cls, "pull", None)
    written = patches or pull or cls.acceleration
    acceleration = _radial(pull) if pull else written
    along = turning or moves[0]
    sweep = sweep_of(patches, along) if patches else _elementwise(turned(acceleration) if along else acceleration)

    def kernel(n, t, p, centre, q, a, fresh):
        parameters = unpack(carray(p, (ENDLESS,)))
        times = carray(t, (n,))
        place, total, c = carray(q, (3 * ROW,)), carray(a, (3 * ROW,)), carray(centre, (3,))
        sweep(0, n, times, place, total, c, fresh, parameters, 1.0)

    if not changing and moves == AT_REST:
        return machine_code(kernel, [(cls, written)], [(layout, turning)])
    last = len(layout) - 3 * moves[0] - moves[1]
    now, factor = compiled_arguments(last - len(changing), changing)
    along_axes, shifted = compiled_motion(now, last, moves)

    def changing_kernel(n, t, p, centre, q, a, fresh):
        packed = unpack(carray(p, (ENDLESS,)))
        times = carray(t, (n,))
        place, total, c = carray(q, (3 * ROW,)), carray(a, (3 * ROW,)), carray(centre, (3,))
        together = True
        for i in range(n):
            together &= times[i] == times[0]
        if together:
            t0 = times[0]
            about, parameters = shifted(t0, packed, c), along_axes(t0, packed)
            sweep(0, n, times, place, total, about, fresh, parameters, factor(t0, packed))
        else:
            for i in range(n):
                ti = times[i]
                about, parameters = shifted(ti, packed, c), along_axes(ti, packed)
                sweep(i, i + 1, times, place, total, about, fresh, parameters, factor(ti, packed))

    return machine_code(changing_kernel, [(cls, written)], [(layout, turning, changing, moves)])


def machine_code(kernel: Any, written: Sequence[tuple[type[Force], Any]], layouts: Sequence[object]) -> Any:
    """Compile a kernel, or load it from the disk cache if possible: an object with an ``address``.

    Parameters
    ----------
    written
        The classes whose functions the kernel contains, each with its function, or with a tuple of functions.
    layouts
        Everything else that determines the machine code, for each class.

    Raises `PluginError` if numba cannot compile an author's function.
    """
    args, return_type = sigutils.normalize_signature(SIGNATURE)
    cfunc: Any = CFunc(kernel, (args, return_type), locals={}, options=dict(OPTIONS), pipeline_class=_NoAliasCompiler)
    digests = [content_digest(function, layout) for (_, function), layout in zip(written, layouts, strict=True)]
    if None not in digests:
        cfunc._cache = disk_cache(kernel, " ".join(filter(None, digests)))
    try:
        with uncollected():
            cfunc.compile()
    except NumbaError as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        reason = next((line for line in lines if not line.startswith("Failed in")), lines[0])
        parts = [(cls, getattr(part, "__name__", "patches")) for cls, part in written]
        names = ", ".join(f"{cls.__module__}.{cls.__name__}.{name}" for cls, name in parts)
        raise PluginError(
            f"numba cannot compile {names}: {reason}. Write elementwise "
            "arithmetic with the functions that streamkit exports, decorate helper functions with numba.njit, or "
            "set `compiled = False` in the class."
        ) from None
    return cfunc


def _radial(pull: Any) -> Any:
    """Return the acceleration of a spherical potential from its author's `pull` (`streamkit.Spherical`)."""
    inlined = njit(forceinline=True, **UNCALLED, **OPTIONS)(pull)

    def acceleration(x, y, z, t, *parameters):
        k = inlined(x * x + y * y + z * z + CENTRE, *parameters)
        return k * x, k * y, k * z

    return acceleration


def _elementwise(author: Any) -> Any:
    """Return the loop over particles with the author's `acceleration`."""
    inlined = njit(forceinline=True, **UNCALLED, **OPTIONS)
    acceleration = inlined(author)

    @inlined
    def sweep(begin, end, times, place, total, c, fresh, parameters, factor):
        x, y, z = c[0], c[1], c[2]
        for i in range(begin, end):
            dx, dy, dz = place[i] - x, place[ROW + i] - y, place[2 * ROW + i] - z
            ax, ay, az = acceleration(dx, dy, dz, times[i], *parameters)
            total[i] = factor * ax if fresh else total[i] + factor * ax
            total[ROW + i] = factor * ay if fresh else total[ROW + i] + factor * ay
            total[2 * ROW + i] = factor * az if fresh else total[2 * ROW + i] + factor * az

    return sweep


_CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_ssize_t, *[ctypes.c_void_p] * 5, ctypes.c_ssize_t)
_PLACE, _TIMES = ctypes.c_double * 3, ctypes.c_double * ROW


@functools.cache
def _rows(count: int) -> Any:
    """Return the ctypes type of ``count`` rows."""
    return ctypes.c_double * (count * ROW)


def _view(kind: Any, address: int) -> Array:
    """View of memory at an address: faster than numpy.ctypeslib, which matters in calls for one particle."""
    return np.frombuffer(memoryview(kind.from_address(address)))


def _read_only_view(kind: Any, address: int) -> Array:
    """Read-only view of memory at an address."""
    return np.frombuffer(memoryview(kind.from_address(address)).toreadonly())


class NumpyKernel:
    """A kernel whose body runs in Python, once per batch: for ``compiled = False``. It belongs to one instance.

    Exceptions cannot cross the compiled loop. The first one, of any type, is stored in ``error``, and the engine raises
    it after the loop. Until then the accelerations are NaN, and the author's function is not called again.
    """

    def __init__(
        self, force: Force, changes: Changes = (), rotation: tuple[float, ...] | None = None, motion: Motion = STILL
    ) -> None:
        self.error: BaseException | None = None
        self._arguments, self._changes = force.in_engine_units(), changes
        self._rotation, self._motion = rotation, motion
        self._acceleration = force.acceleration
        self._callback = _CALLBACK(self._call)
        self.address = ctypes.cast(self._callback, ctypes.c_void_p).value

    @property
    def shown_arguments(self) -> str:
        """The arguments after t, for messages; arrays and objects by their type."""
        texts = (f"{v!r}" if isinstance(v, float) else f"{type(v).__name__} {np.shape(v)}" for v in self._arguments)
        return f"[{', '.join(texts)}]"

    def _call(self, n: int, t: int, p: int, centre: int, q: int, a: int, fresh: int) -> None:
        total = _view(_rows(3), a).reshape(3, ROW)[:, :n]
        try:
            if self.error is None:
                with np.errstate():  # undoes an np.seterr of the author after the call
                    self._fill(
                        lambda rows: _read_only_view(_rows(rows), q).reshape(rows, ROW)[:, :n],
                        _read_only_view(_TIMES, t)[:n],
                        _PLACE.from_address(centre)[:],
                        total,
                        fresh,
                    )
                return
        except BaseException as error:
            self.error = error
        total[:] = np.nan

    def _fill(self, q: Callable[[int], Array], times: Array, about: list[float], total: Array, fresh: int) -> None:
        """Write the acceleration at q about a centre into ``total`` if fresh; add it otherwise."""
        place = q(3)
        if any(about):
            place = place - np.array(about)[:, None]
            place.flags.writeable = False
        rotation: Sequence[Any] | None = self._rotation
        if rotation is not None or self._motion.moves != AT_REST:
            place, rotation = self._motion.seen(place, times, rotation)
        x, y, z = read_only(place)
        arguments, factor = self._arguments, None
        if self._changes:
            arguments, factor = arguments_at(times, arguments, self._changes)
        acceleration = self._acceleration(x, y, z, times, *arguments)
        if rotation is not None:
            acceleration = from_axes(rotation, *acceleration)
        if factor is not None:
            acceleration = factor * np.stack(np.broadcast_arrays(*acceleration))
        if fresh:
            total[:] = acceleration
        else:
            total += acceleration

    @contextmanager
    def catching_exceptions(self) -> Iterator[None]:
        """Catch exceptions that are raised before the ``try`` of `_call`.

        Python handles a Ctrl-C that arrives in compiled code at the first instruction of the next callback, before its
        ``try``; ctypes would print the KeyboardInterrupt and continue.
        """
        before = sys.unraisablehook

        def store(unraisable: Any) -> None:
            if "ctypes callback" in (unraisable.err_msg or ""):
                self.error = self.error or unraisable.exc_value
            else:
                before(unraisable)

        sys.unraisablehook = store
        try:
            yield
        finally:
            sys.unraisablehook = before
