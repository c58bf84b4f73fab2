"""Counts along a stream: the likelihoods against scipy, the shape and its noise against streams drawn anew."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import streamkit as sk
from streamkit.builtin.observables.density import Density, ln_counts, scores
from streamkit.testing.streams import example_stream

FRAME = {"pole": [192.86, 27.13], "origin": [266.4, -28.94]}


def at(stream, count=25, **fields):
    """The observable with bins over the middle of the debris."""
    phi1 = stream.seen(FRAME).lon[~stream.bound]
    places = np.linspace(*np.percentile(phi1, [25, 75]), count)
    fields = {"amplitude": 40.0, "background": 3.0, "kernel": 4.0, **fields}
    counts = {"phi1": places, "count": np.full(count, 20.0), **fields.pop("more", {})}
    return Density(frame=FRAME, counts=counts, **fields)


@pytest.fixture(scope="module")
def stream():
    return example_stream()


def test_without_noise_counts_are_poisson_numbers():
    count, mean = np.array([0.0, 3.0, 40.0]), np.array([0.5, 5.0, 30.0])
    exact = stats.poisson.logpmf(count, mean)
    assert ln_counts(count, mean, np.zeros(3)) == pytest.approx(exact, rel=1e-12)
    assert ln_counts(count, mean, np.full(3, 1e-7)) == pytest.approx(exact, rel=1e-6)


def test_with_noise_counts_are_poisson_numbers_of_a_gamma_distribution():
    count, mean, noise = np.array([0.0, 3.0, 40.0]), np.array([0.5, 5.0, 30.0]), np.array([0.1, 4.0, 100.0])
    k = mean**2 / noise
    assert ln_counts(count, mean, noise) == pytest.approx(stats.nbinom.logpmf(count, k, k / (k + mean)), rel=1e-10)


def test_counts_with_errors_are_gaussian(stream):
    observable = at(stream, more={"error": np.full(25, 4.0)})
    prediction = observable.predict(stream)
    for add in (False, True):
        width = np.sqrt(16.0 + add * prediction.variance)
        exact = stats.norm.logpdf(20.0, prediction.mean, width).sum()
        assert observable.ln_likelihood(prediction, add) == pytest.approx(exact)
        assert observable.residuals(prediction, add) == pytest.approx((20.0 - prediction.mean) / width)


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_scores_are_those_of_the_middle_of_each_probability(noise):
    count, mean = np.arange(60.0), np.full(60, 9.0)
    drawn = stats.nbinom(270.0, 270 / 279) if noise else stats.poisson(9.0)  # 9^2 / 0.3 = 270
    middle = drawn.cdf(count) - 0.5 * drawn.pmf(count)
    known = (middle > 1e-10) & (middle < 1 - 1e-10)
    found = scores(count, mean, np.full(60, noise))
    assert found[known] == pytest.approx(stats.norm.ppf(middle[known]), rel=1e-5)
    assert np.all(np.diff(found) > 0)  # far from the mean too
    between = scores(count + 0.5, mean, np.full(60, noise))
    assert np.all((between > found)[:-1] & (between[:-1] < found[1:]))


def test_scores_of_many_counts_are_standard_normal():
    rng = np.random.default_rng(1)
    found = scores(rng.negative_binomial(40.0, 40 / 70, 20_000), np.full(20_000, 30.0), np.full(20_000, 22.5))
    assert found.mean() == pytest.approx(0.0, abs=0.03)
    assert found.std() == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("more", [{}, {"error": np.full(25, 4.0)}])
def test_many_predictions_are_compared_at_once(stream, more):
    """As a sampler that emulates predictions does, which may give means below zero."""
    observable = at(stream, more=more)
    one = observable.predict(stream)
    assert observable.ln_likelihoods(one, True).sum() == pytest.approx(observable.ln_likelihood(one, True))
    factors = np.array([0.5, 1.0, 1.5, -0.1])[:, None]
    many = sk.Prediction(one.names, factors * one.mean, np.tile(one.variance, (4, 1)))
    found = observable.ln_likelihood(many, True)
    for lnl, mean in zip(found, many.mean, strict=True):
        assert lnl == pytest.approx(observable.ln_likelihood(replace(one, mean=mean), True))
    assert np.all(np.isfinite(found))


def test_amplitude_is_the_mean_count_and_the_shape_that_of_a_histogram(stream):
    """Beside counts of the particles in bins, for bins far wider than the kernel."""
    observable = at(stream, count=9, kernel=1.0, background=0.0)
    prediction = observable.predict(stream)
    assert prediction.mean.mean() == pytest.approx(40.0, rel=0.02)
    debris = stream.seen(FRAME).lon[~stream.bound]
    kernel = np.exp(-0.5 * (observable.counts["phi1"][:, None] - debris) ** 2).sum(axis=1)
    assert prediction.mean == pytest.approx(40 * kernel / kernel.mean(), rel=0.02)


def test_background_and_efficiency(stream):
    seen = np.linspace(0.3, 1.0, 25)
    whole, part = at(stream), at(stream, more={"efficiency": seen})
    assert part.predict(stream).mean == pytest.approx(seen * whole.predict(stream).mean)
    without = at(stream, background=0.0).predict(stream)
    assert whole.predict(stream).mean == pytest.approx(without.mean + 3.0)


def test_variance_is_the_scatter_over_streams(stream):
    """Particles drawn with repetition: the scatter of the shape, its norm included, is the variance's root."""
    rng = np.random.default_rng(4)
    observable = at(stream, count=8)
    prediction = observable.predict(stream)
    means = []
    for _ in range(200):
        weight = rng.poisson(1.0, len(stream)).astype(float)
        means.append(observable.predict(replace(stream, weight=weight)).mean)
    assert np.std(means, axis=0) / np.sqrt(prediction.variance) == pytest.approx(1.0, abs=0.2)


