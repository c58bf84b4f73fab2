"""GD-1: the example's ln p is smooth, finds the truth of a mock, and `check` says where there is no debris."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.table import QTable
from commands import call
from documents import ROOT

import streamkit as sk

GD1 = ROOT / "examples" / "gd1" / "gd1.toml"
TRUTH = {
    "potential.v0": 224.3, "potential.q": 0.887, "progenitor.phi2": 0.088, "progenitor.distance": 8.196,
    "progenitor.pm_phi1_cosphi2": -12.84, "progenitor.pm_phi2": -2.647, "progenitor.v_los": -76.6,
    "observable.radial_velocity_dispersion": 0.0, "observable.radial_velocity_outliers": 0.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def gd1() -> sk.Spec:
    return sk.load(GD1)


def line(posterior: sk.Posterior, values: dict[str, float], name: str, width: float, n: int) -> np.ndarray:
    """(n,) ln p along a parameter, so far to either side of the values."""
    at = np.array([values[key] for key in posterior.spec.names])
    found = []
    for step in np.linspace(-width, width, n):
        theta = at.copy()
        theta[posterior.spec.names.index(name)] += step
        found.append(posterior(theta)[0])
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "width"), [("potential.q", 0.03), ("progenitor.v_los", 3.0)])
def test_ln_p_is_rough_by_less_than_a_third(gd1: sk.Spec, name: str, width: float) -> None:
    values = TRUTH | {"observable.radial_velocity_dispersion": 11.0, "observable.radial_velocity_outliers": 0.05}
    found = line(sk.Posterior(gd1), values, name, width, 21)
    u = np.linspace(-1, 1, 21)
    rest = found - np.polyval(np.polyfit(u, found, 4), u)
    assert np.sqrt((rest**2).sum() / (21 - 5)) < 0.3


def mock(gd1: sk.Spec) -> sk.Spec:
    """The data replaced by those of a stream of another seed, without errors drawn; the Sun is tied to the host."""
    inputs = gd1.with_values({"seed": 77}).bind(TRUTH)
    observable, prediction = inputs.observable, sk.Model(gd1.with_values({"seed": 77})).observe(inputs)[1]
    assert observable is not None
    assert prediction is not None
    values: dict[str, Any] = {}
    start = 0
    for name, (phi1, old, error) in observable.given.items():
        mean = prediction.mean[start : start + len(old)]
        start += len(old)
        values[f"observable.{name}"] = {"phi1": phi1.tolist(), name: mean.tolist(), "error": error.tolist()}
    return gd1.with_values(values)


def test_drawn_data_have_the_errors_that_they_state(gd1: sk.Spec) -> None:
    """Those of a mock scatter about the prediction by errors and extra dispersion: chi^2 of 57 numbers, drawn often."""
    spec = gd1.with_values({"stripping.particles": 1000, "observable.stars": []})
    inputs = spec.bind(TRUTH | {"observable.radial_velocity_dispersion": 5.0})
    prediction = sk.Model(spec).observe(inputs)[1]
    assert inputs.observable is not None
    assert prediction is not None
    rng = np.random.default_rng(0)
    fields = [inputs.observable.mock(prediction, rng) for _ in range(40)]
    drawn = [type(inputs.observable)(**(inputs.observable.model_dump() | each)).data() for each in fields]
    total = drawn[0][1] ** 2 + np.array([25.0 * name.startswith("radial") for name in prediction.names])
    chi2 = np.mean([((values - prediction.mean) ** 2 / total).mean() for values, _ in drawn])
    assert chi2 == pytest.approx(1, abs=0.1)


def test_the_truth_of_a_mock_is_the_maximum(gd1: sk.Spec) -> None:
    """Along one parameter at a time the vertex of ln p is within 0.7 of its standard deviation."""
    posterior = sk.Posterior(mock(gd1.with_values({"stripping.particles": 8000})))
    for name, width in (("potential.v0", 4.0), ("potential.q", 0.06), ("progenitor.distance", 0.15)):
        found = line(posterior, TRUTH, name, width, 9)
        a, b, _ = np.polyfit(np.linspace(-width, width, 9), found, 2)
        assert a < 0, name
        assert abs(b / (2 * a)) * np.sqrt(-2 * a) < 0.7, name


@pytest.mark.slow
def test_the_variance_is_the_scatter_of_streams(gd1: sk.Spec) -> None:
    """Without scattering by the progenitor and with independent draws; over columns, in the mean."""
    few = {"stripping.particles": 1500, "stripping.quasi_random": False, "stripping.progenitor_gravity": False}
    found = []
    for seed in range(30):
        spec = gd1.with_values(few | {"seed": seed})
        found.append(sk.Model(spec).observe(spec.bind(TRUTH))[1])
    told = np.sqrt(np.mean([p.variance for p in found], axis=0))
    ratio = told / np.std([p.mean for p in found], axis=0, ddof=1)
    assert 0.8 < np.median(ratio) < 1.4


def test_check_says_where_the_stream_has_no_debris() -> None:
    few = ("--set", "stripping.particles=500", "--draws", "0")
    result = call("check", GD1, *few, "--set", "progenitor.lookback=0.3 Gyr")
    assert result.exit_code == 0, result.output
    assert "where the stream has no debris" in " ".join(result.output.split())


@pytest.mark.slow
@pytest.mark.rendered
def test_the_particles_are_written_in_the_frame_of_the_data(tmp_path: Path) -> None:
    """The picture has a panel for every column."""
    few = ("--set", "stripping.particles=300")
    result = call("stream", GD1, *few, "-o", tmp_path / "s.ecsv", "--plot", tmp_path / "s.png")
    assert result.exit_code == 0, result.output
    table = QTable.read(tmp_path / "s.ecsv")
    stream = sk.Model(sk.load(GD1).with_values({"stripping.particles": 300})).stream()
    assert table["phi1"].value == pytest.approx(stream.seen("GD1Koposov10").lon)
    assert table["ra"].value == pytest.approx(stream.sky().ra.deg)
    assert (tmp_path / "s.png").stat().st_size > 20_000


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ("observable.frame=GD1Koposov", "Did you mean 'GD1Koposov10'"),
        ("observable.phi2=distance.ecsv", "phi2"),
        ("observable.phi2=nothing.ecsv", "nothing.ecsv"),
        ("observable.kernel=0", "observable.kernel"),
        ("observable.radial_velocity_outliers=1.5", "observable.radial_velocity_outliers"),
        ("progenitor.frame=gd1", "there is no frame 'gd1'"),
    ],
)
def test_bad_input_is_a_sentence(setting: str, text: str) -> None:
    result = call("stream", GD1, "--set", setting)
    assert result.exit_code == 2
    assert text in " ".join(result.output.split())
    assert "Traceback" not in result.output
