"""The posterior: prior, likelihood, reasons, and what happens when a component misbehaves."""

import copy
import pickle

import numpy as np
import pytest
from runfiles import APOCENTRES, FIT
from scipy.stats import multivariate_normal, norm

import streamkit as sk
from streamkit.components import load_registry
from streamkit.observe import join_data, read_data
from streamkit.sample import Posterior
from streamkit.sample.calls.posterior import OUTSIDE
from streamkit.stream import Data

MOCKER = '''
from typing import Any, ClassVar
import numpy as np
from pydantic import Field
from streamkit import Component, Length, Observable, Prediction, hookimpl

class Counter(Observable):
    """Says what its field `mode` asks for."""

    kind = "counter"
    mode: str = "good"
    error: Length = Field(default=0.5, description="Standard error.")
    asked: ClassVar[list[float]] = []

    def data(self) -> Any:
        self.asked.append(self.error)
        return np.array([1.0, np.nan]), np.array([self.error, np.nan])

    def covariance(self) -> Any:
        wanted = {"covariance": self.error**2, "negative": -1.0, "larger": 1.0}
        return np.diag([wanted[self.mode], np.nan]) if self.mode in wanted else None

    def ln_likelihood(self, prediction: Any, add_noise: bool) -> Any:
        return {"own": 17.5 + add_noise, "infinite": -np.inf}.get(self.mode)

    def predict(self, stream: Any) -> Prediction:
        mean, variance = np.array([2.0, 7.0]), np.array([0.11, 0.0])
        if self.mode == "raise":
            raise ZeroDivisionError("boom")
        if self.mode == "nan":
            mean = mean * np.nan
        if self.mode == "single":
            mean, variance = mean.astype(np.float32), np.zeros(2, dtype=int)
        if self.mode == "shape":
            mean = mean[:1]
        why = "the stream is shy" if self.mode == "why" else ""
        return Prediction(("one", "two"), mean, variance, why_not=why)

@hookimpl
def streamkit_components() -> list[type[Component]]:
    return [Counter]
'''


@pytest.fixture
def mocked(tmp_path):
    """Return a function that makes the posterior of the small fit with the observable above."""
    file = tmp_path / "mocker.py"
    file.write_text(MOCKER)

    def make(mode, error=0.5, **likelihood):
        document = copy.deepcopy(FIT)
        document["observable"] = {"kind": "counter", "mode": mode, "error": error}
        document["likelihood"] = likelihood
        return Posterior(sk.load(document, load_registry([file])))

    return make


def test_the_likelihood_is_a_product_of_gaussians_and_skips_missing_data():
    data, sigma = np.array([47.8, np.nan, 93.2]), np.array([0.5, np.nan, 3.5])
    mean, variance = np.array([48.1, 3.0, 91.0]), np.array([0.04, 1.0, 0.25])
    plain = norm.logpdf(47.8, 48.1, 0.5) + norm.logpdf(93.2, 91.0, 3.5)
    wide = norm.logpdf(47.8, 48.1, np.hypot(0.5, 0.2)) + norm.logpdf(93.2, 91.0, np.hypot(3.5, 0.5))
    assert Data(data, sigma).gaussian(mean, variance) == pytest.approx(plain, rel=1e-12)
    assert Data(data, sigma, add_noise=True).gaussian(mean, variance) == pytest.approx(wide, rel=1e-12)


@pytest.mark.parametrize("add_noise", [False, True])
def test_a_covariance_is_that_of_a_multivariate_normal(add_noise):
    rng = np.random.default_rng(3)
    root = rng.normal(size=(5, 5))
    covariance, mean, data = root @ root.T + np.eye(5), rng.normal(size=5), rng.normal(size=5)
    variance, sigma = rng.uniform(size=5), np.sqrt(np.diag(covariance))
    total = covariance + np.diag(variance) * add_noise
    found = Data(data, sigma, add_noise, covariance).gaussian(mean, variance)
    assert found == pytest.approx(multivariate_normal.logpdf(data, mean, total), rel=1e-12)
    data[2] = np.nan  # dropped: the marginal of the others
    kept = [0, 1, 3, 4]
    expected = multivariate_normal.logpdf(data[kept], mean[kept], total[np.ix_(kept, kept)])
    assert Data(data, sigma, add_noise, covariance).gaussian(mean, variance) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("covariance", "words"),
    [
        ([[1, 0.9, 0.9], [0.9, 1, -0.9], [0.9, -0.9, 1]], "not positive definite"),
        ([[1, 0.5, 0], [0.4, 1, 0], [0, 0, 1]], "not symmetric"),
        ([[1, 0], [0, 1]], r"shape \(2, 2\), expected \(3, 3\)"),
        ([[1, 0, 0], [0, 2, 0], [0, 0, 1]], "diagonal"),
        ([[1, np.nan, 0], [np.nan, 1, 0], [0, 0, 1]], "not finite"),
    ],
)
def test_what_is_no_covariance_of_the_data_is_refused(covariance, words):
    class Correlated:
        role, kind = "observable", "correlated"

        def data(self):
            return np.zeros(3), np.ones(3)

        def covariance(self):
            return covariance

    with pytest.raises(sk.ComponentError, match=words) as caught:
        read_data(Correlated())
    assert str(caught.value).startswith("observable correlated: ")


