"""Machine code on disk, keyed by content.

Numba's own disk cache stamps a function with the date of its file alone: it misses a change in a file that the
function's helpers come from, and a stale force is the worst bug there is. Closures it does not serve at all, as their
key holds a random identifier. So the key here is a digest of all that determines the machine code.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import njit
from numba.core.caching import FunctionCache

FASTMATH = ("arcp", "contract")
OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": set(FASTMATH)}
"""For all compiled code. contract: fused multiply-add; arcp: one reciprocal for divisions by the same number."""

INLINE: dict[str, Any] = {"inline": "always", "error_model": "numpy"}
"""For the helpers, which become part of the function that calls them."""


class ContentCache(FunctionCache):  # type: ignore[misc]  # numba is untyped here
    """Numba's disk cache with a digest in its key."""

    def __init__(self, function: Callable[..., Any], digest: str) -> None:
        super().__init__(function)
        self._digest = digest

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        return (sig, codegen.magic_tuple(), self._digest)


def digest_of_parts(parts: list[str]) -> str:
    """Return a hash of the parts and of the versions and options that every compilation depends on."""
    options = [OPTIONS["error_model"], *FASTMATH]  # not the set: its order is another one in every process
    versions = [numba.__version__, np.__version__, *options]
    return hashlib.sha256("\n".join([*versions, *parts]).encode()).hexdigest()


def _engine_digest() -> str:
    return digest_of_parts([file.read_text() for file in sorted(Path(__file__).parent.glob("*.py"))])


ENGINE = _engine_digest()
"""Digest of the whole engine's text: a change anywhere in it compiles all its loops anew."""


def cached(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a loop for one signature, whatever layout a caller's arrays have; once per machine."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(**OPTIONS)(function)
        dispatcher._cache = ContentCache(function, ENGINE)
        dispatcher.compile(signature)
        dispatcher.disable_compile()
        return dispatcher

    return decorate
