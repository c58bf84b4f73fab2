"""Data on the host in a calibration: they are drawn anew about each truth, or refused."""

import numpy as np
import pytest
from click.testing import CliRunner
from itself import itself
from scipy.stats import norm

import streamkit as sk
from streamkit.builtin.data.host import CircularVelocity, EnclosedMass, Flattening, RotationCurve
from streamkit.builtin.data.host_likelihood import EXAMPLE
from streamkit.cli.main import main
from streamkit.study.calibration import write_mocks
from streamkit.study.calibration.mocks import draw_mock

MEAN, SD = 220.0, 15.0
ERROR = np.array([8.0, 12.0, 20.0])
CURVE = {"kind": "rotation_curve", "table": {"R": [6.0, 10.0, 20.0], "v_c": [300.0] * 3, "error": ERROR.tolist()}}
NOTHING_LIKE_IT = {"kind": "circular_velocity", "radius": "8 kpc", "v_c": ["300 km/s", "10 km/s"]}  # of MEAN and SD


def host(**data):
    """Return a run file without a stream: v_c of its host is v0 everywhere, so its posterior has a closed form."""
    potential = {"kind": "logarithmic_halo", "v0": {"normal": [MEAN, SD]}, "q": 1.0}
    return sk.load({"potential": potential, "data": data, "sampler": {"kind": "emulator"}})


def exact_rank(truth, mock):
    """Return the share of the posterior of v0 below the truth: prior and noise are Gaussian, and all data are v0."""
    inverse = np.linalg.inv(np.diag(mock.errors**2) if mock.covariance is None else mock.covariance)
    precision = inverse.sum() + SD**-2
    mean = ((inverse @ mock.values).sum() + MEAN / SD**2) / precision
    return norm.cdf((truth[0] - mean) * precision**0.5)


@pytest.mark.parametrize("systematic", [0.0, 0.05])
def test_the_intervals_of_the_exact_posterior_hold_the_truth_as_often_as_they_say(systematic):
    """With the real velocities of 300 km/s in place of mock data, they would hold hardly any truth."""
    spec = host(curve=CURVE | {"systematic": systematic}, sun=NOTHING_LIKE_IT)
    ranks = np.array([exact_rank(*draw_mock(spec, spec, index)) for index in range(150)])
    within = np.abs(ranks - 0.5)
    assert (within < 0.34).mean() == pytest.approx(0.68, abs=0.095)  # 2.5 sd of 150 draws
    assert (within < 0.475).mean() == pytest.approx(0.95, abs=0.045)
    assert ranks.mean() == pytest.approx(0.5, abs=0.06)


def test_data_of_a_stream_and_of_its_host_are_both_drawn(tmp_path):
    plugin = itself(tmp_path)
    spec = sk.load({**plugin.document, "data": {"sun": NOTHING_LIKE_IT}})
    drawn = [draw_mock(spec, spec, index) for index in range(4)]
    for index, (theta, mock) in enumerate(drawn):
        assert mock.names == ("speed", "data.sun.v_c")
        assert mock.spec.document["data"]["sun"]["v_c"][0] == mock.values[1]
        alone = draw_mock(plugin, plugin, index)[1]
        assert theta[0] == draw_mock(plugin, plugin, index)[0][0]
        assert mock.values[0] == alone.values[0]  # the data of the stream are those without the section
    assert len({mock.values[1] for _, mock in drawn}) == 4
    assert {mock.errors[1] for _, mock in drawn} == {10.0}


@pytest.mark.parametrize(
    ("cls", "values"),
    [(CircularVelocity, [229.0]), (EnclosedMass, [3e11]), (Flattening, [0.9]), (RotationCurve, [231.0, 220.0, 180.0])],
)
def test_mock_data_scatter_about_the_model_by_their_errors(cls, values):
    example = cls(**cls.example)
    prediction = sk.Prediction(("",) * len(values), np.array(values), np.zeros(len(values)))
    rng = np.random.default_rng(1)
    drawn = [cls(**cls.example | example.mock(prediction, rng)).data() for _ in range(600)]
    errors = example.data()[1]
    scores = (np.array([value for value, _ in drawn]) - values) / errors
    assert np.abs(scores.mean(axis=0)).max() < 0.13  # 3 sd of 600 draws
    assert scores.std(axis=0) == pytest.approx(np.ones(len(values)), abs=0.1)
    assert all(np.array_equal(error, errors) for _, error in drawn)


def test_velocities_with_an_error_of_their_scale_scatter_together():
    curve = RotationCurve(table=RotationCurve.example["table"] | {"error": [1e-6] * 3}, systematic=0.1)
    prediction = sk.Prediction(("",) * 3, np.full(3, 200.0), np.zeros(3))
    rng = np.random.default_rng(2)
    drawn = np.array([curve.mock(prediction, rng)["table"]["v_c"] for _ in range(400)])
    assert np.ptp(drawn, axis=1).max() < 1e-4
    assert drawn[:, 0].std() == pytest.approx(20.0, rel=0.1)


def test_the_likelihood_of_a_stream_cannot_be_drawn(tmp_path):
    document = host(sun=NOTHING_LIKE_IT).document
    document["potential"] = {"kind": "tf", "v0": {"uniform": [200, 250]}, "rs": {"uniform": [12, 18]}, "alpha": 0.5}
    spec = sk.load(document | {"data": {"gd1": {"kind": "host_likelihood", "table": str(EXAMPLE)}}})
    text = r"data\.gd1: a host_likelihood cannot be drawn anew: .* the data of example.*Give the stream itself.*leave "
    with pytest.raises(sk.StreamkitError, match=text + r"\[data\.gd1\] out of the run file"):
        write_mocks(spec, tmp_path, 1)
    (tmp_path / "run.toml").write_text(spec.toml())
    done = CliRunner().invoke(main, ["calibrate", str(tmp_path / "run.toml"), "-o", str(tmp_path / "out")])
    assert done.exit_code != 0
    assert "[data.gd1] out of the run file" in " ".join(done.output.split())


def test_noise_beyond_zero_is_told():
    spec = host(sun=NOTHING_LIKE_IT | {"v_c": ["300 km/s", "5000 km/s"]})
    with pytest.raises(sk.StreamkitError, match=r"draw \d: its mock data .*data\.sun\.v_c.*expected a positive number"):
        [draw_mock(spec, spec, index) for index in range(9)]


def test_a_truth_without_the_data_is_refused():
    spec = host(sun=NOTHING_LIKE_IT)
    with pytest.raises(sk.StreamkitError, match=r"the truth needs a section data\.sun as the fit has it"):
        draw_mock(spec, host(curve=CURVE), 0)


def test_a_truth_without_free_parameters_gives_data_that_scatter_about_it():
    spec, n = host(sun=NOTHING_LIKE_IT), 100
    fixed = spec.with_values({"potential.v0": "180 km/s"})
    assert not fixed.names
    data = [draw_mock(spec, fixed, index)[1].values[0] for index in range(n)]
    assert np.mean(data) == pytest.approx(180.0, abs=3 * 10.0 / n**0.5)
    assert np.std(data) == pytest.approx(10.0, rel=0.25)
