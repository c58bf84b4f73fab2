"""A component that raises or breaks its contract: the same one message from the model, a fit and a command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from commands import call, refused
from runfiles import RUN

import streamkit as sk

PLUGIN = '''
from typing import Any
import numpy as np
from pydantic import Field
from streamkit import Array, Component, Integrator, Potential, Release, Speed, Stripping, hookimpl

class Odd(Stripping):
    """Does what its field `mode` asks for."""

    kind = "odd"
    draws = 3
    mode: str = "good"

    def times(self, orbit: Any) -> Array:
        n = self.particles
        late = {"few": np.zeros(2), "nan": np.full(n, np.nan), "future": np.ones(n)}
        return late.get(self.mode, super().times(orbit))

    def release(self, orbit: Any, tail: Any, mass: float, normals: Array) -> Any:
        if self.mode == "raise":
            raise ZeroDivisionError("boom")
        if self.mode == "rows":
            return Release(orbit.q.T, orbit.v.T)
        if self.mode == "none":
            return None
        return Release(orbit.q * (np.nan if self.mode == "holes" else 1.0), orbit.v)

class Lazy(Integrator):
    """Fails."""

    kind = "lazy"
    order = 1

    def advance(self, field: Any, q: Array, v: Array, t0: Array, t1: float) -> None:
        raise ArithmeticError("too lazy")

class Moody(Potential):
    """Fails in Python."""

    kind = "moody"
    compiled = False
    v0: Speed = Field(default=210, description="Speed.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, v0: Any) -> Any:
        raise LookupError("no force today")

@hookimpl
def streamkit_components() -> list[type[Component]]:
    return [Odd, Lazy, Moody]
'''

BROKEN = {
    "raise": ["stripping odd failed: ZeroDivisionError in", "Odd.release: boom"],
    "none": ["stripping odd failed: AttributeError in", "'q'"],
    "rows": ["stripping odd: released `q`", "(400, 3), expected (3, 400)"],
    "holes": ["stripping odd: released `q`", "not finite"],
    "few": ["stripping odd: `times`", "(2,), expected (400,)"],
    "nan": ["stripping odd: the release times", "today"],
    "future": ["stripping odd: the release times", "today"],
    "lazy": ["integrator lazy failed: ArithmeticError in", "Lazy.advance: too lazy"],
    "moody": ["potential moody raised LookupError: no force today"],
}


def changed(directory: Path, mode: str) -> Path:
    """Write the plugin and a run file in which one component is broken."""
    (directory / "odd.py").write_text(PLUGIN)
    text = 'plugins = ["odd.py"]\n' + RUN
    if mode == "moody":
        text = text.replace('kind = "tf"', 'kind = "moody"').replace('rs = "12 kpc"\nalpha = 0.45\n', "")
    elif mode == "lazy":
        text = text.replace("[observable]", '[integrator]\nkind = "lazy"\n[observable]')
    else:
        text = text.replace('kind = "mlcs"', f'kind = "odd"\nmode = "{mode}"')
    path = directory / "odd.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_component_is_named_by_model_and_commands(tmp_path: Path, name: str) -> None:
    path = changed(tmp_path, name)
    with pytest.raises(sk.ComponentError) as caught:
        sk.Model(sk.load(path)).stream()
    looked = call("check", path)  # says that the file is valid before it looks at the physics
    assert looked.exit_code == 2
    left = sorted(tmp_path.iterdir())
    told = [str(caught.value), refused("stream", path), refused("run", path, "-o", tmp_path / "out", "-q")]
    assert sorted(tmp_path.iterdir()) == left
    for message in (*told, looked.stderr):
        for text in BROKEN[name]:
            assert text in message
    for message in told:
        assert "Parameters: potential.v0 = 210.0 km/s, progenitor.mass = 5196152" in message


def test_the_exception_is_the_cause(tmp_path: Path) -> None:
    spec = sk.load(changed(tmp_path, "raise"))
    with pytest.raises(sk.ComponentError) as caught:
        sk.Model(spec).stream()
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ({"x": 20, "y": 0, "z": 0, "vx": 100, "vy": 0, "vz": 0}, "moves on a line through the Galactic centre"),
        ({"x": 0.001, "y": 0, "z": 0}, "passes too near the Galactic centre"),
        ({"vx": 1e9}, "passes too near the Galactic centre"),
    ],
)
def test_orbits_that_cannot_be_followed_have_a_reason(run_file: Path, place: dict[str, Any], reason: str) -> None:
    spec = sk.load(run_file).with_values({f"progenitor.{name}": value for name, value in place.items()})
    with pytest.raises(sk.OutOfDomain, match=reason):
        sk.Model(spec).stream()
    settings = [word for name, value in place.items() for word in ("--set", f"progenitor.{name}={value}")]
    assert "small.toml: there is no stream at these parameters: the prog" in refused("stream", run_file, *settings)
