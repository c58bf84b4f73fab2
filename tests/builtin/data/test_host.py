"""Data that are no stream: closed forms, sums of ln L, and where they stand in a run file."""

import copy

import numpy as np
import pytest
from click.testing import CliRunner
from runfiles import APOCENTRES, FIT, error_of
from scipy.stats import multivariate_normal, norm

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import Hernquist, Kepler
from streamkit.builtin.potentials.halos import LogarithmicHalo
from streamkit.cli.main import main
from streamkit.model import Host

CURVE = {"kind": "rotation_curve", "table": {"R": [8.0, 12.0, 20.0], "v_c": [225, 221, 208], "error": [1.5, 2.0, 6.0]}}
SPEED = {"kind": "circular_velocity", "radius": "8 kpc", "v_c": ["229 km/s", "7 km/s"]}
MASS = {"kind": "enclosed_mass", "radius": 20, "mass": ["2.5e11 Msun", "0.2e11 Msun"]}
SHAPE = {"kind": "flattening", "radius": 12.5, "z": 6.7, "q": [0.95, 0.04]}


def fit(document=FIT, **data):
    return sk.load(copy.deepcopy(document) | {"data": data})


@pytest.mark.parametrize("q", [0.8, 1.0, 1.2])
def test_the_flattening_of_a_logarithmic_potential_is_its_axis_ratio(q):
    host = Host({"halo": LogarithmicHalo(v0=200, q=q)})
    found = host.flattening(np.array([12.5, 8.4, 3.0]), np.array([6.7, 16.8, -5.0]))
    np.testing.assert_allclose(found, q, rtol=1e-9)


def test_a_sphere_is_not_flattened():
    host = Host({"halo": Hernquist(mass=1e12, a=20), "core": Kepler(mass=1e10)})
    np.testing.assert_allclose(host.flattening(np.array([5.0, 30.0]), 7.0), 1.0, rtol=1e-12)


@pytest.mark.parametrize("systematic", [0.0, 0.03])
def test_each_adds_the_log_density_of_its_data(systematic):
    spec = fit(APOCENTRES, curve=CURVE | {"systematic": systematic}, sun=SPEED, inner=MASS, shape=SHAPE)
    theta = np.array([231.0, 0.33])
    plain, found = sk.Posterior(sk.load(APOCENTRES)).evaluate(theta), sk.Posterior(spec).evaluate(theta)
    host = Host(spec.bind(theta).potentials)
    radii, data = np.array(CURVE["table"]["R"]), np.array(CURVE["table"]["v_c"])
    covariance = np.diag(np.square(CURVE["table"]["error"])) + np.outer(data, data) * systematic**2
    expected = multivariate_normal.logpdf(data, host.circular_velocity(radii), covariance)
    expected += norm.logpdf(229, host.circular_velocity(np.array([8.0]))[0], 7)
    expected += norm.logpdf(2.5e11, host.mass_inside(np.array([20.0]))[0], 0.2e11)
    expected += norm.logpdf(0.95, 1.0, 0.04)  # a spherical host
    assert found.ln_likelihood - plain.ln_likelihood == pytest.approx(expected, rel=1e-9)
    names = sk.Posterior(spec).observe(theta).prediction.names
    assert names[:3] == ("leading", "trailing", "precession")  # the only stream keeps its names
    assert names[3:] == ("data.curve.v_c(8 kpc)", "data.curve.v_c(12 kpc)", "data.curve.v_c(20 kpc)",
                         "data.sun.v_c", "data.inner.mass", "data.shape.q")  # fmt: skip


def test_a_run_file_with_data_is_written_and_read_back(tmp_path):
    spec = fit(curve=CURVE, sun=SPEED)
    path = tmp_path / "data.toml"
    path.write_text(spec.toml())
    assert sk.load(path) == spec
    assert spec.with_values({"data.sun.v_c": [240, 3]}).bind_all().data["sun"].v_c == (240, 3)


@pytest.mark.slow
def test_a_fit_with_a_rotation_curve_draws_its_radii(tmp_path):
    results = sk.run(fit(curve=CURVE), tmp_path / "out", progress=False)
    assert not results.failed
    assert (tmp_path / "out" / "best_stream.png").exists()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"sun": {**SPEED, "kind": "circular_velocty"}}, "Did you mean 'circular_velocity'?"),
        ({"sun": {key: value for key, value in SPEED.items() if key != "kind"}}, "data.sun: 'kind' is missing"),
        (SPEED, "data: found a kind, expected a section [data.NAME]"),
        ({"a.b": SPEED}, "may not contain a dot"),
        ({"sun": {**SPEED, "v_c": [229, 0]}}, "the error must be positive"),
        ({"sun": 7}, "data.sun: found 7, expected a section"),
    ],
)
def test_what_is_wrong_with_data_is_said(data, words):
    found = error_of(copy.deepcopy(FIT) | {"data": data})
    assert words in found
    assert len(found.splitlines()) == 1


@pytest.mark.parametrize("command", ["check", "stream"])
def test_a_command_shows_the_data_of_the_host(tmp_path, command):
    path = tmp_path / "data.toml"
    path.write_text(fit(curve=CURVE, sun=SPEED).toml())
    said = CliRunner().invoke(main, [command, str(path)], catch_exceptions=False)
    assert said.exit_code == 0
    assert "data curve (rotation_curve)" in said.output
    assert "v_c(12 kpc)" in said.output
