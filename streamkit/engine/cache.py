"""Machine code on disk, keyed by content.

Numba's own disk cache identifies a function by the date of its file. It misses a change in another file from which the
function has its helpers, and would then run the old force. It does not work for closures, whose key has a random
identifier. The key here is therefore a digest of all that determines the machine code. Numba also runs whatever its
files contain. Each file here starts with a hash of its content, and a file with another content is compiled anew.
"""

from __future__ import annotations

import gc
import hashlib
import logging
import os
import pickle
import stat
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba import njit
from numba import types as numba_types
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher
from numba.core.typing.templates import builtin_registry

from streamkit import elementary

FASTMATH = ("arcp", "contract")
# Options of all compiled code. contract: fused multiply-add; arcp: one reciprocal for divisions by the same number.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": set(FASTMATH)}

# Options of functions that Python never calls: a wrapper takes as long to compile as many a function.
UNCALLED: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

# Options of helpers, which are inlined into the function that calls them.
INLINE: dict[str, Any] = {"inline": "always", "error_model": "numpy"}

# Numba's settings (environment variables NUMBA_...) that change the machine code. Its own key leaves them out.
SETTINGS = "OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "BOUNDSCHECK", "DISABLE_INTEL_SVML", "DEBUGINFO_DEFAULT"


class _HashedFiles(IndexDataCacheFile):  # type: ignore[misc]  # numba is untyped here
    """Numba's index and data files of a function, with a hash of numba's version and of the content in front.

    A file without its hash is a file that is not there. Each data file has its key as well: two processes that save at
    the same time may give one name to two kernels.
    """

    def save(self, key: Any, data: Any) -> None:
        """Save the machine code of a key."""
        super().save(key, (key, data))

    def load(self, key: Any) -> Any:
        """Return the machine code of a key, None if it is not there or damaged."""
        stored, data = super().load(key) or (None, None)
        return data if stored == key else None

    def _dump(self, obj: Any) -> bytes:
        content: bytes = super()._dump(obj)
        return self._hash(content) + content

    def _save_index(self, overloads: dict[Any, str]) -> None:
        self._save_data(self._index_name, (self._source_stamp, overloads))

    def _load_index(self) -> dict[Any, str]:
        stamp, overloads = self._load_data(self._index_name) or (None, {})
        return overloads if stamp == self._source_stamp else {}

    def _load_data(self, name: str) -> Any:
        try:
            stored = Path(self._data_path(name)).read_bytes()
        except OSError:
            return None
        size = hashlib.sha256().digest_size
        content = stored[size:]
        return pickle.loads(content) if stored[:size] == self._hash(content) else None  # noqa: S301

    def _hash(self, content: bytes) -> bytes:
        """Return the SHA-256 of numba's version, which can read the content, and of the content."""
        digest = hashlib.sha256(self._version.encode())
        digest.update(content)
        return digest.digest()


class ContentCache(FunctionCache):  # type: ignore[misc]  # numba is untyped here
    """Numba's disk cache with a digest in its key, and hashes in its files."""

    def __init__(self, function: Callable[..., Any], digest: str) -> None:
        super().__init__(function)
        self._digest = digest
        base = self._impl.filename_base + ".hashed"  # earlier versions of streamkit fail at such an index
        self._cache_file: Any = _HashedFiles(self._cache_path, base, self._impl.locator.get_source_stamp())

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the machine code, if there is room: on a full disk the next process compiles again."""
        with suppress(OSError):
            super().save_overload(sig, data)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the machine code, None if it is not there or damaged."""
        with suppress(Exception):  # pickle may raise anything for a damaged file
            return super().load_overload(sig, target_context)
        return None

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        return (sig, codegen.magic_tuple(), self._digest)


def disk_cache(function: Callable[..., Any], digest: str) -> Any:
    """Return the disk cache of a function; none if no folder can be written, or if other users may write to it.

    The content of the cache is executed, as machine code and by pickle, so other users must not write to it. The folder
    is beside the function's file, in ``NUMBA_CACHE_DIR``, or in the user's cache folder.
    """
    try:
        cache = ContentCache(function, digest)
    except RuntimeError:  # no folder can be written
        return NullCache()
    folder = Path(cache.cache_path)
    reason = _reason_not_to_trust(folder, Path(function.__code__.co_filename))
    if not reason:
        return cache
    if not _refused_folders():
        logging.getLogger("streamkit").warning(
            "Compiled code in %s is not used, as %s: set NUMBA_CACHE_DIR to a folder of your own, or each command "
            "compiles anew.", folder, reason,
        )  # fmt: skip
    _refused_folders().append(folder)
    return NullCache()