def test_independent_data_join_to_a_covariance_of_blocks():
    plain, correlated = Data(np.array([1.0]), np.array([2.0])), np.array([[1.0, 0.3], [0.3, 1.0]])
    both = join_data([plain, Data(np.zeros(2), np.ones(2), covariance=correlated)])
    assert both.values.tolist() == [1, 0, 0]
    assert both.covariance.tolist() == [[4, 0, 0], [0, 1, 0.3], [0, 0.3, 1]]
    assert join_data([plain, plain]).covariance is None


def test_an_observable_may_bring_a_covariance_or_a_likelihood_of_its_own(mocked):
    plain, correlated = mocked("good"), mocked("covariance")
    theta = plain.spec.centre()
    assert correlated.evaluate(theta).ln_likelihood == pytest.approx(plain.evaluate(theta).ln_likelihood, rel=1e-14)
    assert mocked("own").evaluate(theta).ln_likelihood == 17.5
    assert mocked("own", noise="add").evaluate(theta).ln_likelihood == 18.5
    with pytest.raises(sk.ComponentError, match="no finite number"):
        mocked("infinite").evaluate(theta)
    with pytest.raises(sk.ComponentError, match="diagonal"):
        mocked("larger")


def test_data_are_asked_for_once_unless_they_depend_on_a_parameter(mocked):
    fixed = mocked("good")
    asked = type(fixed.spec.bind().observable).asked
    fixed.evaluate(fixed.spec.centre())
    before = len(asked)
    fixed.evaluate(fixed.spec.centre())
    assert len(asked) == before
    free = mocked("good", error={"uniform": [0.2, 0.8]})
    for error in (0.3, 0.7):
        theta = np.array([230.0, 0.35, error])
        expected = norm.logpdf(1.0, 2.0, error)
        assert free.evaluate(theta).ln_likelihood == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("noise", "sigma"), [("ignore", 0.5), ("add", 0.6)])  # 0.25 + 0.11 = 0.6^2
def test_the_posterior_is_prior_times_likelihood(mocked, noise, sigma):
    posterior = mocked("good", noise=noise)
    lnp, lnl, mean, variance = posterior(posterior.spec.centre())
    assert lnl == pytest.approx(norm.logpdf(1.0, 2.0, sigma), rel=1e-12)
    assert lnp == pytest.approx(lnl - np.log(30) - np.log(0.2), rel=1e-12)  # two uniform priors
    assert mean.tolist() == [2.0, 7.0]
    assert variance.tolist() == [0.11, 0.0]


def test_outside_the_prior_nothing_is_computed(mocked):
    posterior = mocked("raise")
    found = posterior.evaluate(np.array([300.0, 0.4]))
    assert (found.lnp, found.reason) == (-np.inf, OUTSIDE)


def test_an_observable_without_value_gives_its_reason(mocked):
    posterior = mocked("why")
    found = posterior.evaluate(posterior.spec.centre())
    assert (found.lnp, found.ln_likelihood, found.reason) == (-np.inf, -np.inf, "the stream is shy")


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        ("raise", ["ZeroDivisionError", "Counter.predict", "boom"]),
        ("nan", ["observable counter", "nan", "no reason"]),
        ("shape", ["observable counter", "(1,)", "(2,)"]),
    ],
)
def test_a_broken_component_is_named_with_the_parameters(mocked, mode, words):
    posterior = mocked(mode)
    with pytest.raises(sk.ComponentError) as caught:
        posterior.evaluate(np.array([220.0, 0.3]))
    for word in ["observable counter", *words, "potential.v0 = 220.0 km/s", "potential.alpha = 0.3"]:
        assert word in str(caught.value)
    assert isinstance(caught.value.__cause__, ZeroDivisionError if mode == "raise" else type(None))


def test_predictions_of_other_types_are_64_bit_floats(mocked):
    """A file of calls holds no others: a resumed run could not read what the run before had stored."""
    evaluation = mocked("single").evaluate(np.array([220.0, 0.3]))
    assert evaluation.mean.dtype == evaluation.variance.dtype == np.float64
    assert evaluation.mean.tolist() == [2.0, 7.0]


def test_out_of_domain_becomes_a_counted_reason():
    document = copy.deepcopy(APOCENTRES)
    document["progenitor"]["lookback"] = {"uniform": [0.01, 0.02]}
    posterior = Posterior(sk.load(document))
    found = posterior.evaluate(posterior.spec.centre())
    assert found.lnp == -np.inf
    assert "apocentre" in found.reason
    assert np.isnan(found.mean).all()


def test_the_posterior_is_deterministic_and_survives_pickling():
    posterior = Posterior(sk.load(FIT))
    theta = posterior.spec.centre()
    again = pickle.loads(pickle.dumps(posterior))
    first = posterior(theta)
    assert np.isfinite(first[0])
    for one, two in zip(first, again(theta), strict=True):
        np.testing.assert_array_equal(one, two)


def test_nothing_to_fit_is_an_error():
    document = copy.deepcopy(FIT)
    del document["observable"]
    with pytest.raises(sk.SpecError, match="observable"):
        Posterior(sk.load(document))
    document = copy.deepcopy(FIT)
    document["potential"] |= {"v0": 220, "alpha": 0.4}
    with pytest.raises(sk.SpecError, match="free parameter"):
        Posterior(sk.load(document))
