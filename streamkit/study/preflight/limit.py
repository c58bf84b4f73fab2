"""A call within the time limit of the run: a component may never return."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from streamkit.runfile import Spec
from streamkit.sample import first_call

Result = TypeVar("Result")


def within_limit(spec: Spec, function: Callable[..., Result], *args: Any) -> Result:
    """Return the result of a call; CallTimeout as `first_call`."""
    return first_call(spec.sampler.call_limit, function, *args)
