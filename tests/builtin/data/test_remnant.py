"""The remnant as data: the dispersion and the mass of a Plummer sphere that nothing disturbs."""

from dataclasses import replace

import numpy as np
import pytest

import streamkit as sk
from streamkit.builtin.data.remnant import RemnantData

MASS, RADIUS = 6.4e8, 0.85


@pytest.fixture(scope="module")
def isolated():
    """A live satellite far from a host of no weight."""
    stream = sk.Model(
        sk.load(
            {
                "seed": 1,
                "potential": {"kind": "kepler", "mass": 1e7},
                "progenitor": {
                    "kind": "plummer", "mass": MASS, "radius": RADIUS, "x": 300.0, "y": 0.0, "z": 0.0, "vx": 0.0,
                    "vy": 0.3, "vz": 0.0, "lookback": 1.0,
                },
                "stripping": {"kind": "restricted_nbody", "particles": 8000},
            }
        )
    ).stream()  # fmt: skip
    bound = stream.bound.copy()
    bound[np.argmax(stream.r)] = False  # debris there must be
    return replace(stream, bound=bound)


def test_dispersion_is_that_of_the_virial_theorem(isolated):
    """<v^2> = 3 pi G M / (32 a) for a Plummer sphere, a third of it along any line."""
    prediction = RemnantData(mass=(MASS, 1e7), dispersion=(10.0, 1.0)).predict(isolated)
    assert prediction.names == ("mass", "dispersion")
    assert prediction.mean[0] == pytest.approx(MASS, rel=0.01)
    assert prediction.mean[1] == pytest.approx(np.sqrt(np.pi * sk.G * MASS / (32 * RADIUS)), rel=0.02)
    assert 0 < prediction.variance[1] < 0.1


def test_only_the_heavy_particles_count(isolated):
    inner = np.sqrt(((isolated.q - isolated.orbit.q[:, -1:]) ** 2).sum(axis=0)) < 0.5 * RADIUS
    weight = np.where(inner, 1.0, 1e-9)
    stars = replace(isolated, weight=weight / weight.mean())
    every, few = (RemnantData(dispersion=(10.0, 1.0)).predict(s).mean[1] for s in (isolated, stars))
    assert few == pytest.approx(np.sqrt(sk.G * MASS / (6 * RADIUS) / np.sqrt(1 + 0.14)), rel=0.05)
    assert few > 1.1 * every


def test_no_value_where_nothing_is_left(isolated):
    gone = replace(isolated, bound=np.zeros(len(isolated), dtype=bool))
    prediction = RemnantData(mass=(MASS, 1e7)).predict(gone)
    assert prediction.why_not == "too few particles of the progenitor are still bound"


def test_data_and_mock_hold_what_is_given(isolated):
    observable = RemnantData(dispersion=(11.0, 2.0))
    values, errors = observable.data()
    assert np.isnan(values[0])
    assert (values[1], errors[1]) == (11.0, 2.0)
    assert set(observable.mock(observable.predict(isolated), np.random.default_rng(1))) == {"dispersion"}
    assert RemnantData().remarks(observable.predict(isolated))
