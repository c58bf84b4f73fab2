"""From an elementwise `acceleration` to a C function over a batch, cached on disk by content.

Every force in the hot loop is ``void kernel(n, t[n], p[k], centre[3], q, a, fresh)``: the acceleration at ``q`` about
a centre replaces what is in ``a`` if fresh, and is added to it otherwise. The rows x, y, z of both are ``ROW`` doubles
apart. The key of its machine code is the content of the author's function: bytecode,
constants and, followed to the end, everything its globals refer to.
"""

from __future__ import annotations

import ctypes
import functools
import types as python_types
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Protocol

import numpy as np
from numba import carray, njit, types
from numba.core import sigutils
from numba.core.ccallback import CFunc
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numba.np.unsafe.ndarray import to_fixed_tuple

from streamkit import elementary
from streamkit.engine import vector
from streamkit.engine.cache import ENGINE, OPTIONS, ContentCache, digest_of_parts
from streamkit.engine.forces import ROW
from streamkit.errors import PluginError
from streamkit.stream import Array

_POINTER = types.CPointer(types.float64)
SIGNATURE = types.void(types.intp, *[_POINTER] * 5, types.intp)


class Force(Protocol):
    """What the engine needs of a potential: `streamkit.Potential` has it."""

    kind: ClassVar[str]
    compiled: ClassVar[bool]

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, *parameters: Any) -> Any:
        """Return ``(ax, ay, az)``, elementwise."""

    @classmethod
    def parameters(cls) -> Mapping[str, object]:
        """Return the arguments of `acceleration` after t, by name."""

    def in_engine_units(self) -> Array:
        """(k,) The values of these."""


@functools.cache
def compiled_kernel(cls: type[Force]) -> Any:
    """Return the machine code of a potential class: an object with an ``address``. Once per class and process.

    Raises
    ------
    PluginError
        If numba cannot compile the author's function.
    """
    count = len(cls.parameters())
    acceleration = njit(forceinline=True, **OPTIONS)(cls.acceleration)

    def kernel(n, t, p, centre, q, a, fresh):
        parameters = to_fixed_tuple(carray(p, (count,)), count)
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
    cfunc: Any = CFunc(kernel, (args, return_type), locals={}, options=dict(OPTIONS))
    digest = content_digest(cls.acceleration, count)
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


def content_digest(function: Callable[..., Any], count: int) -> str | None:
    """Return a hash of all that determines the kernel's machine code, None if that cannot be known."""
    parts: list[str] = [ENGINE, str(count)]
    known = _describe(function, parts, set())
    return digest_of_parts(parts) if known else None


def _describe(thing: Any, parts: list[str], seen: set[int]) -> bool:
    """Append a description of a value a kernel refers to; False if it has none that is sure."""
    if isinstance(thing, Dispatcher):
        thing = thing.py_func
    if thing is None or isinstance(thing, bool | int | float | str | np.number):
        parts.append(repr(thing))
        return True
    if isinstance(thing, tuple | frozenset):
        return all(_describe(item, parts, seen) for item in thing)
    if isinstance(thing, python_types.ModuleType):
        parts.append(thing.__name__)  # numpy and math: their functions are numba's, whose version is in
        return thing.__name__ in {"numpy", "math"} or thing is elementary
    if isinstance(thing, np.ufunc | python_types.BuiltinFunctionType | type):
        parts.append(f"{thing!r}")
        return True
    if isinstance(thing, python_types.FunctionType):
        return _describe_function(thing, parts, seen)
    return False


def _describe_function(function: python_types.FunctionType, parts: list[str], seen: set[int]) -> bool:
    if id(function) in seen:
        return True
    seen.add(id(function))
    if function.__module__ in {elementary.__name__, vector.__name__}:  # their text is part of the engine's digest
        parts.append(f"{function.__module__}.{function.__name__}")
        return True
    return _describe_code(function.__code__, function, parts, seen)


def _describe_code(
    code: python_types.CodeType, function: python_types.FunctionType, parts: list[str], seen: set[int]
) -> bool:
    # The module too: numba imports it when it reads the machine code back.
    parts.append(f"{function.__module__} {code.co_code.hex()} {code.co_names} {code.co_varnames}")
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    named = [function.__globals__[n] for n in code.co_names if n in function.__globals__]
    nested = [c for c in code.co_consts if isinstance(c, python_types.CodeType)]
    plain = [c for c in code.co_consts if not isinstance(c, python_types.CodeType)]
    return all(_describe(item, parts, seen) for item in [*cells, *named, *plain]) and all(
        _describe_code(c, function, parts, seen) for c in nested
    )


_CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_ssize_t, *[ctypes.c_void_p] * 5, ctypes.c_ssize_t)
_ROWS, _PLACE, _TIMES = ctypes.c_double * (3 * ROW), ctypes.c_double * 3, ctypes.c_double * ROW


def _view(kind: Any, address: int) -> Array:
    """View of what is at an address: quicker than numpy.ctypeslib, and many a call is for one particle."""
    return np.frombuffer(memoryview(kind.from_address(address)))


class NumpyKernel:
    """A kernel whose body runs in Python, once per batch: for ``compiled = False``.

    Exceptions cannot cross the compiled loop: the first is kept in ``error`` for the engine to raise, and the
    accelerations become NaN.
    """

    def __init__(self, cls: type[Force]) -> None:
        self.error: Exception | None = None
        self._parameters = ctypes.c_double * len(cls.parameters())
        self._acceleration = cls.acceleration
        self._callback = _CALLBACK(self._call)
        self.address = ctypes.cast(self._callback, ctypes.c_void_p).value

    def _call(self, n: int, t: int, p: int, centre: int, q: int, a: int, fresh: int) -> None:
        total = _view(_ROWS, a).reshape(3, ROW)[:, :n]
        try:
            place, about = _view(_ROWS, q).reshape(3, ROW)[:, :n], _PLACE.from_address(centre)[:]
            x, y, z = place - np.array(about)[:, None] if any(about) else place
            found = self._acceleration(x, y, z, _view(_TIMES, t)[:n], *self._parameters.from_address(p))
            if fresh:
                total[:] = found
            else:
                total += found
        except Exception as error:
            self.error = self.error or error
            total[:] = np.nan


@functools.cache
def numpy_kernel(cls: type[Force]) -> NumpyKernel:
    """Return the Python kernel of a class with ``compiled = False``. Once per class and process."""
    return NumpyKernel(cls)
