"""The track observable: local lines against NumPy, their variance against seeds, the likelihood against formulas."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm, poisson

import streamkit as sk
from streamkit.builtin.observables.track.likelihood import Side, background_of, ln_mixture
from streamkit.builtin.observables.track.lines import REACH, WING, Debris, gather, lines_at, ln_coverage, local_lines
from streamkit.builtin.observables.track.observable import Track
from streamkit.stream import orbital_plane
from streamkit.stream.frames import axes
from streamkit.testing.streams import example_stream, select

AT = np.array([-55.0, -40.0, -30.0, -12.0, 2.0])
FRAME = {"pole": [192.86, 27.13], "origin": [266.4, -28.94]}


def cloud(seed: int, n: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    """Longitudes, and two columns about a parabola and a line."""
    rng = np.random.default_rng(seed)
    phi = rng.normal(-30, 20, n)
    return phi, np.stack([0.01 * phi**2 + rng.normal(0, 0.3, n), -5 * phi + rng.normal(0, 3, n)])


def debris(seed: int) -> Debris:
    phi, columns = cloud(seed)
    return gather(phi, columns, np.ones(len(phi)))


def test_a_line_is_the_weighted_least_squares_of_numpy() -> None:
    phi, columns = cloud(0)
    weight = np.random.default_rng(1).uniform(0.5, 1.5, len(phi))
    found = local_lines(gather(phi, columns, weight), AT, kernel=3.0, enough=0.0)
    for i, at in enumerate(AT):
        x = (phi - at) / 3
        k = weight * (np.exp(-0.5 * x**2) + WING * np.exp(1 - np.sqrt(1 + x**2)))
        k[np.abs(x) > REACH + np.abs(x).min()] = 0.0
        for row, y in enumerate(columns):
            slope, value = np.polyfit(phi - at, y, 1, w=np.sqrt(k))
            assert found.value[row, i] == pytest.approx(value, rel=1e-9)
            spread = np.sqrt(k @ (y - value - slope * (phi - at)) ** 2 / k.sum())
            assert found.spread[row, i] == pytest.approx(spread, rel=1e-9)
        assert found.ln_count[i] == pytest.approx(np.log(k.sum()), abs=1e-9)


def test_lines_together_are_those_that_are_fitted_alone() -> None:
    """In any order, among debris and beyond it: which others are asked for changes nothing."""
    at = np.random.default_rng(5).uniform(-120, 90, 40)
    together = local_lines(debris(0), at, kernel=1.5, depth=0)
    for i in (0, 7, 13, 39):
        alone = local_lines(debris(0), at[i : i + 1], kernel=1.5, depth=0)
        assert together.value[:, i] == pytest.approx(alone.value[:, 0], rel=1e-9)
        assert together.ln_count[i] == pytest.approx(alone.ln_count[0], abs=1e-9)


def test_very_many_lines_are_splines_of_those_that_are_fitted() -> None:
    """To a tenth of their own noise, and of the debris' spread."""
    rng = np.random.default_rng(2)
    longitude = np.concatenate([rng.normal(-10, 15, 3000), rng.normal(30, 3, 200)])
    columns = [5 * np.sin(longitude / 10) + rng.normal(0, 1, 3200), 0.01 * longitude**2 + rng.normal(0, 3, 3200)]
    debris, at = gather(longitude, columns, np.ones(3200), 0.0), rng.uniform(-60, 60, 3000)
    one_by_one, splined = local_lines(debris, at, 2.0, depth=0), lines_at(debris, at, 2.0, depth=0)
    assert (np.abs(splined.value - one_by_one.value) < 0.1 * np.sqrt(one_by_one.variance)).all()
    np.testing.assert_allclose(splined.spread, one_by_one.spread, rtol=2e-3)
    np.testing.assert_allclose(splined.ln_count, one_by_one.ln_count, atol=2e-3)
    few = lines_at(debris, at[:50], 2.0, depth=0)
    np.testing.assert_array_equal(few.value, local_lines(debris, at[:50], 2.0, depth=0).value)


def test_a_straight_stream_is_found_exactly() -> None:
    phi = np.linspace(-60, 10, 5000)
    found = local_lines(gather(phi, np.array([3 - 0.2 * phi]), np.ones(5000)), AT, kernel=2.0)
    assert found.value[0] == pytest.approx(3 - 0.2 * AT, abs=1e-3)
    assert found.spread[0] == pytest.approx(0, abs=0.02)


