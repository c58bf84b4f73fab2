"""`sky_frame`: against astropy's SkyOffsetFrame and great circles, and gala's frames where gala is installed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from astropy import coordinates as c
from astropy import units as u

import streamkit as sk

PM = u.mas / u.yr
RA, DEC = np.array([140.0, 10.0, 200.0]), np.array([30.0, -50.0, 75.0])
MOTION = np.array([-5.0, 2.0, 0.3]), np.array([-8.0, 1.0, 4.0])
STARS = c.SkyCoord(
    ra=RA * u.deg, dec=DEC * u.deg, distance=[9, 20, 30] * u.kpc, pm_ra_cosdec=MOTION[0] * PM, pm_dec=MOTION[1] * PM
)


def offset_frame(turn: float = 30.0) -> tuple[c.SkyOffsetFrame, sk.SkyFrame]:
    """astropy's frame about a place, and ours from the place of its pole."""
    theirs = c.SkyOffsetFrame(origin=c.ICRS(120 * u.deg, 20 * u.deg), rotation=turn * u.deg)
    pole = c.SkyCoord(0 * u.deg, 90 * u.deg, frame=theirs).icrs
    return theirs, sk.sky_frame(pole=(pole.ra.deg, pole.dec.deg), origin=(120, 20))


def test_a_pole_and_an_origin_are_astropys_frame_about_the_origin() -> None:
    theirs, ours = offset_frame()
    expected = STARS.transform_to(theirs)
    result = ours.from_icrs(RA, DEC, *MOTION)
    np.testing.assert_allclose(result.phi1, expected.lon.wrap_at(180 * u.deg).deg, atol=1e-9)
    np.testing.assert_allclose(result.phi2, expected.lat.deg, atol=1e-9)
    np.testing.assert_allclose(result.pm_phi1_cosphi2, expected.pm_lon_coslat.to_value(PM), atol=1e-9)
    np.testing.assert_allclose(result.pm_phi2, expected.pm_lat.to_value(PM), atol=1e-9)


@pytest.mark.parametrize("name", ["GD1Koposov10", "SagittariusBelokurov14", "icrs"])
def test_to_icrs_and_back_and_astropy_as_our_arrays(name: str) -> None:
    """Right-handed and left-handed."""
    frame = sk.sky_frame(name)
    there = frame.from_icrs(RA, DEC, *MOTION)
    np.testing.assert_allclose(frame.to_icrs(*there), (RA, DEC, *MOTION), atol=1e-9)
    sky = STARS.transform_to(frame.to_astropy())
    np.testing.assert_allclose(there.phi1, sky.phi1.deg, atol=1e-9)
    np.testing.assert_allclose(there.pm_phi2, sky.pm_phi2.to_value(PM), atol=1e-9)
    np.testing.assert_allclose(frame.from_icrs(RA * u.deg, np.radians(DEC) * u.rad)[:2], there[:2], atol=1e-9)
    assert np.isnan(frame.from_icrs(RA, DEC).pm_phi2).all()


def test_errors_of_proper_motions_turn_as_a_sample_of_them_does() -> None:
    """Ten thousand motions drawn from a covariance in ICRS, transformed by astropy."""
    theirs, ours = offset_frame()
    covariance = np.array([[0.04, 0.015], [0.015, 0.01]])
    drawn = np.random.default_rng(0).multivariate_normal([1.0, -2.0], covariance, 10000).T
    ra, dec = np.full(10000, RA[0]), np.full(10000, DEC[0])
    sky = c.SkyCoord(ra * u.deg, dec * u.deg, pm_ra_cosdec=drawn[0] * PM, pm_dec=drawn[1] * PM).transform_to(theirs)
    turn = ours.turn(RA, DEC)
    np.testing.assert_allclose(
        turn[0] @ np.cov(drawn) @ turn[0].T, np.cov(sky.pm_lon_coslat.to_value(PM), sky.pm_lat.to_value(PM)), atol=1e-9
    )
    np.testing.assert_allclose(turn @ turn.swapaxes(1, 2), np.broadcast_to(np.eye(2), (3, 2, 2)), atol=1e-12)
    assert abs(turn[0] - np.eye(2)).max() > 0.1


def test_two_ends_are_on_the_equator_and_zero_is_between_them() -> None:
    """Positions and angles by astropy; an origin of one's own is where it should be."""
    ends = (150.0, 20.0), (200.0, 55.0)
    frame = sk.sky_frame(ends=ends)
    first, second = (c.SkyCoord(*end, unit="deg") for end in ends)
    there = frame.from_icrs(*np.array(ends).T)
    half = first.separation(second).deg / 2
    np.testing.assert_allclose(there.phi1, [-half, half], atol=1e-9)
    np.testing.assert_allclose(there.phi2, 0, atol=1e-9)
    origin = frame.from_icrs(*sk.sky_frame(ends=ends, origin=ends[1]).origin)
    assert float(origin.phi1) == pytest.approx(half)
    np.testing.assert_allclose(frame.matrix, sk.sky_matrix({"ends": ends}), atol=1e-12)


