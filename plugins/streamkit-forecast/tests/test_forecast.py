"""Bounds of a linear model with Gaussian errors are exact; surveys are data like those of a run file; bad input."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from astropy.table import QTable
from click.testing import CliRunner
from streamkit_forecast import forecast
from streamkit_forecast.figure import forecast_figure
from streamkit_forecast.information import product
from streamkit_forecast.surveys import read_surveys

from streamkit import Observable, OutOfDomain, Prediction, SpecError, StreamkitError, load
from streamkit.cli.main import main

RUN = """
[potential]
kind = "logarithmic_halo"
v0 = { normal = [220, 10] }
q = { uniform = [0.8, 1.0] }
[progenitor]
kind = "plummer"
mass = { log_uniform = [1e4, 1e5] }
radius = 0.03
x = 12
y = 0
z = 5
vx = 30
vy = 180
vz = 20
lookback = "0.3 Gyr"
[stripping]
kind = "mlcs"
particles = 20
sigma = 1
"""
FREE = ("potential.v0", "potential.q", "progenitor.mass")
SLOPES = np.array([[1.0, 30.0, 2.0], [-0.5, 80.0, 0.0], [0.3, -20.0, 1.0], [2.0, 10.0, -4.0]])
ERRORS = np.array([4.0, 9.0, 3.0, 6.0])
CORRELATED = np.diag(ERRORS**2) + np.outer(ERRORS, ERRORS) * 0.3 * (1 - np.eye(4))
PRIORS = np.array([10.0, 0.2 / np.sqrt(12), np.log(10) / np.sqrt(12)])


def coordinates(stream):
    v0, q, mass = (stream.parameters[name] for name in FREE)
    return np.array([v0, q, np.log(mass)])


class Linear(Observable):
    """Numbers that are linear in the parameters, and ln of the log-uniform one."""

    kind = "test_linear"

    def data(self):
        return np.array([1.0, 2.0, 3.0, np.nan, 5.0]), np.array([*ERRORS[:3], np.nan, ERRORS[3]])

    def predict(self, stream):
        mean = np.insert(SLOPES @ coordinates(stream), 3, np.nan)
        return Prediction(tuple("abcde"), mean, np.zeros(5))


class Correlated(Observable):
    """The same with errors that correlate."""

    kind = "test_correlated"

    def data(self):
        return np.zeros(4), ERRORS

    def covariance(self):
        return CORRELATED

    def predict(self, stream):
        return Prediction(tuple("abcd"), SLOPES @ coordinates(stream), np.zeros(4))


class Spread(Observable):
    """One number whose mean says nothing and whose standard deviation is v0 / 10."""

    kind = "test_spread"

    def data(self):
        return np.zeros(50), np.ones(50)

    def predict(self, stream):
        nothing = np.zeros(50)
        return Prediction(tuple(map(str, range(50))), nothing, nothing, details={"v0": stream.parameters[FREE[0]]})

    def scatter(self, prediction):
        return np.full(50, prediction.details["v0"] / 10)


class NotBelow(Observable):
    """No stream where q is below 0.88."""

    kind = "test_not_below"

    def data(self):
        return np.zeros(1), np.ones(1)

    def predict(self, stream):
        if stream.parameters[FREE[1]] < 0.88:
            raise OutOfDomain("too flat")
        return Prediction(("q",), np.array([stream.parameters[FREE[1]]]), np.zeros(1))


def spec_of(*observables):
    document = tomllib.loads(RUN)
    return load(
        document | {"observable": {each.kind: {"kind": each.kind} for each in observables}}, components=observables
    )


def bounds(found):
    return {bound.data: bound for bound in found.bounds}


def exact(covariance, repeats=1):
    """The covariance of Bayes's theorem for Gaussians, with priors of the same standard deviations."""
    information = repeats * SLOPES.T @ np.linalg.inv(covariance) @ SLOPES
    return np.linalg.inv(information + np.diag(1 / PRIORS**2))


