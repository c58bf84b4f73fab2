"""A call within the time limit of the run: a component may never return."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from streamkit.runfile import Spec
from streamkit.sample import COMPILING, CallTimeout, call_with_timeout

Result = TypeVar("Result")


def within_limit(spec: Spec, function: Callable[..., Result], *args: Any) -> Result:
    """Return what the function gives; CallTimeout if that takes `COMPILING` longer than the sampler's limit."""
    limit = spec.sampler.call_limit
    result = call_with_timeout(limit + COMPILING, function, *args)
    if isinstance(result, str):
        raise CallTimeout(
            f"a call took longer than sampler.call_limit = {limit:g} s and the {COMPILING:g} s that it has for "
            "compiling"
        )
    return result