def test_the_variance_is_the_scatter_over_seeds() -> None:
    found = [local_lines(debris(seed), AT, kernel=2.0, depth=1) for seed in range(150)]
    for values, variances in (
        ([f.value for f in found], [f.variance for f in found]),
        ([f.spread[1] for f in found], [f.depth_variance for f in found]),
    ):
        ratio = np.sqrt(np.mean(variances, axis=0)) / np.std(values, axis=0)
        assert ((ratio > 0.8) & (ratio < 1.3)).all(), ratio


def test_a_few_particles_have_the_spread_of_many() -> None:
    """At 25 particles under a kernel, where those at other longitudes have ten times the spread."""
    spreads = []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        phi = rng.uniform(-60, 60, 600)
        y = 0.2 * phi + rng.normal(0, np.where(phi < 10, 1.0, 10.0))
        spreads.append(local_lines(gather(phi, y[None], np.ones(600)), np.array([-40, -20, 30, 45]), 2.0).spread[0])
    assert np.mean(spreads, axis=0) == pytest.approx([1, 1, 10, 10], rel=0.06)


def test_beyond_the_debris_the_density_falls_smoothly_and_the_variance_grows() -> None:
    at = np.linspace(60, 200, 300)
    found = local_lines(debris(3), at, kernel=2.0)
    fall = np.diff(found.ln_count) / np.diff(at)
    assert fall == pytest.approx(-0.5, abs=0.06)  # one e-folding for every kernel
    assert (np.diff(found.variance, axis=1) > 0).all()
    assert found.ln_count[0] - found.ln_count[-1] == pytest.approx(70, abs=1)
    assert np.abs(np.diff(found.value[1])).max() < 3  # no jumps


def test_the_seam_of_the_circle_is_nowhere() -> None:
    phi, columns = cloud(0)
    first = local_lines(gather(phi, columns, np.ones(len(phi)), 360.0), AT, kernel=2.0)
    turned = (phi + 30 + 180) % 360 - 180
    moved = local_lines(gather(turned, columns, np.ones(len(phi)), 360.0), AT + 30, kernel=2.0)
    np.testing.assert_allclose(moved.value, first.value, rtol=1e-9)
    beyond = [(angle + 210 + 180) % 360 - 180 for angle in (phi, AT)]
    edge = local_lines(gather(beyond[0], columns, np.ones(len(phi)), 360.0), beyond[1], kernel=2.0)
    np.testing.assert_allclose(edge.value, first.value, rtol=1e-9)


def test_the_mixture_is_its_formula() -> None:
    rng = np.random.default_rng(0)
    value, mean, error = rng.normal(0, 5, 20), rng.normal(0, 5, 20), rng.uniform(0.5, 2, 20)
    coverage = np.log(rng.uniform(0.1, 1, 20))
    plain = ln_mixture(Side(value, error**2, mean, np.zeros(20), 0.0, (0.0, 9.0)))
    assert plain.sum() == pytest.approx(norm(mean, error).logpdf(value).sum())
    parts = [np.log(0.7) + coverage + norm(mean, error).logpdf(value), np.log(0.3) + norm(1.0, 9.0).logpdf(value)]
    found = ln_mixture(Side(value, error**2, mean, coverage, 0.3, (1.0, 9.0)))
    assert found == pytest.approx(logsumexp(parts, axis=0))
    assert background_of(np.array([3.0]), np.array([2.0]), 0.1) == (3.0, 6.0)


def table(name: str, phi1: Any, value: Any, error: float) -> dict[str, list[float]]:
    return {"phi1": list(phi1), name: list(value), "error": [error] * len(phi1)}


def track(**fields: Any) -> Track:
    return Track(frame=FRAME, **fields)


@pytest.fixture(scope="module")
def stream() -> sk.Stream:
    return example_stream()


@pytest.fixture(scope="module")
def places(stream: sk.Stream) -> np.ndarray:
    phi1 = stream.seen(FRAME).lon[~stream.bound]
    return np.percentile(phi1, [20, 35, 50, 65, 80])


def test_stars_are_compared_with_the_spread_and_means_with_the_line(stream: sk.Stream, places: np.ndarray) -> None:
    given = table("distance", places, [20.0] * 5, 1.0)
    for stars in ((), ("distance",)):
        observable = track(distance=given, stars=stars, distance_dispersion=0.7)
        prediction = observable.predict(stream)
        spread, coverage = prediction.details["spread"], prediction.details["ln_coverage"]
        for noise in (False, True):
            total = 1.0 + 0.49 + spread**2 * bool(stars) + prediction.variance * noise
            expected = (norm(prediction.mean, np.sqrt(total)).logpdf(20.0) + coverage).sum()
            assert observable.ln_likelihood(prediction, noise) == pytest.approx(expected)


