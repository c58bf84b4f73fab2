"""What `check` says of components that are not built in, and of the cost of the search for a start."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from pydantic import Field
from runfiles import FIT

import streamkit as sk
from streamkit.study.preflight import describe_preflight, run_preflight
from streamkit.study.preflight.warnings import conformance_warnings


def halo(sign: float = -1.0, twist: float = 0.0, chance: float = 0.0) -> type[sk.Potential]:
    rng = np.random.default_rng(1)

    class Halo(sk.Potential):
        """An isothermal sphere with something wrong."""

        kind = "doubtful"
        compiled = False
        v0: sk.Speed = Field(default=200.0, description="Circular velocity.")

        @staticmethod
        def acceleration(x: Any, y: Any, z: Any, t: Any, v0: Any) -> Any:
            k = sign * v0 * v0 / (x * x + y * y + z * z) * (1 + chance * rng.standard_normal())
            return k * x - twist * k * y, k * y + twist * k * x, k * z

    return Halo


RUN: dict[str, Any] = FIT | {"potential": {"kind": "doubtful"}}


def doubts(cls: type[sk.Potential], document: dict[str, Any] = RUN) -> str:
    begin = time.process_time()
    found = " ".join(conformance_warnings(sk.load(document, components=[cls]).bind()))
    assert time.process_time() - begin < 2.0
    return found


@pytest.mark.parametrize(
    ("mistake", "told"),
    [
        ({"sign": 1.0}, "its sign is wrong"),
        ({"twist": 0.1}, "is curl free: curl: relative difference"),
        ({"chance": 1e-6}, "draw no random numbers"),
    ],
)
def test_a_mistake_in_a_force_of_a_run_is_told(mistake: dict[str, float], told: str) -> None:
    found = doubts(halo(**mistake))
    assert told in found
    assert "potential (doubtful): " in found
    assert "streamkit.testing.check" in found


def test_what_is_right_or_built_in_is_passed_over() -> None:
    assert doubts(halo()) == ""
    assert conformance_warnings(sk.load(FIT).bind()) == []


def test_a_force_without_a_value_somewhere_is_no_mistake() -> None:
    class Limited(sk.Potential):
        """An isothermal sphere that ends."""

        kind = "doubtful"
        compiled = False
        v0: sk.Speed = Field(default=200.0, description="Circular velocity.")

        @staticmethod
        def acceleration(x: Any, y: Any, z: Any, t: Any, v0: Any) -> Any:
            r2 = x * x + y * y + z * z
            if np.any(r2 > 100.0**2):
                raise sk.OutOfDomain("beyond the table")
            k = -v0 * v0 / r2
            return k * x, k * y, k * z

    assert doubts(Limited) == ""


@pytest.mark.slow
@pytest.mark.usefixtures("whole_search")
def test_the_cost_includes_the_search() -> None:
    spec = sk.load(FIT)
    found = run_preflight(spec, draws=32)
    text = " ".join(describe_preflight(spec, found).split())
    assert f"the search for a start about {found.cost.search_calls} calls, most with 1000 particles: " in text
    made = sk.run(spec, steps=1, progress=False).search_calls
    assert made / 4 < found.cost.search_calls < 4 * made
    assert run_preflight(spec, draws=0).cost.search_calls == 0