@pytest.mark.parametrize(("observables", "covariance", "repeats"), [
    ((Linear,), np.diag(ERRORS**2), 1), ((Correlated,), CORRELATED, 1),
])  # fmt: skip
def test_bounds_of_a_linear_model_are_exact(observables, covariance, repeats):
    found = forecast(spec_of(*observables), seeds=3)
    wanted = np.sqrt(np.diag(exact(covariance, repeats)))
    names = [quantity.name for quantity in found.quantities]
    assert names[:2] == list(FREE[:2])  # a progenitor's mass is marginalised
    for data, sd in (("the stream", wanted), ("priors alone", PRIORS)):
        assert np.allclose(bounds(found)[data].sd[:2], sd[:2], rtol=1e-4)
    assert np.allclose(bounds(found)["the stream"].error, 0, atol=1e-6 * bounds(found)["the stream"].sd)


def test_observables_of_a_stream_add_up():
    both = np.linalg.inv(SLOPES.T @ np.linalg.inv(np.diag(ERRORS**2)) @ SLOPES
                         + SLOPES.T @ np.linalg.inv(CORRELATED) @ SLOPES + np.diag(1 / PRIORS**2))  # fmt: skip
    sd = bounds(forecast(spec_of(Linear, Correlated), seeds=2))["the stream"].sd
    assert np.allclose(sd[:2], np.sqrt(np.diag(both))[:2], rtol=1e-4)


def test_a_mass_has_the_bound_of_its_formula():
    found = forecast(spec_of(Linear), radii=[20.0], seeds=2)
    whole, mass = exact(np.diag(ERRORS**2)), found.quantities[2]
    assert mass.name == "M(<20 kpc)"
    # a flattened logarithmic halo has M(<r) proportional to v0^2 at a given q
    assert np.isclose(mass.slopes[0], 2 * mass.value / 220, rtol=1e-5)
    sd = np.sqrt(mass.slopes @ whole @ mass.slopes)
    assert np.isclose(bounds(found)["the stream"].sd[2], sd, rtol=1e-4)


def test_a_dispersion_tells_of_what_moves_it():
    sd = bounds(forecast(spec_of(Spread), seeds=2))["the stream"].sd[0]
    # of n numbers sigma is known to sigma / sqrt(2 n); sigma is v0 / 10
    assert np.isclose(sd, (2 * 50 / 220**2 + 1 / 10**2) ** -0.5, rtol=1e-3)


def test_steps_stay_where_there_is_a_stream():
    sd = bounds(forecast(spec_of(NotBelow), {FREE[1]: 0.9}, seeds=2))["the stream"].sd[1]
    assert np.isclose(sd, (1 + 1 / PRIORS[1] ** 2) ** -0.5, rtol=1e-3)
    with pytest.raises(
        StreamkitError, match=r"there is no stream 'stream' where the forecast is made: too flat.*--set"
    ):
        forecast(spec_of(NotBelow), {FREE[1]: 0.85})


TRACK = (
    RUN.replace("0.3 Gyr", "1.5 Gyr").replace("particles = 20", "particles = 800")
    + """
[observable]
kind = "track"
frame = { pole = [34.6, 29.7], origin = [180.0, 50.0] }
kernel = "3 deg"
[observable.radial_velocity]
phi1 = [104, 107, 110]
radial_velocity = [0, 0, 0]
error = [5, 5, 5]
"""
)
SURVEY = """
[more]
phi1 = [103, 111]
means = 4
errors = { distance = "300 pc", pm_phi2 = 0.02 }
"""


@pytest.fixture(scope="module")
def of_track():
    return load(tomllib.loads(TRACK))


@pytest.fixture(scope="module")
def with_survey(of_track, tmp_path_factory):
    path = tmp_path_factory.mktemp("surveys") / "more.toml"
    path.write_text(SURVEY)
    return forecast(of_track, surveys=read_surveys(path), seeds=4)


def test_a_survey_is_data_like_those_of_a_run_file(of_track, with_survey):
    phi1 = [104, 106, 108, 110]
    added = {
        "distance": {"phi1": phi1, "distance": [10] * 4, "error": [0.3] * 4},
        "pm_phi2": {"phi1": phi1, "pm_phi2": [0] * 4, "error": [0.02] * 4},
    }
    document = of_track.document | {"observable": of_track.document["observable"] | added}
    measured = bounds(forecast(load(document), seeds=4))["the stream"]
    planned = bounds(with_survey)
    assert np.allclose(planned["the stream with more"].sd, measured.sd, rtol=0.02)
    assert (planned["the stream with more"].sd[:2] < 0.9 * planned["the stream"].sd[:2]).any()


