"""AGAMA's potentials in streamkit: with AGAMA where it is, and with a stand-in that has its documented interface."""

import importlib.util
import pickle
import sys
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from streamkit_agama import Agama

import streamkit as sk
from streamkit.engine import build_field
from streamkit.testing import check

Q = np.random.default_rng(1).normal(size=(3, 100)) * 20  # kpc
needs_agama = pytest.mark.skipif(importlib.util.find_spec("agama") is None, reason="AGAMA is not installed")
RUN = {
    "progenitor": {
        "kind": "plummer", "mass": {"log_uniform": [1e8, "1e9 Msun"]}, "radius": 0.85,
        "x": 19.0, "y": 0.0, "z": -5.7, "vx": 176.0, "vy": 0.0, "vz": 202.0, "lookback": 2.0,
    },
    "stripping": {"kind": "mlcs", "particles": 100, "sigma": 10.0},
}  # fmt: skip
HALO = {"kind": "agama", "type": "NFW", "mass": {"log_uniform": ["2e11 Msun", "1e12 Msun"]}, "scaleRadius": "16 kpc"}


def made(**section):
    return Agama.for_section(section)(**section)


def loaded(**potential):
    return sk.load(RUN | {"potential": potential}, components=[Agama])


class StandIn:
    """A test double for agama.Potential: an NFW halo, whose mass may grow, that looks at what it is given."""

    def __init__(self, file=None, gamma=0.0, **given):
        if file is not None:
            given = dict(line.split("=") for line in Path(file).read_text().splitlines() if "=" in line)
        if given["type"] != "NFW":
            raise ValueError(f"Unknown potential type {given['type']}")
        self.mass, self.scale, self.rate = float(given["mass"]), float(given["scaleRadius"]), gamma

    def _parts(self, points, t):
        assert points.shape[-1] == 3
        assert isinstance(t, float)
        r = np.sqrt((points**2).sum(axis=-1))
        return r, sk.G * self.mass * (1 + self.rate * t)

    def force(self, points, t=0.0):
        r, gm = self._parts(points, t)
        return -(gm * (np.log1p(r / self.scale) - r / (r + self.scale)) / r**3)[..., None] * points

    def potential(self, points, t=0.0):
        r, gm = self._parts(points, t)
        return -gm * np.log1p(r / self.scale) / r


@pytest.fixture
def stand_in(monkeypatch):
    units = {}
    one = SimpleNamespace(setUnits=units.update, setNumThreads=lambda n: nullcontext(), Potential=StandIn)
    monkeypatch.setitem(sys.modules, "agama", one)
    return units


def nfw(mass=5e11, rs=16.0, gravity=sk.G):
    r = np.sqrt((Q**2).sum(axis=0))
    return -gravity * mass * (np.log1p(r / rs) - r / (r + rs)) / r**3 * Q


def same_as_formula(gravity=sk.G):
    potential = made(type="NFW", mass="5e11 Msun", scaleRadius="16 kpc", expansion="none")
    assert np.allclose(build_field([potential]).acceleration(0.0, Q), nfw(gravity=gravity), rtol=1e-10)
    expanded = made(type="NFW", mass="5e11 Msun", scaleRadius="16 kpc")
    assert np.allclose(build_field([expanded.in_loop()]).acceleration(0.0, Q), nfw(), rtol=1e-3)
    depth = type(potential).potential(*Q, 0.0, *potential.in_engine_units())
    r = np.sqrt((Q**2).sum(axis=0))
    assert np.allclose(depth, -gravity * 5e11 * np.log1p(r / 16.0) / r, rtol=1e-10)


@needs_agama
def test_agamas_nfw_is_the_formula():
    """With AGAMA's own constant of gravity, which has more digits than streamkit's."""
    import agama

    agama.setUnits(length=1, velocity=1, mass=1)
    assert pytest.approx(sk.G, rel=2e-10) == agama.G
    same_as_formula(agama.G)


@needs_agama
def test_agama_passes_the_conformance_tests():
    check(Agama)


SECTIONS = {
    "Spheroid": {"mass": 1e12, "scaleRadius": 15.0, "outerCutoffRadius": 250.0, "gamma": 1.0, "beta": 3.0,
                 "axisRatioZ": 0.8},
    "MiyamotoNagai": {"mass": 6e10, "scaleRadius": 3.0, "scaleHeight": 0.3},
    "Disk": {"surfaceDensity": 1e9, "scaleRadius": 3.0, "scaleHeight": -0.3},
    "Logarithmic": {"v0": 220.0, "scaleRadius": 5.0, "axisRatioZ": 0.9},
    "Multipole": {"density": "Spheroid", "mass": 1e12, "scaleRadius": 15.0, "gamma": 1.0, "beta": 4.0, "lmax": 8},
}  # fmt: skip