def test_without_debris_at_the_data_the_likelihood_falls_with_the_distance(stream):
    debris = stream.seen(FRAME).lon[~stream.bound]
    narrow = replace(stream, bound=stream.bound | (np.abs(stream.seen(FRAME).lon - np.median(debris)) > 5))
    middle = float(np.median(debris))
    values = []
    for away in (15.0, 20.0, 25.0):
        places = middle + away + np.arange(3.0)
        far = Density(frame=FRAME, counts={"phi1": places, "count": [9.0, 8.0, 9.0]}, amplitude=9.0, kernel=0.5)
        values.append(far.ln_likelihood(far.predict(narrow), False))
        assert far.remarks(far.predict(narrow))
    assert np.isfinite(values).all()
    assert values[0] > values[1] > values[2]


def test_no_debris_is_a_reason(stream):
    gone = replace(stream, bound=np.ones(len(stream), dtype=bool))
    assert at(stream).predict(gone).why_not == "too few particles have left the progenitor"


def test_mock_counts_are_counts_about_the_prediction(stream):
    observable = at(stream, more={"efficiency": np.full(25, 0.5)})
    prediction = observable.predict(stream)
    rng = np.random.default_rng(2)
    drawn = np.array([observable.mock(prediction, rng)["counts"]["count"] for _ in range(300)])
    assert (drawn == np.round(drawn)).all()
    assert drawn.mean(axis=0) == pytest.approx(prediction.mean, rel=0.1)
    assert drawn.var(axis=0) == pytest.approx(prediction.mean, rel=0.5)
    assert set(observable.mock(prediction, rng)["counts"]) == {"phi1", "count", "efficiency"}


def test_picture_has_counts_line_and_residuals(stream):
    observable = at(stream)
    (panel,) = observable.panels(stream, observable.predict(stream))
    assert panel.data is not None
    assert len(panel.data.pull) == 25
    assert np.isfinite(panel.marks[0].y).all()


def test_negative_counts_are_refused():
    with pytest.raises(sk.SpecError, match="count"):
        sk.load({"potential": {"kind": "nfw", "mass": 1e12, "rs": 20}, "progenitor": {"kind": "plummer", "mass": 1e4,
                 "radius": 0.02, "x": 10.0, "y": 0, "z": 0, "vx": 0, "vy": 150.0, "vz": 0, "lookback": 1},
                 "observable": {"kind": "density", "frame": "icrs", "amplitude": 1.0,
                                "counts": {"phi1": [1.0], "count": [-2.0]}}})  # fmt: skip


def test_a_bin_that_is_there_twice_is_refused():
    counts = {"phi1": [-1.0, 0.0, 0.0, 1.0], "count": [3.0, 4.0, 4.0, 2.0]}
    with pytest.raises(ValueError, match="found 2 bins at phi1 = 0 deg"):
        Density(frame=FRAME, counts=counts, amplitude=3.0)
