"""What is measured between streams, against streams made by hand and against the N-body runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from snapshots import nbody_stream, run_file

from streamkit import G, Model, Orbit, Stream
from streamkit.builtin.potentials.closed_forms import Kepler
from streamkit.model import Host
from streamkit.observe import mean_track, quantiles
from streamkit.study.ablation.measures import Portrait, angular_momentum, compare, match_rate

N = 8000
RNG = np.random.default_rng(8)
ANGLE = np.concatenate([RNG.uniform(0, 80, N // 2), -RNG.uniform(0, 120, N // 2)])
SCATTER = RNG.normal(0, 1, (3, N))


def by_hand(
    angle: Any = ANGLE, r: Any = 30.0, height: Any = 0.0, weight: Any = 1.0, bound: Any = False, scatter: Any = 0.0
) -> Portrait:
    """A stream in the plane of a circular orbit of 30 kpc, at angles in degrees and at radii and heights."""
    n = len(angle)
    radius = r + scatter * np.resize(SCATTER[0], n)
    z = height + scatter * np.resize(SCATTER[1], n)
    a = np.radians(angle)
    t = np.linspace(-1.0, 0.0, 201)
    track = np.array([30 * np.cos(7 * t), 30 * np.sin(7 * t), 0 * t])
    speed = 210 * np.array([-np.sin(7 * t), np.cos(7 * t), 0 * t])
    orbit = Orbit(t, track, speed, -(7**2) * track, np.full(len(t), 2.0))
    none = np.full((3, n), np.nan)
    stream = Stream(
        q=np.array([radius * np.cos(a), radius * np.sin(a), z]),
        v=210 * np.array([-np.sin(a), np.cos(a), 0 * a]),
        t_release=np.full(n, -1.0), t_strip=np.full(n, -0.5), dq_galactocentric=none,
        dv_galactocentric=none, tail=np.ones(n, dtype=np.int64), winding=a, chi=-a,
        bound=np.broadcast_to(bound, n).copy(), weight=np.broadcast_to(weight, n).astype(float), orbit=orbit,
    )  # fmt: skip
    return Portrait(stream, run_file("A").bind())


def test_percentiles_are_numpys_for_equal_weights_and_those_of_repeated_values_for_others() -> None:
    values, percent = RNG.normal(size=2001), (0.5, 16.0, 50.0, 99.5)
    assert quantiles(values, np.full(2001, 0.3), percent) == pytest.approx(np.percentile(values, percent))
    times = RNG.integers(1, 4, 2001)
    repeated = np.percentile(np.repeat(values, times), percent)
    assert quantiles(values, times.astype(float), percent) == pytest.approx(repeated, abs=0.05)


def test_the_length_of_each_tail_is_where_the_winding_ends() -> None:
    result = by_hand().measures()
    low, high = np.percentile(ANGLE, [0.5, 99.5])
    assert result["length_leading"] == pytest.approx(high)
    assert result["length_trailing"] == pytest.approx(-low)
    assert compare(by_hand(0.5 * ANGLE), by_hand())["length_ratio"] == pytest.approx(0.5)


@pytest.mark.parametrize(("change", "distance"), [({"r": 31.5}, 1.5), ({"height": -2.0}, 2.0)])
def test_a_shifted_stream_is_away_by_its_shift(change: dict[str, float], distance: float) -> None:
    measures = compare(by_hand(scatter=0.5, **change), by_hand(scatter=0.5))
    for arm in ("leading", "trailing"):
        assert measures[f"track_{arm}"] == pytest.approx(distance, abs=0.02)


def test_the_distance_is_across_the_track() -> None:
    """A logarithmic spiral r = 30 exp(k angle) makes the angle arctan(k) with the circle: delta r cos(arctan k)."""
    k = 0.8
    r = 30 * np.exp(k * np.radians(ANGLE))
    measures = compare(by_hand(r=1.02 * r), by_hand(r=r))
    a = np.linspace(0, np.percentile(ANGLE, 99.5), 500)
    across = 0.02 * 30 * np.exp(k * np.radians(a)) / np.sqrt(1 + k**2)
    expected = np.sqrt(np.average(across**2, weights=np.exp(k * np.radians(a))))
    assert measures["track_leading"] == pytest.approx(expected, rel=0.03)


def test_two_samples_of_one_stream_are_not_apart_but_for_their_noise() -> None:
    """4 kpc of scatter leave 0.4 kpc of noise in each mean: it is taken off."""
    draws = np.random.default_rng(1).normal(0, 4, (2, 2, N))
    one, two = (by_hand(r=30 + dr, height=z) for dr, z in draws)
    raw = mean_track(one.stream, 1).r - mean_track(two.stream, 1).r
    assert np.std(raw[10:70]) > 0.3
    assert compare(one, two)["track_leading"] < 0.25


def test_near_ends_where_the_reference_is_60_kpc_away() -> None:
    """The spiral r = 30 kpc + angle in degrees is 60 kpc from (30, 0) at 47 degrees, by the law of cosines."""
    assert np.sqrt(77**2 + 30**2 - 2 * 77 * 30 * np.cos(np.radians(47))) == pytest.approx(60, abs=0.7)
    spiral = 30 + np.abs(ANGLE)
    beyond = compare(by_hand(r=np.where(np.abs(ANGLE) > 60, spiral + 20, spiral)), by_hand(r=spiral))
    within = compare(by_hand(r=np.where(np.abs(ANGLE) < 30, spiral + 20, spiral)), by_hand(r=spiral))
    for arm in ("leading", "trailing"):
        assert beyond[f"track_near_{arm}"] < 0.2
        assert beyond[f"track_{arm}"] > 5
        assert within[f"track_near_{arm}"] > 5


def test_widths_are_ratios() -> None:
    measures = compare(by_hand(scatter=1.0), by_hand(scatter=0.5))
    assert measures["width_ratio_leading"] == pytest.approx(2.0, rel=1e-6)
    assert measures["thickness_ratio_trailing"] == pytest.approx(2.0, rel=1e-6)


def test_weights_stand_for_particles() -> None:
    """A particle of weight 3 counts as three, in tracks, lengths, distances and the fraction bound."""
    times = np.where(SCATTER[2] > 0, 3, 1)
    again = np.repeat(np.arange(N), times)
    r = 30 + SCATTER[0]
    bound = SCATTER[1] > 1
    weighted = by_hand(r=r, weight=times / times.mean(), bound=bound)
    repeated = by_hand(ANGLE[again], r=r[again], bound=bound[again])
    a, b = mean_track(weighted.stream, -1), mean_track(repeated.stream, -1)
    assert a.r == pytest.approx(b.r, nan_ok=True)
    assert a.density == pytest.approx(b.density)
    assert weighted.measures()["bound"] == pytest.approx(repeated.measures()["bound"])
    other = by_hand(ANGLE + 1)
    assert compare(weighted, other)["density_distance_trailing"] == pytest.approx(
        compare(repeated, other)["density_distance_trailing"]
    )


def test_a_stream_turned_by_five_degrees_is_five_degrees_away() -> None:
    ahead = ANGLE + np.where(ANGLE > 0, 5, 0)
    measures = compare(by_hand(ahead), by_hand())
    assert measures["density_distance_leading"] == pytest.approx(5.0)
    assert measures["density_distance_trailing"] == 0


def test_energy_and_angular_momentum_of_a_kepler_orbit() -> None:
    """E = v^2/2 - G M / r, L = |x cross v|."""
    q, v = np.array([[10.0], [0.0], [0.0]]), np.array([[50.0], [120.0], [0.0]])
    result = Host({"kepler": Kepler(mass=1e11)}).energy(q, v)
    assert result is not None
    assert result[0] == pytest.approx(0.5 * (50**2 + 120**2) - G * 1e11 / 10)
    assert angular_momentum(q, v)[0] == pytest.approx(1200.0)


def test_a_stream_that_is_all_bound_has_no_measures_but_the_fraction() -> None:
    portrait = by_hand(bound=True)
    result, outcome = portrait.measures(), compare(portrait, by_hand())
    assert result.pop("bound") == pytest.approx(1.0)
    assert np.isnan([*result.values(), *outcome.values()]).all()


@pytest.mark.parametrize("name", ["A", "B"])
def test_with_gravity_mlcs_has_the_nbody_stream_and_without_half_of_it(name: str) -> None:
    """Gibbons+ 2014, figure 5; the energies after section 3.3: the debris without gravity is less far off."""
    spec = run_file(name)
    nbody = Portrait(nbody_stream(name), spec.bind())
    result = {}
    for on in (True, False):
        variant = spec.with_values({"stripping.progenitor_gravity": on})
        portrait = Portrait(Model(variant).stream(), variant.bind())
        result[on] = compare(portrait, nbody) | portrait.measures()
    assert result[True]["length_ratio"] == pytest.approx(1.0, abs=0.1)
    assert 0.4 < result[False]["length_ratio"] < 0.6
    assert result[True]["track_near_trailing"] < 1.0 < result[False]["track_near_trailing"]
    for arm in ("leading", "trailing"):
        assert result[True][f"track_near_{arm}"] < 0.7 * result[False][f"track_near_{arm}"]
        for what in ("energy", "angular_momentum"):
            key = f"{what}_offset_{arm}"
            assert result[True][key] == pytest.approx(nbody.measures()[key], rel=0.15)
            assert abs(result[False][key]) < 0.6 * abs(nbody.measures()[key])
    assert result[True]["energy_distance"] < 0.3 * result[False]["energy_distance"]


def test_a_matched_rate_gives_the_mean_track_that_releasing_so_would() -> None:
    """Two epochs at 30 and 40 kpc, three to one in the reference and one to one here: the mean goes from 35 to 32.5."""
    rng = np.random.default_rng(5)
    streams = []
    for share in (0.5, 0.25):
        late = rng.random(N) < share
        portrait = by_hand(r=np.where(late, 40.0, 30.0), bound=np.arange(N) % 5 == 0)
        streams.append(replace(portrait.stream, t_strip=np.where(late, -0.15, -0.75)))
    stream, reference = streams
    matched = match_rate(stream, reference)
    inner = slice(20, 60)
    assert mean_track(stream, 1).r[inner].mean() == pytest.approx(35.0, abs=0.3)
    assert mean_track(matched, 1).r[inner].mean() == pytest.approx(32.5, abs=0.3)
    assert matched.weight.mean() == pytest.approx(1.0)
    assert matched.weight[stream.bound] == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["A", "B"])
def test_with_the_mass_and_the_rate_of_the_live_satellite_mlcs_is_the_nbody_stream(name: str) -> None:
    """Gibbons+ 2014: 'almost indistinguishable'. The satellite ends with 0.66 of its mass (the N-body's README)."""
    spec = run_file(name).with_values({"progenitor.mass": 0.66 * 6.4e8})
    nbody = Portrait(nbody_stream(name), spec.bind())
    model = Portrait(match_rate(Model(spec).stream(), nbody.stream), spec.bind())
    measures = compare(model, nbody)
    assert measures["length_ratio"] == pytest.approx(1.0, abs=0.05)
    assert measures["track_near_leading"] < 1.0
    assert measures["track_near_trailing"] < 1.0
