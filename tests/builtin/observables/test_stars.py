"""Stars of a stream among field stars: against `track`, scipy's Gaussians, closed forms, and mocks of known members."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mock_stars import COLUMNS, FRAME, KERNEL, WINDOW, catalogue, the_stream, without_field
from pydantic import ValidationError
from runfiles import changed
from scipy.stats import multivariate_normal

import streamkit as sk
from streamkit.builtin.observables.stars.knots import knots_between
from streamkit.builtin.observables.stars.observable import Stars
from streamkit.builtin.observables.track.observable import Track
from streamkit.testing.streams import example_stream


def stars_of(table: dict[str, Any], **fields: Any) -> Stars:
    return Stars(**({"frame": FRAME, "stars": table, "window": WINDOW, "kernel": KERNEL} | fields))


def test_curves_between_knots_are_exact_for_parabolas_and_pass_through_the_knots() -> None:
    at = np.random.default_rng(0).uniform(-3, 5, 200)
    knots = knots_between(-3.0, 5.0, 7, at)
    np.testing.assert_allclose(knots.cubic @ (2 - 3 * knots.phi1 + 0.5 * knots.phi1**2), 2 - 3 * at + 0.5 * at**2)
    np.testing.assert_allclose(knots.linear @ (2 - 3 * knots.phi1), 2 - 3 * at)
    here = knots_between(-3.0, 5.0, 7, knots.phi1)
    np.testing.assert_allclose(here.cubic.toarray(), np.eye(7), atol=1e-12)
    np.testing.assert_allclose(here.linear.toarray(), np.eye(7), atol=1e-12)


@pytest.mark.parametrize("seed", [3, 4])
def test_without_a_field_the_likelihood_is_that_of_the_members_of_a_track(seed: int) -> None:
    """For the stream that the stars are of, and for another one."""
    table = without_field(catalogue(300, 0)[0])
    stream = example_stream(seed=seed)
    stars, track = stars_of(table, knots=81), Track(frame=FRAME, members=table, kernel=KERNEL)
    expected = track.ln_likelihood(track.predict(stream), False)
    assert stars.ln_likelihood(stars.predict(stream), False) == pytest.approx(float(expected), abs=0.3)


def test_the_likelihood_is_that_of_a_mixture() -> None:
    """By scipy, star after star at the knots themselves; the third star has no distance, the fourth a correlation."""
    frame, rng = sk.sky_frame(FRAME), np.random.default_rng(1)
    n = 12
    phi1 = np.linspace(-33, 33, n)
    motions = rng.normal(-1, 1, n), rng.normal(-2, 1, n)
    ra, dec, *pm = frame.to_icrs(phi1, rng.normal(0, 5, n), *motions)
    distance = np.where(np.arange(n) == 2, np.nan, rng.normal(20, 3, n))
    table = {
        "ra": ra, "dec": dec, "pm_ra_cosdec": pm[0], "pm_dec": pm[1], "pm_ra_cosdec_error": np.full(n, 0.2),
        "pm_dec_error": np.full(n, 0.4), "pm_correlation": np.where(np.arange(n) == 3, 0.6, 0.0), "distance": distance,
        "distance_error": np.full(n, 2.0), "background_density": rng.uniform(1e-4, 1e-2, n),
        "colour_ratio": rng.uniform(0.1, 10, n),
    }  # fmt: skip
    stars = stars_of(
        table, window={"phi1": [-33, 33]}, knots=n, fraction=0.3, along="uniform", pm_phi2_dispersion=0.3, kernel=6
    )
    known = {name: column for name, column in table.items() if name not in ("background_density", "colour_ratio")}
    members = Track(frame=FRAME, members=known)
    assert members._stars is not None
    prediction = stars.predict(the_stream())
    rows = stars.quantities()
    expected, chance = [], []
    for i in range(n):
        names = [name for name in ("phi2", "pm_phi1_cosphi2", "pm_phi2", "distance") if i != 2 or name != "distance"]
        mean = np.array([prediction.mean[rows[name][i]] for name in names])
        spread = np.array([prediction.mean[rows[f"{name}_spread"][i]] for name in names])
        spread[names.index("pm_phi2")] = np.hypot(spread[names.index("pm_phi2")], 0.3)
        errors = np.array([members._stars.errors[name][i] for name in names])
        covariance = np.diag(spread**2 + errors**2)
        covariance[1, 2] = covariance[2, 1] = members._stars.covariance[i]
        value = [members._stars.values[name][i] for name in names]
        density = multivariate_normal(mean, covariance).pdf(value) * table["colour_ratio"][i]
        density *= np.exp(prediction.details["ln_coverage"][i])
        whole = 0.3 * density + 0.7 * table["background_density"][i]
        expected.append(np.log(whole))
        chance.append(0.3 * density / whole)
    assert stars.ln_likelihood(prediction, False) == pytest.approx(sum(expected))
    np.testing.assert_allclose(stars.membership(prediction), chance, rtol=1e-8)


def test_the_noise_of_the_model_is_shared_by_the_stars_at_a_knot() -> None:
    """Stars at the knots: the errors of those at one knot are a Gaussian with a common part."""
    frame, rng, count, each = sk.sky_frame(FRAME), np.random.default_rng(2), 5, 4
    phi1 = np.repeat(np.linspace(-20, 20, count), each)
    ra, dec, *_ = frame.to_icrs(phi1, rng.normal(0, 3, len(phi1)))
    stars = stars_of({"ra": ra, "dec": dec}, window={"phi1": [-20, 20]}, knots=count)
    prediction = stars.predict(the_stream())
    rows = stars.quantities()
    variance = np.zeros(2 * count)
    variance[rows["phi2"]] = noise = 0.05 * prediction.mean[rows["phi2_spread"]] ** 2
    prediction = replace(prediction, variance=variance)
    total = each * float(prediction.details["ln_coverage"].sum())
    for k in range(count):
        spread2 = prediction.mean[rows["phi2_spread"][k]] ** 2 + 1e-6
        covariance = spread2 * np.eye(each) + noise[k]
        value = stars.catalogue.values["phi2"][k * each : (k + 1) * each]
        total += float(multivariate_normal(np.full(each, prediction.mean[rows["phi2"][k]]), covariance).logpdf(value))
    assert stars.ln_likelihood(prediction, True) == pytest.approx(total)


def test_the_average_over_errors_of_the_model_gains_no_more_than_the_misfit() -> None:
    """A track that is off everywhere, many stars at each knot, and errors that would hide it: ln L stays below the top.

    Beside the joint Gaussian of all stars, in which the numbers at the knots are shared by those between them.
    """
    table = {name: without_field(catalogue(400, 0, seed=4)[0])[name] for name in ("ra", "dec")}
    stars = stars_of(table, window={"phi1": [-40, 40]}, knots=6)
    prediction = stars.predict(the_stream())
    rows = stars.quantities()
    spread = prediction.mean[rows["phi2_spread"]]
    variance = np.zeros(12)
    variance[rows["phi2"]] = 0.1 * spread**2
    top = float(stars.ln_likelihood(prediction, False))
    for shift in (0.0, 1.0, 3.0, 30.0):
        mean = prediction.mean.copy()
        mean[rows["phi2"]] += shift * spread
        moved = replace(prediction, mean=mean, variance=variance)
        weights = stars.catalogue.knots.cubic.toarray()
        width = stars.catalogue.knots.linear @ spread
        whole = weights @ np.diag(variance[rows["phi2"]]) @ weights.T + np.diag(width**2 + 1e-6)
        away = stars.catalogue.values["phi2"] - weights @ mean[rows["phi2"]]
        exact = float(multivariate_normal(np.zeros(len(away)), whole).logpdf(away))
        found = float(stars.ln_likelihood(moved, True))
        assert float(stars.ln_likelihood(moved, False)) - 20 < found < exact + 5
        unsure = replace(moved, variance=np.full(12, 0.1) * np.concatenate([spread, spread]) ** 2)
        assert stars.ln_likelihood(unsure, True) < top + 5


def test_many_points_at_once_are_the_points_one_by_one() -> None:
    table, _ = catalogue(150, 300, seed=3)
    stars, rng, n = stars_of(table, fraction=0.4, knots=12, along="model"), np.random.default_rng(4), 7
    one = stars.predict(the_stream())
    mean = one.mean + 2 * np.sqrt(one.variance) * rng.standard_normal((n, len(one.mean)))
    fraction, wide = rng.uniform(0.1, 0.9, (n, 1)), rng.uniform(0, 0.3, (n, 1))
    many = sk.Prediction(
        one.names, mean, np.tile(one.variance, (n, 1)), details={k: np.tile(v, (n, 1)) for k, v in one.details.items()}
    )
    for add_noise in (False, True):
        together = stars.model_copy(update={"fraction": fraction, "pm_phi2_dispersion": wide}).ln_likelihood(
            many, add_noise
        )
        apart = [
            stars.model_copy(update={"fraction": float(f), "pm_phi2_dispersion": float(w)}).ln_likelihood(
                replace(one, mean=m), add_noise
            )
            for f, w, m in zip(fraction[:, 0], wide[:, 0], mean, strict=True)
        ]
        np.testing.assert_allclose(together, apart, rtol=1e-9)


@pytest.mark.parametrize(("members", "others"), [(800, 800), (400, 1600)])
def test_members_are_found_among_field_stars(members: int, others: int) -> None:
    """The fraction, how many of the stars of a chance are members, and the scores of the true stream."""
    table, truth = catalogue(members, others, seed=5)
    stars = stars_of(table, fraction=members / (members + others))
    prediction = stars.predict(the_stream())
    fractions = np.linspace(0.05, 0.95, 91)
    lnl = [stars.model_copy(update={"fraction": f}).ln_likelihood(prediction, False) for f in fractions.tolist()]
    n = len(truth)
    error = np.sqrt(members * others / n**3)
    assert fractions[int(np.argmax(lnl))] == pytest.approx(truth.mean(), abs=3 * error + 0.01)
    chance = stars.membership(prediction)
    assert chance.sum() == pytest.approx(truth.sum(), abs=4 * np.sqrt((chance * (1 - chance)).sum()) + 0.01 * n)
    for low, high in ((0.0, 0.1), (0.1, 0.5), (0.5, 0.9), (0.9, 1.0)):
        some = (chance >= low) & (chance <= high)
        scatter = np.sqrt((chance[some] * (1 - chance[some])).sum()) / max(some.sum(), 1)
        assert chance[some].mean() == pytest.approx(truth[some].mean(), abs=4 * scatter + 0.005)
    scores = stars.residuals(prediction, False)
    assert np.abs(scores).max() < 4.5
    assert scores.std() == pytest.approx(1.0, abs=0.25)


def test_the_true_stream_is_the_likeliest_among_field_stars() -> None:
    """The track is moved along phi2: the maximum and its width are those that the members give without a field."""
    table, truth = catalogue(300, 1200, seed=6)
    clean = {name: np.array(column)[truth] for name, column in without_field(table).items()}
    shifts, found = np.linspace(-1.5, 1.5, 31), []
    for stars in (stars_of(table, fraction=0.2), stars_of(clean)):
        prediction = stars.predict(the_stream())
        rows = stars.quantities()["phi2"]
        lnl = np.empty(len(shifts))
        for i, shift in enumerate(shifts):
            mean = prediction.mean.copy()
            mean[rows] += shift
            lnl[i] = stars.ln_likelihood(replace(prediction, mean=mean), False)
        weight = np.exp(lnl - lnl.max())
        middle = float(weight @ shifts / weight.sum())
        found.append((middle, float(np.sqrt(weight @ (shifts - middle) ** 2 / weight.sum()))))
    (mixed, width), (alone, least) = found
    assert abs(mixed) < 3 * width
    assert mixed == pytest.approx(alone, abs=1.5 * width)
    assert least <= width < 1.5 * least


def test_the_rough_track_is_that_of_the_members() -> None:
    """Without any model: the track and the share of members along phi1, which falls as the field grows denser."""
    table, truth = catalogue(600, 1800, seed=8)
    stars = stars_of(table, fraction=0.25, knots=12)
    rough, prediction = stars.rough, stars.predict(the_stream())
    assert rough.fraction == pytest.approx(truth.mean(), abs=0.03)
    value, error = stars.data()
    rows = np.concatenate([stars.quantities()[name][1:-1] for name in COLUMNS])
    pull = (value - prediction.mean)[rows] / error[rows]
    assert np.median(np.abs(pull)) < 1.5
    # members are even in phi1, and the field grows from 1/2 to 3/2 of its mean
    share = 0.25 / (0.25 + 0.75 * (1 + 0.5 * stars.catalogue.knots.phi1 / 40))
    np.testing.assert_allclose(rough.share[1:-1], share[1:-1], atol=0.08)


def test_a_run_file_with_a_free_fraction_can_be_emulated() -> None:
    table, _ = catalogue(60, 60)
    section = {"kind": "stars", "frame": FRAME, "stars": table, "window": WINDOW, "fraction": {"uniform": [0, 1]}}
    spec = sk.load(changed("observable", section))
    assert "observable.fraction" in spec.names
    assert sk.load(spec.document).digest() == spec.digest()
    observable = spec.bind(dict(zip(spec.names, spec.centre(), strict=True))).observable
    assert isinstance(observable, Stars)
    assert set(observable.likelihood_fields()) >= {"fraction", "phi2_dispersion"}
    assert observable.likelihood_details == ("ln_coverage", "ln_density")


def test_mocks_scatter_about_the_prediction_and_can_be_read_again() -> None:
    table = without_field(catalogue(60, 0)[0])
    stars, rng = stars_of(table, knots=40), np.random.default_rng(9)
    prediction = stars.predict(the_stream())
    drawn = [stars_of(stars.mock(prediction, rng)["stars"], knots=40, window={"phi1": [-40, 40]}) for _ in range(60)]
    lnl = [mock.ln_likelihood(prediction, False) for mock in drawn]
    # ln L of N Gaussian data of the same widths has a scatter of sqrt(N / 2)
    n = sum(np.isfinite(column).sum() for column in stars.catalogue.values.values())
    assert np.std(lnl) == pytest.approx(np.sqrt(n / 2), rel=0.3)
    mixed = stars_of(catalogue(60, 60)[0], fraction=0.5)
    there = mixed.predict(the_stream())
    with pytest.raises(sk.StreamkitError, match="only where all stars are of one stream"):
        mixed.mock(there, rng)


def _bad(**columns: Any) -> dict[str, Any]:
    return {"stars": catalogue(30, 0)[0] | columns}


RADIANS = {name: np.radians(catalogue(30, 0)[0][name]).tolist() for name in ("ra", "dec")}
HOURS = {"ra": (np.array(catalogue(30, 0)[0]["ra"]) / 15).tolist()}


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (_bad(**RADIANS), "are outside the window, phi1 = -40 to 40 deg.*in radians"),
        (_bad(**HOURS), "outside the window.*in hours"),
        ({"window": {"phi1": [-10, 10]}}, "outside the window, phi1 = -10 to 10 deg. The first is row"),
        ({"window": {"phi1": [-40, 40], "distance": [5, 10]}}, "the stars have no distance; they have phi1, phi2, pm"),
        ({"window": {"phi1": [-40, 0, 40]}}, "found 3 numbers for each column, expected two"),
        ({"window": {"phi1": [-40, 40], "phi2": [10, -10]}}, "expected the lower end first"),
        ({"window": {"phi2": [-10, 10]}}, "the column 'phi1' is missing"),
        (_bad(pm_dec_error=[float("nan")] * 30), "pm_dec: row 1 has a value and no error"),
        (_bad(pm_dec_error=[0.0] * 30), "pm_dec_error.*expected positive"),
        (_bad(background_density=[0.0] * 30), "background_density.*positive"),
        (_bad(background_density=[float("nan")] * 30), "background_density.*finite"),
        ({"stars": without_field(catalogue(30, 0)[0]), "fraction": 0.5}, "a column background_density"),
        ({"stars": catalogue(5, 0)[0]}, "found 5 stars, expected at least 10"),
        ({"fraction": 1.5}, "less than or equal to 1"),
        ({"compared": ["radial_velocity"]}, "members have no radial_velocity"),
        ({"knots": 3}, "greater than or equal to 4"),
    ],
)
def test_stars_that_are_wrong_are_refused(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ValidationError, match=text):
        stars_of(given.pop("stars", catalogue(30, 0)[0]), **given)


def test_a_stream_elsewhere_is_told() -> None:
    """A star is of the field where the stream is far away, and ln L stays finite."""
    table, _ = catalogue(100, 100)
    stars = stars_of(table, fraction=0.5, along="uniform")
    prediction = stars.predict(the_stream())
    mean = prediction.mean.copy()
    mean[stars.quantities()["pm_phi2"]] += 40
    elsewhere = replace(prediction, mean=mean)
    assert stars.membership(elsewhere).max() < 1e-6
    assert any("none of 200 stars is likely" in text for text in stars.remarks(elsewhere))
    field = np.log(table["background_density"]).sum() + 200 * np.log(0.5)
    assert stars.ln_likelihood(elsewhere, False) == pytest.approx(field)
    assert not any("likely" in text for text in stars.remarks(prediction))


@pytest.mark.parametrize("cocoon", [{}, {"cocoon_fraction": 0.3, "cocoon_phi2_dispersion": 2.0}])
@pytest.mark.parametrize("factor", [1e3, 1e100])
def test_stars_of_a_stream_that_is_elsewhere_are_of_the_field(cocoon: dict[str, Any], factor: float) -> None:
    """However far or wide it is: ln L is the sum of ln[(1 - f) B], and no NaN."""
    table, _ = catalogue(50, 100, seed=2)
    stars = Stars(frame=FRAME, stars=table, window=WINDOW, kernel=KERNEL, fraction=0.3, along="uniform", **cocoon)
    prediction = stars.predict(the_stream())
    moved = replace(prediction, mean=(np.abs(prediction.mean) + 100) * factor)
    expected = (np.log(0.7) + np.log(table["background_density"])).sum()
    for noise in (False, True):
        assert stars.ln_likelihood(moved, noise) == pytest.approx(expected, rel=1e-9)