@needs_agama
@pytest.mark.parametrize("name", SECTIONS)
def test_a_section_has_the_force_of_agamas_own_potential(name):
    import agama

    potential = made(type=name, **SECTIONS[name], expansion="none")
    force = build_field([potential]).acceleration(0.0, Q)
    assert np.array_equal(force, agama.Potential(type=name, **SECTIONS[name]).force(Q.T).T)
    assert pickle.loads(pickle.dumps(potential)) == potential


@needs_agama
def test_a_file_of_agamas_export(tmp_path):
    import agama

    agama.setUnits(length=1, velocity=1, mass=1)
    whole, plain = tmp_path / "whole.ini", tmp_path / "plain.ini"
    spheroid = agama.Potential(type="Spheroid", **SECTIONS["Spheroid"])
    spheroid.export(str(whole))
    force = build_field([made(file=str(whole), expansion="none")]).acceleration(0.0, Q)
    assert np.allclose(force, spheroid.force(Q.T).T, rtol=1e-6)
    agama.Potential(type="Plummer", mass=1e10, scaleRadius=1.0).export(str(plain))
    with pytest.raises(sk.StreamkitError, match="left out the parameters"):
        made(file=str(plain)).in_engine_units()


@needs_agama
def test_workers_do_not_wait_for_threads_of_their_parent():
    """Threads of OpenMP that a process has started do not exist in its forks."""
    potential = made(type="NFW", mass=5e11, scaleRadius=16, expansion="none")
    field = build_field([potential])
    q = np.repeat(Q, 50, axis=1)
    there = field.acceleration(0.0, q)
    with ProcessPoolExecutor(1, mp_context=get_context("fork")) as workers:
        here = workers.submit(_force, potential).result(timeout=60)
    assert np.array_equal(here, there)


def _force(potential):
    return build_field([potential]).acceleration(0.0, np.repeat(Q, 50, axis=1))


def test_the_interface_is_used_as_documented(stand_in):
    same_as_formula()
    assert stand_in == {"length": 1, "velocity": 1, "mass": 1}


def test_each_time_is_asked_for(stand_in):
    potential = made(type="NFW", mass=5e11, scaleRadius=16, gamma=0.2)
    t = np.repeat([0.0, -1.0], 50)
    result = np.array(type(potential).acceleration(*Q, t, *potential.in_engine_units()))
    assert np.allclose(result, nfw() * (1 + 0.2 * t), rtol=1e-12)


def test_an_ini_file_and_its_content_belong_to_the_run(stand_in, tmp_path):
    file = tmp_path / "halo.ini"
    file.write_text("[Potential]\ntype=NFW\nmass=5e11\nscaleRadius=16\n")
    one = loaded(kind="agama", file=str(file))
    (potential,) = one.bind().potentials.values()
    result = np.array(type(potential).acceleration(*Q, 0.0, *potential.in_engine_units()))
    assert np.allclose(result, nfw(), rtol=1e-12)
    file.write_text("[Potential]\ntype=NFW\nmass=6e11\nscaleRadius=16\n")
    assert loaded(kind="agama", file=str(file)).digest() != one.digest()
    file.write_text("[Potential]\nfile=coefficients.ini\n")
    with pytest.raises(sk.StreamkitError, match="names another file"):
        made(file=str(file)).in_engine_units()


def test_priors_pickle_and_stream(stand_in):
    spec = loaded(**HALO)
    assert "potential.mass" in spec.names
    assert pickle.loads(pickle.dumps(spec)).digest() == spec.digest()
    assert np.isfinite(sk.Model(spec).stream().q).all()


BAD = {
    "parameter": (HALO | {"scaleradius": 1}, "AGAMA has no parameter 'scaleradius'. Did you mean 'scaleRadius'?"),
    "unit": (HALO | {"scaleRadius": "8 km/s"}, "potential.scaleRadius: expected a quantity in kpc"),
    "neither": ({"kind": "agama"}, "expected either type"),
    "both": (HALO | {"file": "a.ini"}, "expected either type"),
    "gone": ({"kind": "agama", "file": "gone.ini"}, "gone.ini"),
}


@pytest.mark.parametrize(("section", "told"), BAD.values(), ids=BAD)
def test_bad_input_is_told(section, told):
    with pytest.raises(sk.SpecError) as caught:
        loaded(**section)
    assert told in str(caught.value)


def test_an_unknown_type_is_no_stream(stand_in):
    with pytest.raises(sk.OutOfDomain, match="Unknown potential type NWF"):
        made(type="NWF", mass=1e11).in_engine_units()


def test_without_agama(monkeypatch):
    monkeypatch.setitem(sys.modules, "agama", None)
    with pytest.raises(sk.StreamkitError, match=r"AGAMA cannot be imported.*pip install agama"):
        made(type="NFW", mass=1e11, scaleRadius=16).in_engine_units()
