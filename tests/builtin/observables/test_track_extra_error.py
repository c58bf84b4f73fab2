"""Extra errors that are alike along a track: scipy's multivariate normal, draws, and many points at once."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import multivariate_normal, norm

import streamkit as sk
from streamkit.builtin.observables.track import extra_error
from streamkit.builtin.observables.track.observable import Track
from streamkit.testing.streams import example_stream

FRAME = {"pole": [192.86, 27.13], "origin": [266.4, -28.94]}
AT = [-30.0, -21.0, -13.0, 2.0, 3.5, 20.0]
COLUMNS: dict[str, tuple[float, float, float]] = {"phi2": (1.0, 0.3, 1.4), "distance": (20.0, 1.0, 2.0)}


def smooth(size: float, length: float, at: Any = AT) -> np.ndarray:
    """The covariance of an extra error, as the description of its field has it."""
    return size**2 * np.exp(-(np.subtract.outer(np.array(at), np.array(at)) ** 2) / (2 * length**2))


def track(**fields: Any) -> Track:
    """Latitudes and distances, the former with an extra error."""
    given = {
        name: {"phi1": AT, name: np.linspace(value, value + slope, 6).tolist(), "error": [error] * 6}
        for name, (value, error, slope) in COLUMNS.items()
    }
    return Track(**{"frame": FRAME, "phi2_extra_error": 0.8, "extra_error_length": 9.0} | given | fields)


@pytest.fixture(autouse=True, params=[0, extra_error.FEW], ids=["as many data", "as few data"])
def either_way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Few data of many points are factorised side by side, many data by LAPACK."""
    monkeypatch.setattr(extra_error, "FEW", request.param)


@pytest.fixture(scope="module")
def prediction() -> sk.Prediction:
    return track().predict(example_stream())


def test_two_columns_have_covariances_of_their_own(prediction: sk.Prediction) -> None:
    observable = track(distance_extra_error=1.5)
    values, errors = observable.data()
    expected = sum(
        multivariate_normal(prediction.mean[rows], smooth(size, 9.0) + np.diag(errors[rows] ** 2)).logpdf(values[rows])
        for rows, size in ((slice(6), 0.8), (slice(6, 12), 1.5))
    )
    expected += prediction.details["ln_coverage"].sum()
    assert observable.ln_likelihood(prediction, False) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("stars", [(), ("phi2",)])
def test_the_likelihood_is_the_multivariate_normal_of_scipy(
    prediction: sk.Prediction, noise: bool, stars: tuple[str, ...]
) -> None:
    """The other column stays independent, datum by datum."""
    observable = track(stars=stars, phi2_dispersion=0.2)
    values, errors = observable.data()
    white = errors**2 + noise * prediction.variance
    white[:6] += 0.04 + bool(stars) * prediction.details["spread"][:6] ** 2
    whole = smooth(0.8, 9.0) + np.diag(white[:6])
    expected = multivariate_normal(prediction.mean[:6], whole).logpdf(values[:6])
    expected += norm(prediction.mean[6:], np.sqrt(white[6:])).logpdf(values[6:]).sum()
    expected += prediction.details["ln_coverage"].sum()
    assert observable.ln_likelihood(prediction, noise) == pytest.approx(expected, rel=1e-12)
    assert observable.ln_likelihoods(prediction, noise).sum() == pytest.approx(expected, rel=1e-12)
    away = (values - prediction.mean)[:6]
    chi2 = away @ np.linalg.solve(whole, away) - 2 * prediction.details["ln_coverage"][:6].sum()
    assert (observable.residuals(prediction, noise)[:6] ** 2).sum() == pytest.approx(chi2, rel=1e-9)


def test_many_points_at_once_are_the_same_points_one_by_one(prediction: sk.Prediction) -> None:
    """As the emulator calls it, with extra error and length free."""
    rng, n = np.random.default_rng(0), 40
    free = {"phi2_extra_error": rng.uniform(0, 3, (n, 1)), "extra_error_length": rng.uniform(1, 40, (n, 1))}
    mean = prediction.mean + rng.normal(0, 1, (n, 12))
    variance = rng.uniform(0, 1, (n, 12))
    details = {name: np.tile(value, (n, 1)) for name, value in prediction.details.items()}
    many = replace(prediction, mean=mean, variance=variance, details=details)
    found = track().model_copy(update=free).ln_likelihood(many, True)
    for i in range(n):
        one = replace(prediction, mean=mean[i], variance=variance[i])
        fields = {name: float(value[i, 0]) for name, value in free.items()}
        assert found[i] == pytest.approx(float(track(**fields).ln_likelihood(one, True)), rel=1e-9)


