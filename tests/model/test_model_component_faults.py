"""What a plugin may do wrong inside a method: it is named, and it spoils nothing for the next stream."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runfiles import RUN

import streamkit as sk
from streamkit.engine import build_field
from streamkit.model import Host, next_apocentre
from streamkit.sample import Posterior

PLUGIN = '''
from typing import Any
import numpy as np
from pydantic import Field
from streamkit import Integrator, Number, Observable, OutOfDomain, Potential, Prediction, Release, Stripping, hookimpl

class Bad(BaseException):
    """No Exception."""

class Scheme(Stripping):
    """At the progenitor."""
    kind = "scheme"
    draws = 3

    def times(self, orbit: Any) -> Any:
        {times}
        return super().times(orbit)

    def release(self, orbit: Any, tail: Any, mass: Any, normals: Any) -> Any:
        {release}
        return Release(orbit.q, orbit.v + normals)

class Watch(Observable):
    """The mean distance."""
    kind = "watch"

    def data(self) -> Any:
        return np.array([40.0]), np.array([1.0])

    def predict(self, stream: Any) -> Any:
        mean, variance = np.array([stream.r.mean()]), np.array([0.1])
        {predict}
        return Prediction(("mean",), mean, variance)

class Push(Potential):
    """No force."""
    kind = "push"
    compiled = False
    strength: Number = Field(default=0.0, description="None.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, strength: Any) -> Any:
        {acceleration}
        return 0 * x, 0 * y, 0 * z

class Carry(Integrator):
    """Straight on."""
    kind = "carry"
    order = 1

    def advance(self, field: Any, q: Any, v: Any, t0: Any, t1: float) -> None:
        {advance}
        q += v * (t1 - t0)

@hookimpl
def streamkit_components() -> Any:
    return [Scheme, Watch, Push, Carry]
'''
NAMES = {
    "times": "stripping scheme",
    "release": "stripping scheme",
    "predict": "observable watch",
    "acceleration": "potential push",
    "advance": "integrator carry",
}


def model_with(directory: Path, method: str, code: str) -> sk.Model:
    """Return a model in which one method of a plugin begins with some code."""
    fill = dict.fromkeys(NAMES, "pass") | {method: code}
    text = PLUGIN
    for name, line in fill.items():
        text = text.replace(f"{{{name}}}", line)
    (directory / "faulty.py").write_text(text)
    before, after = RUN.split("[progenitor]")
    host = before.replace("[potential]", "[potential.host]") + '[potential.push]\nkind = "push"\n'
    rest = after.replace('kind = "mlcs"', 'kind = "scheme"').split("[observable]")[0]
    end = '[observable]\nkind = "watch"\n[integrator]\nkind = "carry"\n'
    run = f'plugins = ["faulty.py"]\n{host}[progenitor]{rest}{end}'
    (directory / "faulty.toml").write_text(run)
    return sk.Model(sk.load(directory / "faulty.toml"))


def observe(model: sk.Model) -> Any:
    """Return what a fit's call would compute."""
    return model.observe(model.spec.bind())[1]


@pytest.mark.parametrize(
    ("method", "code"),
    [
        ("release", "orbit.q[0] = 0"),
        ("times", "orbit.t[:] = 0"),
        ("predict", "stream.q[:] = 0"),
        ("acceleration", "x -= 1"),
        *(
            pytest.param(method, code, marks=pytest.mark.slow)
            for method, code in (
                ("release", "normals *= 2"),
                ("release", "orbit.r_tidal[:] = 1"),
                ("release", "orbit.r[:] = 1"),
                ("release", "orbit.frame[0][:] = 1"),
                ("release", "tail *= -1"),
                ("times", "orbit.at(orbit.t).v[:] = 0"),
                ("predict", "stream.winding -= 1"),
                ("predict", "stream.r[:] = 0"),
                ("predict", "stream.orbit.q[:] = 0"),
                ("acceleration", "t[:] = 0"),
            )
        ),
    ],
)
def test_an_input_changed_in_place_is_refused_and_the_component_named(tmp_path: Path, method: str, code: str) -> None:
    model = model_with(tmp_path, method, code)
    before = model.normals.copy()
    with pytest.raises(sk.ComponentError, match=f"{NAMES[method]} .*ValueError.*read-only"):
        observe(model)
    assert np.array_equal(model.normals, before)


@pytest.mark.parametrize("method", ["times", "release", "advance", "predict", "acceleration"])
@pytest.mark.parametrize(
    "code", ["raise Bad('no')", pytest.param("raise ZeroDivisionError('no')", marks=pytest.mark.slow)]
)
def test_whatever_a_component_raises_is_a_component_error(tmp_path: Path, method: str, code: str) -> None:
    model = model_with(tmp_path, method, code)
    with pytest.raises(sk.ComponentError, match=f"{NAMES[method]} .*(Bad|ZeroDivisionError).*: no"):
        observe(model)


@pytest.mark.parametrize("method", NAMES)
def test_ctrl_c_in_a_component_is_ctrl_c(tmp_path: Path, method: str) -> None:
    model = model_with(tmp_path, method, "raise KeyboardInterrupt")
    with pytest.raises(KeyboardInterrupt):
        observe(model)


@pytest.mark.parametrize(
    ("code", "wanted"),
    [
        ("mean = mean + 0j", "complex"),
        ("variance = variance + 1j", "complex"),
        ("mean *= np.inf", "usable"),
        ("variance *= np.nan", "usable"),
        ("variance *= np.inf", "usable"),
        ("variance -= 1", "usable"),
    ],
)
def test_a_prediction_is_made_of_finite_real_numbers(tmp_path: Path, code: str, wanted: str) -> None:
    with pytest.raises(sk.ComponentError, match=f"observable watch: predicted .*{wanted}"):
        observe(model_with(tmp_path, "predict", code))


@pytest.mark.parametrize("method", NAMES)
def test_out_of_domain_from_any_component_is_a_counted_reason(tmp_path: Path, method: str) -> None:
    posterior = Posterior(model_with(tmp_path, method, "raise OutOfDomain('nothing is there')").spec)
    found = posterior.evaluate(posterior.spec.centre())
    assert (found.lnp, found.reason) == (-np.inf, "nothing is there")


@pytest.mark.slow
def test_the_times_that_a_force_is_asked_for(tmp_path: Path) -> None:
    """As the manual for plugins says: from the look-back time to today, and 6 Gyr ahead if no apocentre comes."""
    model = model_with(tmp_path, "acceleration", "ASKED.update((t.min(), t.max())); return 1e3 * x, 1e3 * y, 1e3 * z")
    potential = model.spec.bind().potentials["push"]
    asked = vars(sys.modules[type(potential).__module__]).setdefault("ASKED", set())
    host = Host({"push": potential})
    assert next_apocentre(host, model.spec.bind()) is None  # pushed outwards for ever
    assert (min(asked), max(asked)) == (0.0, pytest.approx(6 * sk.GYR))
    asked.clear()
    build_field([potential]).orbit(np.array([20.0, 0, 0]), np.array([0, 200.0, 0]), 0.0, -3.77 * sk.GYR, 0.002 * sk.GYR)
    assert (min(asked), max(asked)) == (pytest.approx(-3.77 * sk.GYR), 0.0)