@cache
def _refused_folders() -> list[Path]:
    """Folders that were refused in this process. A warning names the first of them."""
    return []


@cache
def _reason_not_to_trust(folder: Path, source: Path) -> str:
    """Return why other users might have written to a folder; empty if none could.

    The owner may be root, or the owner of the source file, who could change that file as well. The group may be the
    private group of the user.
    """
    if not hasattr(os, "getuid"):  # not on Unix
        return ""
    owners = {os.getuid(), 0}
    with suppress(OSError):  # a notebook has no file
        owners.add(source.stat().st_uid)
    for place in (folder, folder.parent):
        state = place.stat()
        if state.st_uid not in owners:
            return f"{place} belongs to another user"
        guarded = place != folder and state.st_mode & stat.S_ISVTX  # others cannot replace what is in it
        shared = state.st_mode & stat.S_IWGRP and not _is_private(state.st_gid)
        if (shared or state.st_mode & stat.S_IWOTH) and not guarded:
            return f"others may write to {place}"
    return ""


def _is_private(group: int) -> bool:
    """Return whether a group has no members other than the user and root."""
    import grp  # not everywhere
    import pwd

    members: set[str] = set()
    with suppress(KeyError):  # a group or a user without a name
        members = set(grp.getgrgid(group).gr_mem) - {"root", pwd.getpwuid(os.getuid()).pw_name}
    return group in {os.getgid(), 0} and not members


def digest_of_parts(parts: list[str]) -> str:
    """Return a hash of the parts and of the versions and options that every compilation depends on."""
    options = [OPTIONS["error_model"], *FASTMATH]  # not the set: its order differs between processes
    options += [f"{getattr(numba.config, name)!r}" for name in SETTINGS]
    versions = [numba.__version__, llvmlite.__version__, np.__version__, *options]
    return hashlib.sha256("\n".join([*versions, *parts]).encode()).hexdigest()


def _engine_digest() -> str:
    return digest_of_parts([file.read_text(encoding="utf-8") for file in sorted(Path(__file__).parent.glob("*.py"))])


ENGINE = _engine_digest()  # digest of the whole engine's text: a change anywhere in it compiles all its loops anew


@contextmanager
def uncollected() -> Iterator[None]:
    """Stop Python's search for garbage while numba compiles. It finds little, and takes a tenth of the time."""
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if before:
            gc.enable()


class Loop:
    """A compiled function. Machine code for a signature is made, or read from the disk cache, at the first such call.

    A command that needs no live progenitor and no moving bodies compiles nothing for them.
    """

    def __init__(self, function: Callable[..., Any], signatures: tuple[Any, ...], nogil: bool) -> None:
        self._signatures = signatures
        self._dispatcher = njit(nogil=nogil, no_cfunc_wrapper=True, **OPTIONS)(function)
        self._dispatcher._cache = disk_cache(function, ENGINE)
        self._ready: set[tuple[type, type]] = set()

    def __call__(self, *arguments: Any) -> Any:
        """Call the machine code; TypeError for arrays of another type or layout."""
        classes = type(arguments[0]), type(arguments[1])
        if classes not in self._ready:
            self._prepare(classes)
        return self._dispatcher(*arguments)

    def _prepare(self, classes: tuple[type, type]) -> None:
        """Compile the signature whose first two arguments are of these classes."""
        fits = [one for one in self._signatures
                if all(getattr(argument, "instance_class", each) is each
                       for argument, each in zip(one.args, classes, strict=False))]  # fmt: skip
        with global_compiler_lock, uncollected():  # threads may come here together
            self._dispatcher.disable_compile(False)
            self._dispatcher.compile((fits or self._signatures)[0])
            self._dispatcher.disable_compile()  # other layouts would be compiled in silence
            self._ready.add(classes)


def cached(*signatures: Any, nogil: bool = False) -> Callable[[Callable[..., Any]], Loop]:
    """Make a loop for one signature, or for several that differ in their first two arguments; compiled once a machine.

    With ``nogil`` other Python threads run at the same time.
    """
    return lambda function: Loop(function, signatures, nogil)


def helper(function: Callable[..., Any]) -> Any:
    """Compile a function that loops call, when the first of them is compiled.

    Numba compiles a function once more for each literal among its arguments. Here a literal is a number like others.
    """
    dispatcher = njit(**UNCALLED, **OPTIONS)(function)
    template = dispatcher.get_call_template
    dispatcher.get_call_template = lambda args, kws: template(tuple(numba_types.unliteral(arg) for arg in args), kws)
    return dispatcher


