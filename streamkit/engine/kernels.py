"""From an elementwise `acceleration` to a C function over a batch, cached on disk by content.

Every force in the hot loop is ``void kernel(n, t[n], p[k], centre[3], q, a, fresh)``: the acceleration at ``q`` about
a centre replaces what is in ``a`` if fresh, and is added to it otherwise. The rows x, y, z of both are ``ROW`` doubles
apart.
"""

from __future__ import annotations

import ctypes
import functools
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar, Protocol

import numpy as np
from numba import carray, njit, types
from numba.core import sigutils
from numba.core.ccallback import CFunc
from numba.core.compiler import Compiler
from numba.core.errors import NumbaError
from numba.np.unsafe.ndarray import to_fixed_tuple

from streamkit.engine import vector  # noqa: F401  its overloads are what the elementary functions compile to
from streamkit.engine.cache import OPTIONS, ContentCache, content_digest
from streamkit.engine.forces import ROW
from streamkit.errors import PluginError
from streamkit.stream import Array

_POINTER = types.CPointer(types.float64)
SIGNATURE = types.void(types.intp, *[_POINTER] * 5, types.intp)
_LONGEST = 1 << 40
"""Numbers in a packed table, at most: the compiled code does not look."""


class Force(Protocol):
    """What the engine needs of a potential: `streamkit.Potential` has it."""

    kind: ClassVar[str]
    compiled: ClassVar[bool]
    packed: ClassVar[bool]

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, *parameters: Any) -> Any:
        """Return ``(ax, ay, az)``, elementwise."""

    @classmethod
    def parameters(cls) -> Mapping[str, object]:
        """Return the arguments of `acceleration` after t, by name."""

    def in_engine_units(self) -> Array:
        """(k,) The values of these."""

    def in_loop(self) -> Force:
        """Return what stands for it in a loop: itself, or an expansion of it."""


class _Apart(Compiler):  # type: ignore[misc]  # numba is untyped here
    """Tells LLVM that the arguments of a kernel do not overlap: what is read from a table may then be vectorised."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.flags.noalias = True


@functools.cache
def compiled_kernel(cls: type[Force]) -> Any:
    """Return the machine code of a potential class: an object with an ``address``. Once per class and process.

    Raises `PluginError` if numba cannot compile the author's function.
    """
    count = 1 if cls.packed else len(cls.parameters())
    acceleration = njit(forceinline=True, **OPTIONS)(cls.acceleration)

    @njit(forceinline=True, **OPTIONS)
    def unpacked(p):
        return to_fixed_tuple(carray(p, (count,)), count)

    @njit(forceinline=True, **OPTIONS)
    def whole(p):
        return (carray(p, (_LONGEST,)),)

    arguments = whole if cls.packed else unpacked

    def kernel(n, t, p, centre, q, a, fresh):
        parameters = arguments(p)
        times = carray(t, (n,))
        place = carray(q, (3 * ROW,))
        total = carray(a, (3 * ROW,))
        c = carray(centre, (3,))
        x, y, z = c[0], c[1], c[2]
        for i in range(n):
            dx, dy, dz = place[i] - x, place[ROW + i] - y, place[2 * ROW + i] - z
            ax, ay, az = acceleration(dx, dy, dz, times[i], *parameters)
            total[i] = ax if fresh else total[i] + ax
            total[ROW + i] = ay if fresh else total[ROW + i] + ay
            total[2 * ROW + i] = az if fresh else total[2 * ROW + i] + az

    args, return_type = sigutils.normalize_signature(SIGNATURE)
    cfunc: Any = CFunc(kernel, (args, return_type), locals={}, options=dict(OPTIONS), pipeline_class=_Apart)
    digest = content_digest(cls.acceleration, -1 if cls.packed else count)
    if digest is not None:
        cfunc._cache = ContentCache(kernel, digest)
    try:
        cfunc.compile()
    except NumbaError as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        reason = next((line for line in lines if not line.startswith("Failed in")), lines[0])
        raise PluginError(
            f"numba cannot compile {cls.__module__}.{cls.__name__}.acceleration: {reason}. Write elementwise "
            "arithmetic with the functions that streamkit exports, decorate helper functions with numba.njit, or "
            "set `compiled = False` in the class."
        ) from None
    return cfunc


_CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_ssize_t, *[ctypes.c_void_p] * 5, ctypes.c_ssize_t)
_ROWS, _PLACE, _TIMES = ctypes.c_double * (3 * ROW), ctypes.c_double * 3, ctypes.c_double * ROW


def _view(kind: Any, address: int) -> Array:
    """View of what is at an address: quicker than numpy.ctypeslib, and many a call is for one particle."""
    return np.frombuffer(memoryview(kind.from_address(address)))


def _look(kind: Any, address: int) -> Array:
    """Read-only view of what is at an address."""
    return np.frombuffer(memoryview(kind.from_address(address)).toreadonly())


class NumpyKernel:
    """A kernel whose body runs in Python, once per batch: for ``compiled = False``.

    Exceptions cannot cross the compiled loop. The first, whatever its type, is kept in ``error`` for the engine to
    raise: from then on the accelerations are NaN, and the author's function is not called.
    """

    def __init__(self, cls: type[Force]) -> None:
        self.error: BaseException | None = None
        self._parameters = ctypes.c_double * len(cls.parameters())
        self._acceleration = cls.acceleration
        self._callback = _CALLBACK(self._call)
        self.address = ctypes.cast(self._callback, ctypes.c_void_p).value

    def _call(self, n: int, t: int, p: int, centre: int, q: int, a: int, fresh: int) -> None:
        total = _view(_ROWS, a).reshape(3, ROW)[:, :n]
        try:
            if self.error is None:
                place, about = _look(_ROWS, q).reshape(3, ROW)[:, :n], _PLACE.from_address(centre)[:]
                if any(about):
                    place = place - np.array(about)[:, None]
                    place.flags.writeable = False
                x, y, z = place
                found = self._acceleration(x, y, z, _look(_TIMES, t)[:n], *self._parameters.from_address(p))
                if fresh:
                    total[:] = found
                else:
                    total += found
                return
        except BaseException as error:
            self.error = error
        total[:] = np.nan

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Keep also what is raised before `_call` can catch anything.

        A Ctrl-C that arrives in compiled code is answered at the first instruction of the next callback, outside its
        ``try``, and ctypes would print the KeyboardInterrupt and go on.
        """
        before = sys.unraisablehook

        def keep(unraisable: Any) -> None:
            if "ctypes callback" in (unraisable.err_msg or ""):
                self.error = self.error or unraisable.exc_value
            else:
                before(unraisable)

        sys.unraisablehook = keep
        try:
            yield
        finally:
            sys.unraisablehook = before


@functools.cache
def numpy_kernel(cls: type[Force]) -> NumpyKernel:
    """Return the Python kernel of a class with ``compiled = False``. Once per class and process."""
    return NumpyKernel(cls)