def test_a_modulus_is_the_distance_on_another_scale(stream: sk.Stream, places: np.ndarray) -> None:
    distance = track(distance=table("distance", places, [20.0] * 5, 1.0), kernel=0.5).predict(stream).mean
    modulus = track(distance_modulus=table("distance_modulus", places, [16.0] * 5, 0.1), kernel=0.5).predict(stream)
    assert 10 ** (modulus.mean / 5 - 2) == pytest.approx(distance, rel=0.06)  # of wide debris the means differ


def test_gsr_velocities_may_be_those_of_another_sun(stream: sk.Stream, places: np.ndarray) -> None:
    """A table that was corrected with our own Sun is the same as one without, and (0, 0, 0) is heliocentric."""
    given = table("radial_velocity", places, [20.0] * 5, 1.0)
    helio = track(radial_velocity=given).predict(stream).mean
    gsr = track(radial_velocity=given, velocity_frame="gsr").predict(stream).mean
    own = track(radial_velocity=given, velocity_frame="gsr", gsr_sun=list(stream.sun.velocity)).predict(stream).mean
    none = track(radial_velocity=given, velocity_frame="gsr", gsr_sun=[0, 0, 0]).predict(stream).mean
    np.testing.assert_allclose(own, gsr, rtol=1e-9)
    np.testing.assert_allclose(none, helio, rtol=1e-9)
    assert np.abs(gsr - helio).max() > 20


def test_longitudes_of_any_turn_are_the_same(stream: sk.Stream, places: np.ndarray) -> None:
    first = track(phi2=table("phi2", places, [0.0] * 5, 1.0)).predict(stream)
    moved = track(phi2=table("phi2", places % 360, [0.0] * 5, 1.0)).predict(stream)
    np.testing.assert_allclose(moved.mean, first.mean, rtol=1e-9)


@pytest.fixture(scope="module")
def along(stream: sk.Stream) -> tuple[tuple[float, ...], ...]:
    """A frame whose equator is the orbital plane, with the progenitor near phi1 = 0."""
    first, second = orbital_plane(stream.orbit)
    rows = np.array([first, second, np.cross(first, second)]) @ axes("icrs")
    return tuple(tuple(row) for row in rows.tolist())


def test_unwrapped_longitudes_follow_the_winding(stream: sk.Stream, along: Any) -> None:
    """They are phi1 up to whole turns, and differ from the angle at the centre by the parallax of R0 alone."""
    longitude = stream.unwrapped_longitude(along)
    turns = (longitude - stream.seen(along).lon) / 360
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    mirrored = stream.unwrapped_longitude(np.diag([1.0, -1.0, 1.0]) @ np.array(along))
    np.testing.assert_allclose(mirrored, -longitude, atol=1e-9)
    far = ~stream.bound & (stream.r > 12)
    parallax = longitude[far] - np.degrees(stream.winding[far])
    assert (np.abs(parallax) < np.degrees(np.arcsin(8 / stream.r[far])) + 10).all()  # the plane is not through the Sun
    assert np.ptp(longitude) > 400


def test_wraps_of_one_longitude_are_told_apart_and_two_branches_are_a_depth(stream: sk.Stream, along: Any) -> None:
    """Debris one turn ahead is put at twice the distance: wrapped together a depth, unwrapped two distances."""
    stream = select(stream, np.abs(stream.winding) < 2)
    more = replace(
        stream,
        q=np.hstack([stream.q, (stream.q - stream.sun.q[:, None]) * 2 + stream.sun.q[:, None]]),
        v=np.hstack([stream.v, stream.v]),
        winding=np.concatenate([stream.winding, stream.winding + 2 * np.pi]),
        **{name: np.concatenate([getattr(stream, name)] * 2) for name in ("bound", "weight", "tail", "chi")},
        **{name: np.concatenate([getattr(stream, name)] * 2) for name in ("t_strip", "t_release")},
        **{name: np.hstack([getattr(stream, name)] * 2) for name in ("dq_galactocentric", "dv_galactocentric")},
    )
    at = -60.0
    fields = {"distance": table("distance", [at, at + 360], [20.0, 40.0], 1.0), "frame": along, "arm": "both",
              "distance_depth": table("depth", [at], [1.0], 0.1), "kernel": 1.0}  # fmt: skip
    apart, together = (Track(**fields, unwrapped=each).predict(more) for each in (True, False))
    near, far, depth = apart.mean
    assert far == pytest.approx(2 * near, rel=0.05)
    assert together.mean[0] == pytest.approx(together.mean[1], rel=1e-6)
    assert together.mean[0] == pytest.approx((near + far) / 2, rel=0.1)
    assert together.mean[2] ** 2 == pytest.approx((near / 2) ** 2 + (1 + 4) / 2 * depth**2, rel=0.15)


