"""The posterior: prior, likelihood, reasons, and what happens when a component misbehaves."""

import copy
import pickle

import numpy as np
import pytest
from scipy.stats import norm
from toys import FIT

import streamkit as sk
from streamkit.components import load_registry
from streamkit.sample import Posterior
from streamkit.sample.posterior import OUTSIDE, gaussian

MOCKER = '''
from typing import Any
import numpy as np
from streamkit import Component, Observable, Prediction, hookimpl

class Counter(Observable):
    """Says what its field `mode` asks for."""

    kind = "counter"
    mode: str = "good"

    def data(self) -> Any:
        return np.array([1.0, np.nan]), np.array([0.5, np.nan])

    def predict(self, stream: Any) -> Prediction:
        mean, variance = np.array([2.0, 7.0]), np.array([0.11, 0.0])
        if self.mode == "raise":
            raise ZeroDivisionError("boom")
        if self.mode == "nan":
            mean = mean * np.nan
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

    def make(mode, **likelihood):
        document = copy.deepcopy(FIT)
        document["observable"] = {"kind": "counter", "mode": mode}
        document["likelihood"] = likelihood
        return Posterior(sk.load(document, load_registry([file])))

    return make


def test_the_likelihood_is_a_product_of_gaussians_and_skips_missing_data():
    data, sigma = np.array([47.8, np.nan, 93.2]), np.array([0.5, np.nan, 3.5])
    mean, variance = np.array([48.1, 3.0, 91.0]), np.array([0.04, 1.0, 0.25])
    plain = norm.logpdf(47.8, 48.1, 0.5) + norm.logpdf(93.2, 91.0, 3.5)
    wide = norm.logpdf(47.8, 48.1, np.hypot(0.5, 0.2)) + norm.logpdf(93.2, 91.0, np.hypot(3.5, 0.5))
    assert gaussian(mean, variance, data, sigma, add_noise=False) == pytest.approx(plain, rel=1e-12)
    assert gaussian(mean, variance, data, sigma, add_noise=True) == pytest.approx(wide, rel=1e-12)


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
    for word in ["observable counter", *words, "potential.v0 = 220.0 km / s", "potential.alpha = 0.3"]:
        assert word in str(caught.value)
    assert isinstance(caught.value.__cause__, ZeroDivisionError if mode == "raise" else type(None))


def test_out_of_domain_becomes_a_counted_reason():
    document = copy.deepcopy(FIT)
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