def test_places_without_numbers_have_no_likelihood_and_disturb_no_others(prediction: sk.Prediction) -> None:
    mean = np.tile(prediction.mean, (3, 1))
    mean[1, 2], mean[2, 2] = np.nan, 1e200
    details = {name: np.tile(value, (3, 1)) for name, value in prediction.details.items()}
    many = replace(prediction, mean=mean, variance=0 * mean, details=details)
    found = np.asarray(track().ln_likelihood(many, True))
    assert found[0] == pytest.approx(float(track().ln_likelihood(prediction, False)), rel=1e-12)
    assert np.isnan(found[1:]).all()


def test_both_proper_motions_of_members_are_one_gaussian() -> None:
    """With the covariance of each star, and an extra error of one component."""
    rng, n = np.random.default_rng(0), 7
    ra, dec, *_ = sk.sky_frame(FRAME).to_icrs(rng.uniform(-40, 40, n), rng.normal(0, 5, n))
    members = {"ra": ra.tolist(), "dec": dec.tolist(), "pm_correlation": rng.uniform(-0.6, 0.6, n).tolist()}
    for name in ("pm_ra_cosdec", "pm_dec"):
        members |= {name: rng.normal(-1, 1, n).tolist(), f"{name}_error": rng.uniform(0.1, 0.6, n).tolist()}
    observable = Track(frame=FRAME, members=members, compared=["pm_phi1_cosphi2", "pm_phi2"],
                       pm_phi2_extra_error=0.5, extra_error_length=15.0)  # fmt: skip
    prediction = observable.predict(example_stream())
    values, errors = observable.data()
    whole = np.diag(errors**2 + prediction.details["spread"] ** 2)
    stars = observable._stars
    assert stars is not None
    whole[:n, n:] = whole[n:, :n] = np.diag(stars.covariance)
    whole[n:, n:] += smooth(0.5, 15.0, observable.given["pm_phi2"][0])
    expected = multivariate_normal(prediction.mean, whole).logpdf(values) + prediction.details["ln_coverage"].sum()
    assert observable.ln_likelihood(prediction, False) == pytest.approx(expected, rel=1e-10)
    assert observable.ln_likelihoods(prediction, False).sum() == pytest.approx(expected, rel=1e-10)


def test_longitudes_beyond_the_seam_are_near(prediction: sk.Prediction) -> None:
    """Phi1 of 179 and -179 deg differ by 2 deg."""
    at = [-179.0, 179.0, 150.0]
    given = {"phi1": at, "phi2": [0.0] * 3, "error": [1.0] * 3}
    observable = Track(frame=FRAME, phi2=given, phi2_extra_error=2.0, extra_error_length=5.0)
    rows = replace(prediction, names=("a", "b", "c"), mean=np.zeros(3), variance=np.zeros(3),
                   details={name: np.zeros(3) for name in prediction.details})  # fmt: skip
    expected = multivariate_normal(np.zeros(3), smooth(2.0, 5.0, [181.0, 179.0, 150.0]) + np.eye(3)).logpdf([0.0] * 3)
    assert observable.ln_likelihood(rows, False) == pytest.approx(expected)


def test_drawn_data_have_the_covariance(prediction: sk.Prediction) -> None:
    observable, rng = track(phi2_dispersion=0.2), np.random.default_rng(1)
    drawn = np.array([observable.mock(prediction, rng)["phi2"]["phi2"] for _ in range(6000)])
    whole = smooth(0.8, 9.0) + np.diag(np.full(6, 0.09 + 0.04))
    found = np.cov(drawn - prediction.mean[:6], rowvar=False)
    np.testing.assert_allclose(found, whole, atol=5 * whole[0, 0] * np.sqrt(2 / 6000))
    np.testing.assert_allclose(drawn.mean(axis=0), prediction.mean[:6], atol=5 * np.sqrt(whole[0, 0] / 6000))


def test_the_scatter_of_tables_has_the_extra_error(prediction: sk.Prediction) -> None:
    found = track(phi2_dispersion=0.2).scatter(prediction)
    assert found == pytest.approx([np.sqrt(0.09 + 0.04 + 0.64)] * 6 + [1.0] * 6)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"extra_error_length": 0.0}, "phi2_extra_error is alike along the track: expected extra_error_length"),
        ({"extra_error_length": 0.0}, "An error of each datum by itself is phi2_dispersion"),
        ({"phi2_outliers": 0.1}, "phi2_extra_error and phi2_outliers: a column with an extra error has no outliers"),
        ({"phi2_extra_error": -1.0}, "phi2_extra_error"),
        ({"extra_error_length": -1.0}, "extra_error_length"),
    ],
)
def test_bad_input_is_said(fields: dict[str, float], text: str) -> None:
    with pytest.raises(ValidationError, match=text):
        track(**fields)