def test_where_there_is_no_debris_is_said(stream: sk.Stream, places: np.ndarray) -> None:
    observable = track(phi2=table("phi2", [places[2], places[2] + 180], [0.0, 0.0], 1.0), arm="leading")
    prediction = observable.predict(stream)
    assert not prediction.why_not
    (text,) = observable.remarks(prediction)
    assert "1 of its longitudes lie where the stream has no debris" in text
    assert observable.remarks(track(phi2=table("phi2", places, [0.0] * 5, 1.0)).predict(stream)) == ()


def test_data_that_see_little_of_the_debris_are_said(stream: sk.Stream, places: np.ndarray) -> None:
    """Between the ends of the data, by counting particles."""
    longitude = stream.seen(FRAME).lon[~stream.bound]
    for part, said in ((np.linspace(*np.quantile(longitude, [0.3, 0.5]), 9), True), (places, False)):
        observable = track(phi2=table("phi2", part, [0.0] * len(part), 1.0))
        prediction = observable.predict(stream)
        counted = np.mean((longitude > part.min()) & (longitude < part.max()))
        assert float(prediction.details["near"]) == pytest.approx(counted, abs=0.05)
        assert any("beyond the longitudes of the data" in text for text in observable.remarks(prediction)) == said


def test_a_datum_of_one_star_and_several_at_one_longitude_are_data(stream: sk.Stream, places: np.ndarray) -> None:
    one = track(phi2=table("phi2", places[:1], [0.0], 1.0), phi2_outliers=0.1)
    assert np.isfinite(one.ln_likelihood(one.predict(stream), False))
    twice = track(phi2=table("phi2", [places[0]] * 2, [0.0, 0.0], 1.0))
    prediction = twice.predict(stream)
    assert prediction.names == (f"phi2 at {places[0]:g}", f"phi2 at {places[0]:g} (2)")
    assert prediction.mean[0] == prediction.mean[1]


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({}, "there are no data"),
        (
            {"phi2": {"phi1": [1.0], "phi2": [0.0], "error": [0.0]}},
            r"entry \[0\] is 0 deg, expected positive",
        ),
        ({"phi2": {"phi1": [1.0], "phi2": [0.0]}}, "'error' is missing"),
        ({"phi2": {"phi1": [-200.0, 200.0], "phi2": [0.0, 1.0], "error": [1.0, 1.0]}}, "more than a turn"),
        (
            {"stars": ["phi2"], "distance": table("distance", [1], [8.0], 1.0)},
            "no table of .phi2.; there is distance",
        ),
        ({"distance": table("distance", [1], [8.0], 1.0), "gsr_sun": [1.0, 2.0, 3.0]}, "three velocities"),
        ({"frame": "GD1Koposov"}, "Did you mean 'GD1Koposov10'"),
    ],
)
def test_bad_input_is_said(fields: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Track(**({"frame": FRAME} | fields))


def test_a_track_of_fifty_data_is_cheap(stream: sk.Stream, places: np.ndarray) -> None:
    at = np.linspace(places[0], places[-1], 50)
    given = {
        n: table(n, at, at * 0 + 1, 1.0) for n in ("phi2", "distance", "pm_phi1_cosphi2", "pm_phi2", "radial_velocity")
    }
    observable = track(**given)
    observable.predict(stream)
    begin = time.process_time()
    for _ in range(5):
        observable.predict(stream)
    assert (time.process_time() - begin) / 5 < 0.04
    assert observable.predict(stream).details["ln_coverage"].min() > np.log(0.9)


def test_the_coverage_is_the_chance_of_any_particle() -> None:
    n = np.geomspace(1e-12, 30.0, 40)
    assert ln_coverage(np.log(n)) == pytest.approx(poisson.logsf(0, n), rel=1e-9)
    assert ln_coverage(np.array([-1e4, 700.0])) == pytest.approx([-1e4, 0.0])


def test_more_debris_where_there_is_enough_is_no_more_likely(stream: sk.Stream, places: np.ndarray) -> None:
    """A stream that is ten times as dense has the same ln L but for the noise: a pull on the width was seen once."""
    observable = track(distance=table("distance", places, [20.0] * 5, 1.0))
    denser = replace(stream, weight=10 * stream.weight)
    once, tenfold = (observable.predict(each) for each in (stream, denser))
    assert observable.ln_likelihood(tenfold, False) == pytest.approx(observable.ln_likelihood(once, False), abs=0.05)