def test_stars_about_a_great_circle_give_it() -> None:
    """Stars scattered by 0.3 deg about the equator of astropy's frame: its pole to 0.1 deg, and northern."""
    rng, n = np.random.default_rng(1), 400
    theirs, ours = offset_frame(-20.0)
    stars = c.SkyCoord(rng.uniform(-40, 40, n) * u.deg, rng.normal(0, 0.3, n) * u.deg, frame=theirs).icrs
    for given in (stars, (stars.ra.deg, stars.dec.deg)):
        frame = sk.sky_frame(stars=given)
        apart = c.SkyCoord(*frame.pole, unit="deg").separation(c.SkyCoord(*ours.pole, unit="deg")).deg
        assert min(apart, 180 - apart) < 0.1
        assert frame.pole[1] > 0
        seen = frame.from_icrs(stars.ra, stars.dec)
        assert seen.phi2.std() == pytest.approx(0.3, abs=0.05)
        assert abs(seen.phi1.mean()) < 1
    assert sk.sky_frame(stars=stars, origin=(120, 20)).from_icrs(120, 20).phi1 == pytest.approx(0, abs=1e-9)


def test_stars_all_around_the_sky_give_their_circle() -> None:
    phi1 = np.arange(0.0, 360.0, 5.0)
    ra, dec, *_ = sk.sky_frame("GD1Koposov10").to_icrs(phi1, np.zeros(72))
    seen = sk.sky_frame(stars=(ra, dec)).from_icrs(ra, dec)
    np.testing.assert_allclose(seen.phi2, 0, atol=1e-9)


@pytest.mark.parametrize("name", ["GD1Koposov10", "SagittariusLaw10"])
def test_the_line_of_a_run_file_is_the_frame(name: str) -> None:
    import tomllib

    frame = sk.sky_frame(name)
    np.testing.assert_allclose(sk.sky_matrix(tomllib.loads(frame.to_toml())["frame"]), frame.matrix, atol=1e-9)
    assert ("left-handed" in repr(frame)) == (name == "SagittariusLaw10")
    assert sk.sky_frame(frame) is frame
    np.testing.assert_allclose(sk.sky_matrix(frame), frame.matrix, atol=1e-12)


def test_galas_frame_from_two_ends() -> None:
    gala = pytest.importorskip("gala.coordinates")
    ends = c.SkyCoord([150, 200] * u.deg, [20, 55] * u.deg)
    theirs = gala.GreatCircleICRSFrame.from_endpoints(ends[0], ends[1])
    expected = STARS.transform_to(theirs)
    result = sk.sky_frame(ends=((150, 20), (200, 55))).from_icrs(RA, DEC)
    np.testing.assert_allclose(np.abs(result.phi2), np.abs(expected.phi2.deg), atol=1e-6)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({}, "one of frame, pole, ends and stars; found none"),
        ({"frame": "icrs", "pole": (1, 2)}, "found frame and pole"),
        ({"frame": "GD1Koposov10", "origin": (1, 2)}, "has an origin of its own"),
        ({"frame": "GD1"}, "no frame 'GD1'"),
        ({"pole": (30, 40), "origin": (200, 0)}, "49 deg off the great circle of its pole, expected at most 10"),
        ({"pole": (30, 40)}, "takes pole and origin"),
        ({"ends": ((1, 2), (1, 2))}, "many great circles"),
        ({"ends": (1, 2)}, r"expected \[ra, dec\]"),
        ({"ends": "here"}, "expected .*ra, dec.*, .*ra, dec"),
        ({"pole": (float("nan"), 0), "origin": (0, 0)}, "for the pole of the frame"),
        ({"stars": ([1, 2], [3])}, "expected the same number"),
        ({"stars": ([1, float("nan")], [3, 4])}, "no finite number"),
        ({"stars": "stars.ecsv"}, "two arrays in degrees"),
        ({"stars": ([10, 10, 12, 12], [20, 22, 20, 22])}, "along no great circle"),
    ],
)
def test_what_gives_no_frame_is_refused(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        sk.sky_frame(**given)


def test_half_a_proper_motion_is_refused() -> None:
    with pytest.raises(ValueError, match="two components"):
        sk.sky_frame("icrs").from_icrs(1, 2, pm_dec=3)


@pytest.mark.parametrize(
    ("place", "text"),
    [
        (([1, 2], [3]), r"arrays of the shapes \(1,\) and \(2,\): one shape is wanted, or a number for all"),
        ((1.0, 95.0), "of 95 deg is beyond 90 deg; are longitude and latitude exchanged"),
        (([10.0, 20.0], [30.0, -91.5]), "of -91.5 deg is beyond"),
        (
            ([1, 2], [3, 4], [1, 2, 3], [1, 2, 3]),
            r"places and proper motions are arrays of the shapes \(2,\) and \(3,\)",
        ),
    ],
)
def test_places_that_are_none_are_refused(place: tuple[Any, ...], text: str) -> None:
    for turn in (sk.sky_frame("icrs").from_icrs, sk.sky_frame("icrs").to_icrs):
        with pytest.raises(ValueError, match=text):
            turn(*place)


def test_a_number_goes_with_an_array_and_the_poles_are_places() -> None:
    frame = sk.sky_frame(pole=(0, 90), origin=(0, 0))
    assert np.allclose(frame.from_icrs([10.0, 20.0], 5.0).phi2, 5.0)
    assert np.allclose(frame.from_icrs([10.0, 20.0], [90.0, -90.0]).phi2, [90.0, -90.0])
    assert np.isnan(frame.from_icrs([10.0, 20.0], [np.nan, 1.0]).phi2[0])


@pytest.mark.parametrize(("name", "meant"),
                         [("gd1", "GD1Koposov10"), ("GD-1", "GD1Koposov10"), ("mag", "MagellanicStreamNidever08"),
                          ("orphan", "OrphanKoposov19' or 'OrphanNewberg10")])  # fmt: skip
def test_the_beginning_of_a_frames_name_is_enough_for_a_hint(name: str, meant: str) -> None:
    with pytest.raises(ValueError, match=rf"there is no frame '{name}'\. Did you mean '{meant}'\?"):
        sk.sky_frame(name)