def test_one_more_datum_gives_what_a_fit_with_it_would(of_track, with_survey):
    gain = next(each for each in with_survey.gains if each.column == "radial_velocity")
    i = int(np.abs(gain.phi1 - 112).argmin())
    velocities = {"phi1": [104, 107, 110, gain.phi1[i]], "radial_velocity": [0] * 4, "error": [5, 5, 5, gain.error]}
    document = of_track.document | {"observable": of_track.document["observable"] | {"radial_velocity": velocities}}
    sd = bounds(forecast(load(document), seeds=4))["the stream"].sd[:2]
    assert gain.error == 5
    assert gain.sd[i, 0] < 0.98 * bounds(with_survey)["the stream"].sd[0]
    assert np.allclose(gain.sd[i, :2], sd, rtol=0.05)


def test_the_picture_has_a_bar_for_each_set_of_data_and_a_line_for_each_column(with_survey):
    figure = forecast_figure(with_survey, with_survey.quantities[0])
    bars, one_more = figure.axes
    assert [label.get_text() for label in bars.get_yticklabels()] == [each.data for each in with_survey.bounds]
    assert [bar.get_width() for bar in bars.patches] == [bound.sd[0] for bound in with_survey.bounds]
    lines = {line.get_label().partition(",")[0]: line.get_ydata() for line in one_more.lines}
    for gain in with_survey.gains:
        assert np.allclose(lines[gain.column.replace("_", " ")], gain.sd[:, 0] / with_survey.bounds[1].sd[0])


def test_an_error_that_is_alike_along_the_track_counts_with_its_covariance(of_track):
    """Its bounds are those of the same data with the same covariance, which the products of slopes have here."""
    alike = {"radial_velocity_extra_error": 8.0, "extra_error_length": "60 deg"}
    document = of_track.document | {"observable": of_track.document["observable"] | alike}
    found = forecast(load(document), seeds=3)
    slopes = found.slopes[0]
    rows = slopes.rows(lambda part: not part.added)
    phi1 = np.array([104.0, 107.0, 110.0])
    errors = slopes.variance[rows] - 64.0  # without the extra error
    whole = np.diag(errors) + 64.0 * np.exp(-(np.subtract.outer(phi1, phi1) ** 2) / (2 * 60.0**2))
    inverse, of = np.linalg.inv(whole), slopes.of_mean[:, rows]
    pairs = [of[i].T @ inverse @ of[j] for i in range(3) for j in range(3) if i != j]
    made = product(found.sources[0].white[:, : len(rows)][:, rows], range(3))
    assert np.allclose(made, np.mean(pairs, axis=0), rtol=1e-3, atol=1e-6 * np.abs(made).max())
    alone = forecast(of_track, seeds=3)
    assert bounds(found)["the stream"].sd[0] > bounds(alone)["the stream"].sd[0]


def test_a_parameter_may_be_zero():
    document = tomllib.loads(RUN)
    document["progenitor"] |= {"y": {"normal": [0, 0.1]}}
    document |= {"observable": {"kind": Linear.kind}}
    sd = bounds(forecast(load(document, components=[Linear]), seeds=2))["the stream"].sd
    assert np.allclose(sd[:2], np.sqrt(np.diag(exact(np.diag(ERRORS**2))))[:2], rtol=1e-4)


def test_no_number_of_workers_changes_a_bound(of_track):
    few = of_track.with_values({"stripping.particles": 100})
    one, two = (forecast(few, seeds=2, workers=workers) for workers in (1, 2))
    assert all(np.array_equal(a.sd, b.sd) for a, b in zip(one.bounds, two.bounds, strict=True))


