"""Priors: normalised densities, quantiles that invert them, and the form in the run file."""

import math

import numpy as np
import pytest
from astropy import units as u
from scipy import integrate, stats

from streamkit.builtin.potentials.bar import Bar
from streamkit.runfile import LogUniform, Normal, Prior, TruncatedNormal, Uniform
from streamkit.runfile.priors import PRIORS, parse, usage
from streamkit.units import GYR, Unit, spelled, unit_called

KPC, NONE = Unit("kpc"), Unit("")

CASES = [
    (Uniform(40.0, 400.0), stats.uniform(40.0, 360.0)),
    (LogUniform(0.1, 20.0), stats.loguniform(0.1, 20.0)),
    (Normal(-2.44, 0.3), stats.norm(-2.44, 0.3)),
    (TruncatedNormal(1.0, 2.0, 0.0, 4.0), stats.truncnorm(-0.5, 1.5, 1.0, 2.0)),
    (TruncatedNormal(0.0, 1.0, 5.0, math.inf), stats.truncnorm(5.0, np.inf, 0.0, 1.0)),
    (TruncatedNormal(0.0, 1.0, -math.inf, -6.0), stats.truncnorm(-np.inf, -6.0, 0.0, 1.0)),
]


def test_a_bar_reads_its_pattern_speed_with_a_unit() -> None:
    assert Bar(**Bar.example | {"pattern_speed": "-35 km/s/kpc"}).pattern_speed == -35
    assert Bar(**Bar.example | {"pattern_speed": "-0.035 km/s/pc"}).pattern_speed == pytest.approx(-35)
    with pytest.raises(ValueError, match=r"expected a quantity in km/\(s kpc\) or a unit like it, found '3 km'"):
        Bar(**Bar.example | {"pattern_speed": "3 km"})


def test_the_unit_of_pattern_speeds_is_read_without_a_remark_of_astropy() -> None:
    assert Unit("1 / Gyr").parse("-39 km/s/kpc") == pytest.approx(-39 * GYR)  # a warning would be an error here


@pytest.mark.parametrize(("prior", "scipy_prior"), CASES, ids=lambda case: repr(case)[:40])
def test_density_and_quantiles_agree_with_scipy(prior: Prior, scipy_prior: stats.rv_continuous) -> None:
    u = np.array([1e-6, 0.1, 0.5, 0.9, 1 - 1e-6])
    x = prior.ppf(u)
    np.testing.assert_allclose(x, scipy_prior.ppf(u), rtol=1e-7)
    np.testing.assert_allclose([prior.lnpdf(value) for value in x], scipy_prior.logpdf(x), rtol=1e-9, atol=1e-9)
    assert prior.centre == pytest.approx(scipy_prior.median(), rel=1e-9)


@pytest.mark.parametrize("prior", [prior for prior, _ in CASES[:4]], ids=repr)
def test_density_integrates_to_one(prior: Prior) -> None:
    low, high = prior.ppf(np.array([0.0, 1.0])) if math.isfinite(prior.support[0]) else (-10.0, 10.0)
    total, _ = integrate.quad(lambda x: math.exp(prior.lnpdf(x)), low, high)
    assert total == pytest.approx(1.0, abs=1e-7)


@pytest.mark.parametrize(
    ("prior", "centre", "width"),
    [
        (Uniform(0.0, 10.0), 5.0, 10.0 * 0.6826894921370859 / 2),
        (LogUniform(1.0, 100.0), 10.0, None),
        (Normal(153.0, 2.0), 153.0, 2.0),
        (TruncatedNormal(153.0, 2.0, 100.0, 206.0), 153.0, 2.0),
    ],
)
def test_centre_is_the_middle_and_width_one_sigma(prior: Prior, centre: float, width: float | None) -> None:
    assert prior.centre == pytest.approx(centre)
    if width is not None:
        low, high = prior.ppf(stats.norm.cdf([-1.0, 1.0]))
        assert 0.5 * (high - low) == pytest.approx(width)


@pytest.mark.parametrize("prior", [prior for prior, _ in CASES if math.isfinite(sum(prior.support))], ids=repr)
def test_density_is_zero_outside_the_support(prior: Prior) -> None:
    low, high = prior.support
    assert prior.lnpdf(low - 1e-9 * (high - low)) == prior.lnpdf(high + 1e-9 * (high - low)) == -math.inf


def test_draws_come_from_the_generator_alone() -> None:
    prior = Normal(10.0, 2.0)
    one, two = (prior.sample(np.random.default_rng(3), 10000) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    assert one.mean() == pytest.approx(10.0, abs=4 * 2.0 / 100)  # four standard errors


@pytest.mark.parametrize("prior", [prior for prior, _ in CASES], ids=repr)
@pytest.mark.parametrize("unit", [KPC, NONE])
def test_document_round_trip(prior: Prior, unit: Unit) -> None:
    assert parse(prior.document(unit), unit) == prior


def test_quantities_of_any_like_unit() -> None:
    assert parse({"uniform": ["500 pc", 2]}, KPC) == Uniform(0.5, 2.0)


@pytest.mark.parametrize(
    ("table", "parts"),
    [
        ({"uniform": [3, 1]}, ["found 3 and 1", "low, high"]),
        ({"uniform": [1, 1]}, ["below"]),
        ({"uniform": [1, math.inf]}, ["finite"]),
        ({"uniform": [1]}, ["found uniform = [1]", "{ uniform = [low, high] }"]),
        ({"uniform": "1 2"}, ["'1 2'"]),
        ({"uniform": ["1 kpc", "2 s"]}, ["'2 s'", "kpc"]),
        ({"uniform": [1, True]}, ["True"]),
        ({"log_uniform": [0, 1]}, ["positive", "found 0"]),
        ({"normal": [1, 0]}, ["sd > 0", "sd 0"]),
        ({"normal": [1, -2]}, ["sd -2"]),
        ({"normal": [math.nan, 1]}, ["finite"]),
        ({"truncated_normal": [0, 1, 2, 1]}, ["found 2 and 1"]),
        ({"truncated_normal": [0, 1, 50, 60]}, ["none of the Gaussian's probability"]),
        ({"unifrom": [1, 2]}, ["Did you mean 'uniform'?", "truncated_normal"]),
        ({"uniform": [1, 2], "normal": [1, 2]}, ["one name", "'uniform', 'normal'"]),
        ({}, ["found nothing"]),
    ],
)
def test_bad_priors_say_what_is_wrong(table: dict[str, object], parts: list[str]) -> None:
    with pytest.raises(ValueError, match=r".") as caught:
        parse(table, KPC)
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("astropy", "ours"),
    [("km / s", "km/s"), ("km/s", "km/s"), ("km2 / (kpc s2)", "km2/(kpc s2)"), ("", "")],
)
def test_units_are_spelled_as_in_run_files(astropy: str, ours: str) -> None:
    assert spelled(u.Unit(astropy)) == spelled(astropy) == ours
    assert Unit(astropy).name == unit_called(astropy).name == ours
    assert u.Unit(ours) == u.Unit(astropy)


def test_usage_and_text_name_the_numbers() -> None:
    assert usage(PRIORS["truncated_normal"]) == "{ truncated_normal = [mean, sd, low, high] }"
    assert Uniform(40.0, 400.0).text("km/s") == "uniform(40, 400) km/s"
    assert Uniform(0.0, 1.0).text() == "uniform(0, 1)"
