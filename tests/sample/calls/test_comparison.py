"""The comparison of many predictions at once is that of one after the other, for every kind of data."""

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import streamkit as sk
from streamkit.sample import Posterior
from streamkit.sample.calls.comparison import Comparison

EXAMPLES = Path(__file__).parents[3] / "examples"
RUNS = {
    "means with noise": ("gd1/gd1_literal.toml", {}),
    "stars, dispersion and outliers": ("gd1/gd1.toml", {}),
    "stars beside a covariance": ("pal5/pal5.toml", {}),
    "a covariance without noise": ("pal5/pal5.toml", {"likelihood.noise": "ignore"}),
    "several streams": ("gd1_pal5/gd1_pal5.toml", {}),
    "apocentres": ("sagittarius/sagittarius.toml", {"likelihood.noise": "add"}),
    "distances and depths": ("sagittarius_track/sagittarius_track.toml", {}),
    "counts along a stream": ("pal5/pal5_density.toml", {}),
}


def observed(posterior, count):
    """Points with a prediction, their observations, and what the posterior itself says of them."""
    rng, points, observations, lnl = np.random.default_rng(5), [], [], []
    while len(points) < count:
        theta = np.array([float(prior.ppf(0.35 + 0.3 * rng.random())) for prior in posterior.spec.priors])
        evaluation = posterior.evaluate(theta)
        if np.isfinite(evaluation.ln_likelihood):
            points.append(theta)
            observations.append(posterior.observe(theta))
            lnl.append(evaluation.ln_likelihood)
    return np.array(points), observations, np.array(lnl)


def compared_one_by_one(posterior):
    """Compare three points at once, each with its own call; return the comparison."""
    points, observations, lnl = observed(posterior, 3)
    comparison = Comparison(posterior.model)
    mean, variance = (np.array([getattr(each.prediction, n) for each in observations]) for n in ("mean", "variance"))
    details = np.array([comparison.details(each) for each in observations])
    found = comparison.ln_likelihood(points, mean, variance * posterior.data.add_noise, details)
    np.testing.assert_allclose(found, lnl, rtol=1e-9)
    return comparison


LONG = ("stars beside a covariance", "several streams")  # the parts of both have examples of their own


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow if n in LONG else ()) for n in RUNS])
def test_many_points_at_once_are_one_after_the_other(name):
    file, values = RUNS[name]
    posterior = Posterior(sk.load(EXAMPLES / file).with_particles(400).with_values(values))
    assert compared_one_by_one(posterior).undeclared == []


def test_dispersions_and_outliers_are_no_coordinates_of_the_prediction():
    posterior = Posterior(sk.load(EXAMPLES / "gd1/gd1.toml").with_particles(400))
    alone = {n for n, used in zip(posterior.spec.names, Comparison(posterior.model).coordinates, strict=True)
             if not used}  # fmt: skip
    assert alone == {"observable.radial_velocity_dispersion", "observable.radial_velocity_outliers"}


def test_the_dispersion_of_distances_is_one_where_a_depth_is_predicted_with_it():
    posterior = Posterior(sk.load(EXAMPLES / "sagittarius_track/sagittarius_track.toml").with_particles(400))
    assert Comparison(posterior.model).coordinates.all()


class Rate(sk.HostData):
    """Data of the host with a likelihood of its own: Laplace's, with a scale that may be free."""

    kind = "rate"
    scale: sk.PositiveNumber = 1.0
    datum: sk.Number = 200.0
    example: ClassVar[dict[str, Any]] = {}

    def data(self):
        return np.array([self.datum]), np.array([5.0])

    def predict(self, host):
        return sk.Prediction(("rate",), host.circular_velocity(np.array([8.0])), np.zeros(1))

    def ln_likelihood(self, prediction, add_noise):
        return -np.sum(np.abs(prediction.mean - self.datum) / self.scale, axis=-1)


class Declared(sk.HostData):
    """The same, and says what the likelihood reads."""

    kind = "declared_rate"
    likelihood_details = ()
    scale: sk.PositiveNumber = 1.0

    data, predict, ln_likelihood = Rate.data, Rate.predict, Rate.ln_likelihood
    datum: sk.Number = 200.0

    def likelihood_fields(self):
        return ("scale",)


def with_rate(kind, **fields):
    spec = sk.load(EXAMPLES / "gd1/gd1_literal.toml").with_particles(400)
    document = spec.with_files_at({name: str(spec.folder / name) for name in spec.files})
    return Posterior(sk.load(document | {"data": {"rate": {"kind": kind, **fields}}}, components=[Rate, Declared]))


def test_a_likelihood_of_somebody_else_works_after_one_declaration():
    posterior = with_rate("declared_rate", scale={"uniform": [0.5, 5.0]})
    coordinates = compared_one_by_one(posterior).coordinates
    alone = [n for n, used in zip(posterior.spec.names, coordinates, strict=True) if not used]
    assert alone == ["data.rate.scale"]


@pytest.mark.parametrize(
    ("kind", "fields"), [("rate", {}), ("declared_rate", {"datum": {"uniform": [190.0, 210.0]}})]
)
def test_a_likelihood_that_declares_nothing_and_data_with_a_prior_are_named(kind, fields):
    posterior = with_rate(kind, **fields)
    assert Comparison(posterior.model).undeclared == [f"data {kind}"]