def content_digest(function: Callable[..., Any] | tuple[Any, ...], layout: object) -> str | None:
    """Return a hash of all that determines a kernel's machine code; None if that cannot be determined.

    The hash covers the author's function (bytecode, constants, defaults) and, recursively, all that it refers to:
    helpers with their defaults and njit options, and the values of globals and closures. It cannot be determined with
    objects of other kinds, or with functions that an ``numba.extending.overload`` of somebody else replaces.
    """
    content = _Content()
    try:
        if isinstance(function, Dispatcher | tuple):
            content.add(function)
        else:
            content.add_function(function)
    except _UnknownError:
        return None
    return digest_of_parts([ENGINE, str(layout), *content.parts])


class _UnknownError(Exception):
    """The machine code depends on an object that cannot be described reliably."""


class _Content:
    """Descriptions, in ``parts``, of values that a kernel refers to."""

    def __init__(self) -> None:
        self.parts: list[str] = []
        self._seen: dict[int, str] = {}
        self._overloaded = _overloaded_names()

    def add(self, thing: Any) -> None:
        """Describe a value; raise `_UnknownError` if it cannot be described reliably."""
        if thing is None or type(thing) in {bool, int, float, complex, str} or isinstance(thing, np.number):
            self.parts.append(repr(thing))
        elif isinstance(thing, tuple | frozenset):
            items = sorted(thing, key=repr) if isinstance(thing, frozenset) else thing
            self.parts.append(f"{type(thing).__qualname__} {getattr(thing, '_fields', '')} {len(thing)}")
            for item in items:
                self.add(item)
        elif isinstance(thing, Dispatcher):
            self._add_helper(thing)
        elif self._is_library(thing) and thing.__name__ not in self._overloaded:
            self.parts.append(f"{getattr(thing, '__module__', '')} {thing.__name__}")
        else:
            raise _UnknownError

    @staticmethod
    def _is_library(thing: Any) -> bool:
        """Return whether numba or the engine implements it: its version or text is then in the digest."""
        if isinstance(thing, types.ModuleType):
            return thing in (np, elementary) or thing.__name__ == "math"
        if isinstance(thing, np.ufunc):
            return getattr(np, thing.__name__, None) is thing
        if isinstance(thing, types.BuiltinFunctionType):
            return thing.__module__ in {"builtins", "math"}
        modules = {"builtins", "numpy", elementary.__name__}
        return isinstance(thing, type | types.FunctionType) and thing.__module__ in modules

    def _add_helper(self, helper: Any) -> None:
        if type(helper) is not CPUDispatcher or helper._compiler.pipeline_class is not Compiler:
            raise _UnknownError
        for name, value in sorted({**helper.targetoptions, **helper.locals}.items()):
            self.parts.append(name)
            self.add(frozenset(value) if isinstance(value, set) else value)
        if not helper._can_compile:  # it has explicit signatures, to which arguments are converted
            self.parts.extend(map(str, helper.signatures))
        self.add_function(helper.py_func)

    def add_function(self, function: Any) -> None:
        """Describe a function that is to be compiled, and all that it refers to."""
        if id(function) in self._seen:
            self.parts.append(self._seen[id(function)])
            return
        self._seen[id(function)] = f"function {len(self._seen)}"
        self.parts.append(function.__module__)  # numba imports it when it reads the machine code back
        self.add(function.__defaults__)
        self.add(tuple(sorted((function.__kwdefaults__ or {}).items())))
        try:
            self.add(tuple(cell.cell_contents for cell in function.__closure__ or ()))
        except ValueError:  # an empty cell
            raise _UnknownError from None
        self._add_code(function.__code__, function.__globals__)

    def _add_code(self, code: types.CodeType, variables: dict[str, Any]) -> None:
        arguments = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
        names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
        self.parts.append(f"{code.co_code.hex()} {code.co_exceptiontable.hex()} {arguments} {names}")
        if self._overloaded & set(code.co_names):
            raise _UnknownError
        for name in code.co_names:
            if name in variables:
                self.parts.append(name)
                self.add(variables[name])
        for constant in code.co_consts:
            if isinstance(constant, types.CodeType):
                self._add_code(constant, variables)
            else:
                self.add(constant)


def _overloaded_names() -> set[str]:
    """Names of functions, methods and attributes that overloads from outside numba and the engine replace."""
    names: set[str] = set()
    for template in (*builtin_registry.functions, *builtin_registry.attributes):
        overload = getattr(template, "_overload_func", None)
        place = getattr(overload, "__globals__", {}).get("__name__", "")
        if overload is not None and not place.startswith(("numba.", "streamkit.engine.")):
            names.add(getattr(template, "_attr", "") or getattr(template.key, "__name__", ""))
    return names
