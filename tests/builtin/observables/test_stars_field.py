"""The density of the field that is fitted to stars, and a cocoon about a stream: against mocks and closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mock_stars import COLUMNS, FRAME, HIGH, KERNEL, WINDOW, catalogue, members_of_stream, the_stream, without_field
from pydantic import ValidationError
from scipy.stats import multivariate_normal, norm

import streamkit as sk
from streamkit.builtin.observables.stars.field import fitted
from streamkit.builtin.observables.stars.observable import Stars

MOTIONS = COLUMNS[1:]
# Two populations of the field: means and widths of the proper motions, and the slope of their number along phi2.
DISC, HALO = ((-3.0, -1.0), 2.0, 0.8), ((0.0, 2.0), 6.0, 0.0)


def stars_of(table: dict[str, Any], **fields: Any) -> Stars:
    return Stars(**({"frame": FRAME, "stars": table, "window": WINDOW, "kernel": KERNEL} | fields))


def two_populations(count: int, rng: np.random.Generator) -> tuple[dict[str, sk.Array], sk.Array]:
    """Field stars of a disc that is denser at high phi2, and more so at high phi1, and a halo; and their density."""
    phi1 = rng.uniform(-40, 40, count)
    share = 0.5 + 0.3 * phi1 / 40  # of the disc
    of_disc = rng.random(count) < share
    u = rng.random(count)
    slope = DISC[2]
    sloped = (-1 + np.sqrt((1 - slope) ** 2 + 4 * slope * u)) / slope  # of the density 1 + slope x at x in (-1, 1)
    phi2 = 0.5 * HIGH * np.where(of_disc, sloped, 2 * u - 1)
    motions = [np.where(of_disc, *(rng.normal(mean[j], width, count) for mean, width, _ in (DISC, HALO)))
               for j in range(2)]  # fmt: skip
    stars = {"phi1": phi1, "phi2": phi2} | dict(zip(MOTIONS, motions, strict=True))
    parts = [norm(mean[0], width).pdf(motions[0]) * norm(mean[1], width).pdf(motions[1])
             for mean, width, _ in (DISC, HALO)]  # fmt: skip
    density = share * parts[0] * (1 + slope * phi2 / (0.5 * HIGH)) + (1 - share) * parts[1]
    return stars, density / HIGH


def mixed(members: int, others: int, seed: int, error: float = 0.1) -> tuple[dict[str, Any], sk.BoolArray, sk.Array]:
    """A table of members and field stars, which are members, and the density of the field at the field stars."""
    rng = np.random.default_rng(seed)
    field, density = two_populations(others, rng)
    parts = members_of_stream(members, rng), field
    stars = {name: np.concatenate([part[name] for part in parts]) for name in field}
    for name in MOTIONS:
        stars[name] = stars[name] + rng.normal(0, error, members + others)
    ra, dec, *pm = sk.sky_frame(FRAME).to_icrs(*(stars[name] for name in ("phi1", *COLUMNS)))
    errors = np.full(members + others, error)
    names = "ra", "dec", "pm_ra_cosdec", "pm_dec", "pm_ra_cosdec_error", "pm_dec_error"
    table = dict(zip(names, (ra, dec, *pm, errors, errors), strict=True))
    inside = np.abs(stars["phi2"]) < 0.5 * HIGH
    assert inside[members:].all()
    is_member = (np.arange(members + others) < members)[inside]
    return {name: column[inside].tolist() for name, column in table.items()}, is_member, density


def test_one_gaussian_is_mean_and_covariance_and_two_are_found() -> None:
    rng = np.random.default_rng(0)
    x = rng.multivariate_normal([1.0, -2.0], [[2.0, 0.6], [0.6, 1.0]], 4000)
    one = fitted(x, np.ones(4000), 1, 0.15)
    np.testing.assert_allclose(one.means[0], x.mean(axis=0))
    least = 0.15**2 * np.diag(x.var(axis=0))
    np.testing.assert_allclose(one.roots[0] @ one.roots[0].T, np.cov(x.T, bias=True) + least)
    expected = multivariate_normal(one.means[0], one.roots[0] @ one.roots[0].T).logpdf(x[:5])
    np.testing.assert_allclose(one.ln_terms(x[:5])[:, 0], expected)
    both = np.concatenate([rng.normal(-3, 0.5, 1000), rng.normal(2, 1.0, 3000)])[:, None]
    two = fitted(both, np.ones(4000), 2, 0.05)
    np.testing.assert_allclose(two.weights, [0.25, 0.75], atol=0.03)
    np.testing.assert_allclose(two.means[:, 0], [-3, 2], atol=0.15)


def test_the_fitted_density_is_that_of_the_field_and_not_of_the_stream() -> None:
    """To a fifth for the median star of the field; and beside the stream, where members are most of the stars."""
    table, truth, density = mixed(300, 1500, seed=1)
    stars = stars_of(table, fraction=0.17, background_gaussians=5)
    fit = stars.catalogue.ln_background
    assert fit is not None
    away = fit[~truth] - np.log(density)
    assert np.median(away) == pytest.approx(0.0, abs=0.1)
    assert np.median(np.abs(away)) < 0.2
    motions = [stars.catalogue.values[name][truth] for name in MOTIONS]
    share = 0.5 + 0.3 * stars.catalogue.phi1[truth] / 40
    parts = [
        norm(mean[0], width).pdf(motions[0]) * norm(mean[1], width).pdf(motions[1]) for mean, width, _ in (DISC, HALO)
    ]
    there = share * parts[0] * (1 + DISC[2] * stars.catalogue.values["phi2"][truth] / (0.5 * HIGH))
    there = (there + (1 - share) * parts[1]) / HIGH
    assert np.median(fit[truth] - np.log(there)) == pytest.approx(0.0, abs=0.25)


@pytest.mark.parametrize(("members", "others"), [(600, 600), (400, 1600)])
def test_chances_by_a_fitted_field_are_calibrated(members: int, others: int) -> None:
    """Of the stars with a chance p the fraction p are members, to 3 %."""
    table, truth, _ = mixed(members, others, seed=2)
    stars = stars_of(table, fraction=members / (members + others), background_gaussians=5)
    chance = stars.membership(stars.predict(the_stream()))
    assert chance.mean() == pytest.approx(truth.mean(), abs=0.02)
    for low, high in ((0.0, 0.1), (0.1, 0.5), (0.5, 0.9), (0.9, 1.0)):
        some = (chance >= low) & (chance <= high)
        scatter = np.sqrt((chance[some] * (1 - chance[some])).sum()) / max(some.sum(), 1)
        assert chance[some].mean() == pytest.approx(truth[some].mean(), abs=3 * scatter + 0.03)


def test_a_column_that_some_stars_lack_has_a_density_of_its_own() -> None:
    """Velocities of a quarter of the stars, of the field alone: a Gaussian."""
    table, truth, _ = mixed(0, 1200, seed=3)
    rng = np.random.default_rng(3)
    velocity = np.where(np.arange(len(truth)) % 4 == 0, rng.normal(20, 100, len(truth)), np.nan)
    without = stars_of(table, fraction=0.1, background_gaussians=2).catalogue.ln_background
    more = table | {"radial_velocity": velocity.tolist(), "radial_velocity_error": np.full(len(truth), 2.0).tolist()}
    both = stars_of(more, fraction=0.1, background_gaussians=2).catalogue.ln_background
    assert both is not None
    assert without is not None
    there = np.isfinite(velocity)
    assert np.median(np.abs(both - without)[~there]) < 0.05
    expected = norm(20, 100).logpdf(velocity[there])
    close = np.abs(velocity[there] - 20) < 150
    assert np.median(np.abs((both - without)[there][close] - expected[close])) < 0.15


def cocoon_of(members: int, wide: int, seed: int) -> tuple[dict[str, Any], sk.BoolArray]:
    """Members of which some are scattered by 6 deg more in phi2."""
    table, _ = catalogue(members, 0, seed)
    rng = np.random.default_rng(seed)
    frame = sk.sky_frame(FRAME)
    phi1, phi2, *pm = frame.from_icrs(*(np.array(table[name]) for name in ("ra", "dec", "pm_ra_cosdec", "pm_dec")))
    is_wide = np.arange(len(phi1)) < wide
    phi2 = phi2 + is_wide * rng.normal(0, 6.0, len(phi1))
    ra, dec, *pm = frame.to_icrs(phi1, phi2, *pm)
    moved = {"ra": ra, "dec": dec, "pm_ra_cosdec": pm[0], "pm_dec": pm[1]}
    return without_field(table) | {name: column.tolist() for name, column in moved.items()}, is_wide


def test_a_cocoon_is_found_with_its_width_and_its_stars() -> None:
    table, is_wide = cocoon_of(600, 180, seed=4)
    window = {"phi1": [-40, 40]}
    stars = stars_of(table, window=window, cocoon_fraction=0.3, cocoon_phi2_dispersion=6.0)
    prediction = stars.predict(the_stream())

    def lnl(**fields: float) -> float:
        return float(stars.model_copy(update=fields).ln_likelihood(prediction, False))

    shares, widths = np.linspace(0.1, 0.6, 11), np.linspace(3, 9, 13)
    assert shares[np.argmax([lnl(cocoon_fraction=x) for x in shares.tolist()])] == pytest.approx(0.3, abs=0.09)
    assert widths[np.argmax([lnl(cocoon_phi2_dispersion=x) for x in widths.tolist()])] == pytest.approx(6.0, abs=1.2)
    thin, wide = stars.membership_of_parts(prediction)
    np.testing.assert_allclose(thin + wide, 1.0)
    for low, high in ((0.0, 0.2), (0.2, 0.6), (0.6, 1.0)):
        some = (wide >= low) & (wide <= high)
        scatter = np.sqrt((wide[some] * (1 - wide[some])).sum()) / some.sum()
        assert wide[some].mean() == pytest.approx(is_wide[some].mean(), abs=4 * scatter + 0.03)
    one = stars_of(table, window=window)
    assert stars.ln_likelihood(prediction, False) > float(one.ln_likelihood(prediction, False)) + 50


def test_the_slopes_of_a_cocoon_are_those_of_ln_l() -> None:
    """The noise of one number at a knot is averaged over, by quadrature here."""
    table, _ = catalogue(200, 200, seed=5)
    stars = stars_of(table, fraction=0.5, knots=6, cocoon_fraction=0.3, cocoon_phi2_dispersion=4.0)
    prediction = stars.predict(the_stream())
    rows, rng = stars.quantities(), np.random.default_rng(5)
    for name in ("phi2", "phi2_spread", "pm_phi2"):
        row = int(rows[name][3])
        variance = np.zeros(len(prediction.mean))
        width = 0.1 * float(prediction.mean[rows[f"{name.removesuffix('_spread')}_spread"][3]])
        variance[row] = width**2
        prediction.mean[row] += width * rng.normal()
        noisy = sk.Prediction(prediction.names, prediction.mean, variance, details=prediction.details)
        nodes, weights = np.polynomial.hermite_e.hermegauss(21)
        lnl = []
        for node in nodes:
            mean = prediction.mean.copy()
            mean[row] += width * node
            exact = sk.Prediction(prediction.names, mean, 0 * variance, details=prediction.details)
            lnl.append(float(stars.ln_likelihood(exact, False)))
        top = max(lnl)
        expected = top + np.log(np.exp(np.array(lnl) - top) @ weights / weights.sum())
        assert stars.ln_likelihood(noisy, True) == pytest.approx(expected, abs=0.3)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"stars": catalogue(30, 0)[0], "background_gaussians": 1}, "density of the field is given twice"),
        ({"fraction": 0.5}, "fit one with background_gaussians"),
        ({"background_gaussians": 4, "fraction": 0.5}, "expected at least 30 stars for each"),
        ({"cocoon_fraction": 0.3}, "found cocoon_fraction = 0.3 and no dispersion"),
        ({"cocoon_phi2_dispersion": 2.0}, "found cocoon_fraction = 0 and phi2"),
    ],
)
def test_a_field_or_cocoon_that_is_wrong_is_refused(given: dict[str, Any], text: str) -> None:
    table = without_field(catalogue(30, 0)[0])
    with pytest.raises(ValidationError, match=text):
        stars_of(**({"table": given.pop("stars", table)} | given))
