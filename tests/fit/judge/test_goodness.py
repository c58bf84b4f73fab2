"""Goodness of fit: residuals and p-values against closed forms and replicated data, and bad fits that are seen."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2, kstest, multivariate_normal, norm

import streamkit as sk
from streamkit.builtin.observables.track.likelihood import Side, mixture_residuals
from streamkit.components import DO_NOT, FINE, LOOK
from streamkit.fit import describe_results
from streamkit.fit.judge import verdicts as rules
from streamkit.fit.judge.goodness import Fitted, Goodness, Measured
from streamkit.fit.samples.tables import goodness_table
from streamkit.observe import ln_likelihood_of_each, new_data, residuals_of
from streamkit.stream import Data


def fitted(residuals, samples=(), name="radial_velocity", best=None):
    residuals = np.asarray(residuals, dtype=float)
    names = tuple(f"{name} at {i}" for i in range(len(residuals)))
    square = float((residuals**2).sum()) if best is None else best
    return Fitted(name, names, residuals, square, np.asarray(samples, dtype=float))


def alone(fit):
    return Goodness((fit,), fit)


def test_without_outliers_the_score_is_the_residual():
    value, mean, variance = np.array([1.0, -3.0, 50.0]), np.array([0.0, 1.0, 2.0]), np.array([1.0, 4.0, 9.0])
    found = mixture_residuals(Side(value, variance, mean, np.zeros(3), 0.0, (0.0, 1.0)))
    np.testing.assert_allclose(found, [1.0, -2.0, 16.0])


def test_missing_debris_adds_to_the_square_what_it_takes_from_ln_l():
    found = mixture_residuals(Side(np.array([2.0]), np.ones(1), np.zeros(1), np.array([-3.0]), 0.0, (0.0, 1.0)))
    assert found[0] ** 2 == pytest.approx(2.0**2 + 2 * 3.0)


def test_scores_of_a_mixture_are_those_of_its_distribution():
    f, (centre, width) = 0.2, (1.0, 8.0)
    value = np.linspace(-20, 20, 41)
    found = mixture_residuals(Side(value, np.full(41, 2.25), np.full(41, -1.0), np.zeros(41), f, (centre, width)))
    below = (1 - f) * norm.cdf(value, -1.0, 1.5) + f * norm.cdf(value, centre, width)
    np.testing.assert_allclose(found, norm.ppf(below), rtol=1e-9, atol=1e-9)
    far = mixture_residuals(Side(np.array([500.0]), np.ones(1), np.zeros(1), np.zeros(1), f, (centre, width)))
    assert np.isfinite(far[0])  # where the distribution function is 1 to all digits
    assert far[0] > 50


def test_scores_of_data_drawn_from_the_mixture_are_standard_normal():
    rng = np.random.default_rng(8)
    n, f = 20000, 0.3
    value = np.where(rng.random(n) < f, rng.normal(5, 10, n), rng.normal(0, 1, n))
    found = mixture_residuals(Side(value, np.ones(n), np.zeros(n), np.zeros(n), f, (5.0, 10.0)))
    assert kstest(found, "norm").pvalue > 0.01


def test_the_p_value_is_that_of_replicated_data():
    """Gelman, Meng & Stern 1996, section 2.3: the share of replicated data that lie farther from their own model."""
    rng = np.random.default_rng(3)
    mean = np.array([1.0, 1.5]) + 0.1 * rng.standard_normal((4000, 2))
    squares = (mean**2).sum(axis=1)  # of data 0 +- 1
    farther = (rng.standard_normal(mean.shape) ** 2).sum(axis=1) > squares
    found = fitted([1.0, 1.5], squares)
    assert found.p_value == pytest.approx(farther.mean(), abs=0.02)
    assert found.p_value == pytest.approx(chi2.sf(3.25, 2), abs=0.02)


def test_a_covariance_counts():
    """Data with a correlation of 0.9: a common shift is likely, an opposite one is not."""
    data = Data(np.zeros(2), np.ones(2), covariance=np.array([[1, 0.9], [0.9, 1]]))
    rows = np.arange(2)
    plain = SimpleNamespace(role="observable", kind="plain", residuals=lambda *_: None, ln_likelihood=lambda *_: None)
    for sign, expected in ((1, 2 * 4 / 1.9), (-1, 2 * 4 / 0.1)):
        prediction = sk.Prediction(("a", "b"), np.array([2.0, 2.0 * sign]), np.zeros(2))
        one = Measured("", plain, data, prediction)
        assert one.square(rows) == pytest.approx(expected)
        assert one.square(rows[:1]) == pytest.approx(4.0)


def test_27_velocities_with_a_chi2_of_105_are_no_fit():
    """The velocities of GD-1 with their errors as they are, among 60 data that fit."""
    rng = np.random.default_rng(1)
    bad = rng.standard_normal(27)
    bad *= np.sqrt(105 / (bad**2).sum())
    velocities, others = fitted(bad), fitted(rng.standard_normal(60), name="phi2")
    whole = fitted(np.concatenate([bad, others.residuals]), name="all data")
    found = rules.goodness_verdict(Goodness((others, velocities), whole))
    assert found.level == DO_NOT
    assert "does not fit radial_velocity" in found.sentence
    assert found.value.startswith("chi^2 = 105 of 27 data")


def test_a_quantity_is_judged_with_allowance_for_their_number():
    quantities = tuple(fitted([2.2], name=f"q{i}") for i in range(10))
    whole = fitted(np.full(10, 0.1), name="all data")
    assert quantities[0].p_value < 0.05
    found, p = Goodness(quantities, whole).least
    assert p == pytest.approx(1 - (1 - quantities[0].p_value) ** 10)
    assert found.name.startswith("q")


@pytest.mark.parametrize(("far", "level"), [(2.5, FINE), (-3.4, LOOK), (5.1, LOOK), (-12.0, LOOK)])
def test_one_datum_far_from_the_model_is_looked_at(far, level):
    residuals = np.append(np.zeros(59), far)
    found = rules.worst_verdict(fitted(residuals))
    assert found.level == level
    assert found.value == f"{far:+.1f} sigma"
    assert rules.overall([found])[0] == level


@pytest.mark.parametrize(
    ("residuals", "level"), [([0.3, 0.5], FINE), ([0.0, 3.0], LOOK), ([0.0, -5.0], DO_NOT), ([5.1], DO_NOT)]
)
def test_a_model_that_does_not_make_the_data_is_seen(residuals, level):
    found = rules.goodness_verdict(alone(fitted(residuals)))
    assert found.level == level
    if level == DO_NOT:
        assert f"{residuals[-1]:+.1f} sigma from the best sample" in found.sentence


def test_the_table_of_a_run_is_that_of_its_best_sample(finished_run):
    results = sk.load_results(finished_run)
    table = results.goodness()
    assert table["quantity"].tolist() == ["leading", "trailing", "precession", "all data"]
    observable = results.spec.bind().observable
    values, errors = observable.data()
    residuals = (values - results.best_observation.prediction.mean) / errors
    np.testing.assert_allclose(table["chi2"][:3], residuals**2)
    np.testing.assert_allclose(table["residual"][:3], residuals)
    assert table["chi2"][3] == pytest.approx((residuals**2).sum())
    assert table["worst"][3] == observable_names(results)[int(np.argmax(np.abs(residuals)))]
    mean = results.blobs["mean"][results.discard :].reshape(-1, 3)
    assert len(mean) <= 200
    squares = (((values - mean) / errors) ** 2).sum(axis=1)
    assert table["p"][3] == pytest.approx(chi2.sf(squares, 3).mean())
    assert "fit to the data, at the best sample" in describe_results(results)
    assert (finished_run / "goodness.ecsv").exists()


def observable_names(results):
    return results.best_observation.prediction.names


class Wrapped(sk.Observable):
    """A likelihood of its own, and nothing said about residuals."""

    kind = "wrapped"

    def data(self):
        return np.zeros(1), np.ones(1)

    def predict(self, stream):
        return sk.Prediction(("it",), np.zeros(1), np.zeros(1))

    def ln_likelihood(self, prediction, add_noise):
        return -1.0


def test_a_likelihood_without_residuals_is_not_judged():
    observable = Wrapped()
    prediction = sk.Prediction(("it",), np.zeros(1), np.zeros(1))
    assert residuals_of(observable, prediction, Data(*observable.data())) is None
    fit = Goodness((), fitted([0.0]), ("wrapped",))
    assert goodness_table(fit).meta["not judged"].endswith(": wrapped")


def test_each_correlated_datum_given_the_others_is_the_conditional_density():
    """ln p(y_i | the others) = ln p(y) - ln p(the others)."""
    rng = np.random.default_rng(7)
    root = rng.standard_normal((3, 3))
    covariance = root @ root.T + np.eye(3)
    values, mean, variance = rng.standard_normal(3), rng.standard_normal(3), np.full(3, 0.2)
    errors = np.sqrt(np.diag(covariance))
    found = Data(values, errors, True, covariance).gaussian_of_each(mean, variance)
    joint = multivariate_normal(mean, covariance + 0.2 * np.eye(3))
    for i in range(3):
        others = [j for j in range(3) if j != i]
        rest = multivariate_normal(mean[others], (covariance + 0.2 * np.eye(3))[np.ix_(others, others)])
        assert found[i] == pytest.approx(joint.logpdf(values) - rest.logpdf(values[others]))


def test_new_data_have_the_covariance_of_the_data():
    covariance = np.array([[1.0, 0.8], [0.8, 2.0]])
    data = Data(np.array([0.0, 0.0, np.nan]), np.array([1.0, np.sqrt(2.0), 1.0]), False,
                np.block([[covariance, np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]]))  # fmt: skip
    rng = np.random.default_rng(9)
    drawn = np.array([data.drawn(np.array([3.0, -1.0, 0.0]), np.zeros(3), rng) for _ in range(20000)])
    assert np.isnan(drawn[:, 2]).all()
    np.testing.assert_allclose(drawn[:, :2].mean(axis=0), [3.0, -1.0], atol=0.05)
    np.testing.assert_allclose(np.cov(drawn[:, :2].T), covariance, atol=0.06)


def test_the_terms_of_a_track_add_up_to_its_likelihood_and_new_data_scatter_about_it():
    spec = sk.load(Path(__file__).parents[3] / "examples" / "gd1" / "gd1.toml").with_particles(1500)
    inputs = spec.bind({"observable.radial_velocity_outliers": 0.1})
    observable = inputs.observable
    _, prediction = sk.Model(spec).observe(inputs)
    data = Data(*observable.data(), True)
    each = ln_likelihood_of_each(observable, prediction, data)
    assert each.sum() == pytest.approx(observable.ln_likelihood(prediction, True), rel=1e-12)
    rng = np.random.default_rng(5)
    rows = observable.quantities()["phi2"]
    drawn = np.array([new_data(observable, prediction, data, rng)[rows] for _ in range(100)])
    scores = (drawn - prediction.mean[rows]) / data.errors[rows]
    assert scores.std() == pytest.approx(1, abs=5 / np.sqrt(2 * scores.size))
    assert residuals_of(observable, prediction, data).shape == data.values.shape


def test_where_all_data_fit_worst_the_quantity_at_fault_is_named():
    """One velocity is 6.5 sigma off among 27; the distances are so many that all data together are least likely."""
    distances = fitted(np.full(400, 1.1), name="distance")
    velocities = fitted([*np.full(26, 0.9), -6.5], name="radial_velocity")
    whole = fitted(np.concatenate([distances.residuals, velocities.residuals]), name="all data")
    fit = Goodness((distances, velocities), whole)
    assert fit.least[0] is whole
    found = rules.goodness_verdict(fit)
    assert "least of all radial_velocity" in found.sentence
    assert "-6.5 sigma" in found.sentence


def test_goodness_is_not_stated_while_an_emulator_is_unsure():
    """Emulated samples with chi^2 as expected, of a best sample that a call puts 7 errors from 8 data."""
    right, wrong = fitted(np.ones(8), samples=[8.0] * 5), fitted(np.full(8, 7.0), samples=[5.0] * 5)
    assert rules.disagreement_verdict(alone(right), uncertified=False) is None
    for fit, uncertified in ((right, True), (wrong, False)):
        found = rules.disagreement_verdict(alone(fit), uncertified)
        assert found.level == LOOK
        assert "goodness of fit is unknown" in found.sentence
    assert "chi^2 = 392 of 8 data" in found.value
