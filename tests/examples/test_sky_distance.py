"""The manual's observable on the sky: closed forms, another library's likelihood, a run file and its picture."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import call
from runfiles import BASE
from scipy.stats import norm

import streamkit as sk
from streamkit.testing.streams import example_stream, select

FILE = Path(__file__).with_name("sky_distance.py")
PHI1 = [-20.0, 0.0, 25.0]
VALUE = [16.0, 21.0, 23.0]
ERROR = [1.0, 0.5, 2.0]
TABLE = {"phi1": PHI1, "distance": VALUE, "error": ERROR}


@pytest.fixture
def observable(monkeypatch):
    monkeypatch.syspath_prepend(FILE.parent)
    from sky_distance import SkyDistance

    return SkyDistance(frame="GD1Koposov10", table=TABLE, outliers=0.1)


def stream_on_a_line(slope: float = 0.1, start: float = 20.0) -> sk.Stream:
    """A stream at latitude zero, evenly along phi1, whose distance grows by the slope in kpc per degree."""
    stream = select(example_stream(), slice(0, 2001))
    phi1 = np.linspace(-100, 100, 2001)
    q = sk.place_on_sky(phi1, np.zeros(2001), start + slope * phi1, sk.sky_matrix("GD1Koposov10"))
    return replace(stream, q=q, bound=np.zeros(2001, dtype=bool))


def test_the_mean_of_an_even_line_is_the_line(observable):
    """The kernel is even, so the mean of a straight line under it is the line."""
    prediction = observable.predict(stream_on_a_line())
    assert prediction.mean == pytest.approx([18.0, 20.0, 22.5], abs=1e-6)
    # Sum w^2 = 1 / (2 sqrt(pi) density kernel), and the line's variance under the squared kernel is half of (0.1 k)^2.
    expected = (0.1 * 5.0) ** 2 / 2 / (2 * np.sqrt(np.pi) * 10.0 * 5.0)
    assert prediction.variance == pytest.approx(np.full(3, expected), rel=1e-4)


def test_the_likelihood_is_the_mixture(observable):
    prediction = observable.predict(stream_on_a_line())
    value, error = np.array(VALUE), np.array(ERROR)
    for add_noise in (False, True):
        variance = error**2 + add_noise * prediction.variance
        member = norm.pdf(value, prediction.mean, np.sqrt(variance))
        outlier = norm.pdf(value, value.mean(), np.sqrt(variance + value.var()))
        expected = np.log(0.9 * member + 0.1 * outlier).sum()
        assert observable.ln_likelihood(prediction, add_noise) == pytest.approx(expected, rel=1e-12)


def test_a_far_outlier_costs_no_more_than_the_background_says(observable):
    """With a datum 100 errors off a Gaussian would fall by 5000; the mixture is the background's density there."""
    prediction = observable.predict(stream_on_a_line(start=120.0))
    assert observable.ln_likelihood(prediction, False) > -30


def test_the_radii_are_those_of_the_data(observable):
    """Law of cosines with the Sun at 8 kpc: the closest possible radius is the difference, the farthest the sum."""
    radii = observable.radii()
    assert 16.0 - 8.3 < radii["innermost datum"] <= radii["outermost datum"] < 23.0 + 8.3


def test_mock_data_scatter_by_their_errors(observable):
    rng = np.random.default_rng(1)
    prediction = observable.predict(stream_on_a_line())
    drawn = np.array([observable.mock(prediction, rng)["table"]["distance"] for _ in range(4000)])
    assert drawn.mean(axis=0) == pytest.approx(prediction.mean, abs=0.1)
    assert drawn.std(axis=0) == pytest.approx(ERROR, rel=0.05)


def test_a_frame_that_does_not_exist_is_an_error_of_the_run_file():
    document = (
        {"plugins": [str(FILE)]} | BASE | {"observable": {"kind": "sky_distance", "frame": "GD2", "table": TABLE}}
    )
    with pytest.raises(sk.SpecError, match=r"observable\.frame.*GD1Koposov10"):
        sk.load(document)


@pytest.mark.rendered
def test_a_run_file_with_it_makes_a_stream_and_a_picture(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    table = TABLE | {"phi1": [-40.0, -30.0, -20.0]}
    section = {"kind": "sky_distance", "frame": "galactic", "table": table, "kernel": 30.0}
    spec = sk.load({"plugins": [str(FILE)]} | BASE | {"observable": section})
    centre = dict(zip(spec.names, spec.centre().tolist(), strict=True)) | {"progenitor.lookback": 2.0}
    Path("run.toml").write_text(spec.with_values(centre | {"stripping.particles": 500}).toml())
    result = call("stream", "run.toml", "--plot", "picture.png")
    assert result.exit_code == 0, result.output
    assert Path("picture.png").stat().st_size > 10_000
