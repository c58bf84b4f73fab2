"""Component classes given in Python, from a notebook or a script: their supplier, and a digest of their code."""

from __future__ import annotations

import hashlib
import inspect
import types
from collections.abc import Iterable
from typing import Any

from streamkit.components.bases import Component
from streamkit.components.plugin import Plugin, check_class

IN_PYTHON = "given in Python"  # part of the supplier of such a class


def load_given(classes: Iterable[type[Component]]) -> list[Plugin]:
    """Return a plugin for each class. Raises PluginError for an incomplete component."""
    given = list(classes)
    for cls in given:
        check_class(cls)
    return [Plugin(f"{cls.__qualname__} {IN_PYTHON}, sha256:{code_digest(cls)}", "", None, (cls,)) for cls in given]


def code_digest(cls: type[Component]) -> str:
    """Return a hash of the code of a class, of its fields, and of the functions and constants that its code names.

    Names are followed within the module of the class. Code of installed packages is left out.
    """
    digest = hashlib.sha256(repr(sorted(map(repr, cls.model_fields.items()))).encode())
    seen: set[int] = set()
    for base in cls.__mro__:
        if base.__module__ == cls.__module__:
            for name, value in sorted(vars(base).items()):
                inner = getattr(value, "__func__", value)
                if isinstance(inner, types.FunctionType):
                    _add(digest, inner, cls.__module__, seen)
                elif isinstance(value, str | int | float) and not name.startswith("_"):
                    digest.update(f"{name}={value!r}".encode())
    return digest.hexdigest()[:12]


def _add(digest: Any, function: types.FunctionType, module: str, seen: set[int]) -> None:
    if id(function) in seen or function.__module__ != module:
        return
    seen.add(id(function))
    _add_code(digest, function.__code__)
    outer = inspect.getclosurevars(function)
    for name, value in sorted({**outer.globals, **outer.nonlocals}.items()):
        inner = getattr(value, "py_func", value)  # a function that numba has compiled
        if isinstance(inner, types.FunctionType):
            _add(digest, inner, module, seen)
        elif isinstance(value, str | int | float | complex | tuple | list | dict | set):
            digest.update(f"{name}={value!r}".encode())
        elif hasattr(value, "tobytes"):
            digest.update(name.encode() + value.tobytes())


def _add_code(digest: Any, code: types.CodeType) -> None:
    digest.update(code.co_code + repr(code.co_names).encode())
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            _add_code(digest, constant)
        else:
            digest.update(repr(constant).encode())