def test_the_command_writes_tables_and_a_picture(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.toml").write_text(TRACK)
    Path("more.toml").write_text(SURVEY)
    done = CliRunner().invoke(
        main, ["forecast", "run.toml", "--add", "more.toml", "--seeds", "3", "--set", "potential.v0=225"]
    )
    assert done.exit_code == 0, done.stderr
    assert "the stream with more" in done.stdout
    assert "One more datum" in done.stdout
    table = QTable.read("run-forecast/forecast.ecsv")
    assert set(table["data"]) == {"priors alone", "the stream", "the stream with more"}
    assert table["value"][table["quantity"] == "potential.v0"][0] == 225
    assert len(QTable.read("run-forecast/one_more.ecsv")) == 5 * 25
    assert Path("run-forecast/forecast.png").exists()
    again = CliRunner().invoke(main, ["forecast", "run.toml"])
    assert again.exit_code == 2
    assert "holds a forecast already" in again.stderr


@pytest.mark.parametrize(("survey", "message"), [
    ("", r"there is no survey; expected sections such as \[desi\]"),
    ("stars = 3", r"found 3, expected a section \[NAME\]"),
    ("[a]\nphi1 = [0, 1]\nstars = 4", "a.errors: is missing$"),
    ("[a]\nphi = [0, 1]\nstars = 4\nerrors = { phi2 = 1 }", r"no field 'phi'. Did you mean 'phi1'\?"),
    ("[a]\nphi1 = [0, 1]\nstarz = 4\nerrors = { phi2 = 1 }", r"no field 'starz'. Did you mean 'stars'\?"),
    ("[a]\nphi1 = [0, 1]\nstars = 4\nerrors = { velocity = 1 }", r"no field 'errors.velocity'. .*radial_velocity"),
    ("[a]\nphi1 = [0, 1]\nerrors = { phi2 = 1 }", "expected either stars.*or means"),
    ("[a]\nphi1 = [0, 1]\nstars = 1\nmeans = 1\nerrors = { phi2 = 1 }", "expected either stars.*or means"),
    ("[a]\nphi1 = [1, 0]\nstars = 4\nerrors = { phi2 = 1 }", "found 1 to 0 deg; expected two longitudes"),
    ("[a]\nphi1 = [0, 1]\nstars = 4\nerrors = { phi2 = '1 kpc' }", "a.errors.phi2: .*expected a quantity in deg"),
    ("[a]\nphi1 = [0, 1]\nstars = 4\nerrors = { phi2 = -1 }", "a.errors.phi2: .*greater than 0"),
    ("[a]\nphi1 = [0, 1]\nstars = 4\nerrors = {}", "nothing is measured"),
    ("[a]\nphi1 = [-179, -150]\nstars = 4\nerrors = { phi2 = 1 }", "a: 4 of 4 longitudes have no star of the"),
    ("[a]\nstream = 'gd1'\nphi1 = [0, 1]\nstars = 4\nerrors = { phi2 = 1 }", "no stream is called 'gd1'"),
])  # fmt: skip
def test_a_survey_that_is_none_is_refused_with_its_place(of_track, tmp_path, survey, message):
    (tmp_path / "s.toml").write_text(survey)
    with pytest.raises(SpecError, match=message):
        forecast(of_track, surveys=read_surveys(tmp_path / "s.toml"))


@pytest.mark.parametrize(("arguments", "message"), [
    (["--set", "potential.q=1.0"], "potential.q: found 1, which is not inside its prior"),
    (["--radii", "10,-2"], "expected numbers above 0 and up to 1e.06 kpc"),
    (["--error", "velocity=2"], "no column is called 'velocity'"),
    (["--error", "radial_velocity=2kpc"], "--error radial_velocity: expected a quantity in .*, found '2kpc'. See"),
    (["--target", "M(<21 kpc)"], r"--target 'M\(<21 kpc\)': nothing is called so. Did you mean 'M\(<20 kpc\)'"),
])  # fmt: skip
def test_options_that_are_wrong_are_explained(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    Path("run.toml").write_text(TRACK.replace("particles = 800", "particles = 60"))
    done = CliRunner().invoke(main, ["forecast", "run.toml", "--seeds", "1", "-q", *arguments])
    assert done.exit_code == 2
    assert __import__("re").search(message, done.stderr), done.stderr


def test_an_interruption_has_its_status(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.toml").write_text(TRACK.replace("particles = 800", "particles = 60"))
    monkeypatch.setattr("streamkit_forecast.slopes.run_jobs", lambda *_: ({}, "interrupted"))
    done = CliRunner().invoke(main, ["forecast", "run.toml", "--seeds", "1", "-q"])
    assert done.exit_code == 130
    assert "interrupted before the slopes were known" in done.stderr


def test_a_run_file_without_anything_to_forecast_is_refused():
    document = tomllib.loads(RUN)
    with pytest.raises(SpecError, match="nothing is measured"):
        forecast(document)
    fixed = document | {"potential": {"kind": "logarithmic_halo", "v0": 220, "q": 0.9}}
    with pytest.raises(SpecError, match="no number of the host has a prior"):
        forecast(fixed | {"observable": tomllib.loads(TRACK)["observable"]})
