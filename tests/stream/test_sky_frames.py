"""Streams on the sky: against astropy's Galactocentric of the same Sun, and against gala's frames."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from astropy import coordinates as c
from astropy import units as u
from pydantic import TypeAdapter, ValidationError
from runfiles import BASE

import streamkit as sk
from streamkit.stream import Observer, seen_from, sky_matrix, to_galactocentric
from streamkit.testing.streams import example_stream

SUN = Observer(8.122, 0.0208, (12.9, 245.6, 7.78))
PM = u.mas / u.yr

# phi1, phi2 (deg), pm_phi1_cosphi2, pm_phi2 (mas/yr) by gala 1.11.0 for the star below.
GALA = {
    "GD1Koposov10": (-49.3491899923, 2.7663506989, -9.4323955390, -0.1729577827),
    "Pal5PriceWhelan18": (88.2325403119, -63.5043132229, 5.1365777934, 7.9130000346),
    "OrphanKoposov19": (101.5786112899, 11.1758725613, -5.3421945899, 7.7756644296),
    "OrphanNewberg10": (-16.8764295078, -7.9017801063, 4.6579894530, -8.2038487465),
    "SagittariusLaw10": (-148.8188900008, -0.5398931753, -3.8062673422, 8.6320524164),
    "SagittariusVasiliev21": (148.8188900008, -0.5398931753, 3.8062673422, 8.6320524164),
    "JhelumBonaca19": (-145.9286117160, 12.6955776212, 8.3753155196, 4.3421296559),
    "MagellanicStreamNidever08": (115.6069298706, 38.1242998864, -7.9761138851, 5.0380162060),
    "OphiuchusPriceWhelan16": (108.2182653756, -40.2300188772, 3.2210547427, 8.8670630055),
    "Pal13Shipp20": (130.1020511988, 0.6928723120, 3.6065194642, -8.7173974015),
}

STAR = c.SkyCoord(
    ra=140 * u.deg, dec=30 * u.deg, distance=9 * u.kpc, pm_ra_cosdec=-5 * PM, pm_dec=-8 * PM,
    radial_velocity=40 * u.km / u.s,
)  # fmt: skip


@pytest.fixture(scope="module")
def stream() -> sk.Stream:
    return replace(example_stream(), sun=SUN)


def astropy_sky(stream: sk.Stream) -> c.SkyCoord:
    sun = c.Galactocentric(
        galcen_coord=c.ICRS(266.4051 * u.deg, -28.936175 * u.deg), galcen_distance=SUN.r0 * u.kpc, z_sun=SUN.z * u.kpc,
        galcen_v_sun=c.CartesianDifferential(SUN.velocity * u.km / u.s), roll=0 * u.deg,
    )  # fmt: skip
    q = c.CartesianRepresentation(
        stream.q * u.kpc, differentials=c.CartesianDifferential(stream.v * u.km / u.s)
    )  # fmt: skip
    return c.SkyCoord(sun.realize_frame(q).transform_to(c.ICRS()))


def numbers(sky: c.SkyCoord) -> np.ndarray:
    """(6, n) whatever the names of the frame."""
    place = sky.sphericalcoslat
    motion = place.differentials["s"]
    return np.array([
        place.lon.wrap_at(180 * u.deg).deg, place.lat.deg, place.distance.to_value(u.kpc),
        motion.d_lon_coslat.to_value(PM), motion.d_lat.to_value(PM), motion.d_distance.to_value(u.km / u.s),
    ])  # fmt: skip


def test_the_sky_is_that_of_astropys_galactocentric(stream: sk.Stream) -> None:
    np.testing.assert_allclose(numbers(stream.sky()), numbers(astropy_sky(stream)), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("frame", ["GD1Koposov10", "SagittariusBelokurov14", {"pole": [34, 30], "origin": [124, 5]}])
def test_astropy_transforms_a_stream_frame_as_we_do(stream: sk.Stream, frame: object) -> None:
    ours = stream.sky(frame)
    np.testing.assert_allclose(numbers(ours.transform_to(c.ICRS())), numbers(stream.sky()), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(numbers(stream.sky().transform_to(ours.frame)), numbers(ours), rtol=1e-9, atol=1e-9)
    assert ours.phi1.max() <= 180 * u.deg
    again = pickle.loads(pickle.dumps(ours))
    assert (again.pm_phi1_cosphi2 == ours.pm_phi1_cosphi2).all()


def test_stream_frames_transform_into_each_other(stream: sk.Stream) -> None:
    gd1, orphan = stream.sky("GD1Koposov10"), stream.sky("OrphanKoposov19")
    np.testing.assert_allclose(numbers(gd1.transform_to(orphan.frame)), numbers(orphan), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("name", GALA)
def test_a_named_frame_is_galas(name: str) -> None:
    """Matrices of papers have 8 to 10 digits, and ours are made orthonormal."""
    q, v = to_galactocentric("icrs", 140, 30, 9, -5, -8, 40, SUN)
    found = seen_from(SUN, q[:, None], v[:, None], sky_matrix(name))
    assert [float(x[0]) for x in (*found[:2], *found[3:5])] == pytest.approx(GALA[name], abs=1e-6)
    assert found.distance[0] == pytest.approx(9, abs=1e-12)
    assert found.radial_velocity[0] == pytest.approx(40, abs=1e-9)


@pytest.mark.parametrize("name", GALA)
def test_a_named_frame_is_the_installed_galas(name: str) -> None:
    gala = pytest.importorskip("gala.coordinates")
    theirs = c.SkyCoord(ra=[140, 10] * u.deg, dec=[30, -50] * u.deg).transform_to(getattr(gala, name)()).spherical
    expected = [theirs.lon.wrap_at(180 * u.deg).deg, theirs.lat.deg]
    star = c.ICRS([140, 10] * u.deg, [30, -50] * u.deg).cartesian.xyz.value
    x, y, z = sky_matrix(name) @ star
    np.testing.assert_allclose([np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(z))], expected, atol=1e-6)


def test_known_places_of_the_frames() -> None:
    """The cluster Pal 5 and the Sagittarius dwarf are where their frames begin; the centre of M31 is not."""
    pal5 = c.ICRS(229.018 * u.deg, -0.124 * u.deg).cartesian.xyz.value
    assert sky_matrix("Pal5PriceWhelan18") @ pal5 == pytest.approx([1, 0, 0], abs=3e-3)
    centre = c.Galactic(0 * u.deg, 0 * u.deg).transform_to(c.ICRS()).cartesian.xyz.value
    assert sky_matrix("galactic") @ centre == pytest.approx([1, 0, 0], abs=1e-9)


def test_a_pole_and_an_origin_are_a_great_circle() -> None:
    matrix = sky_matrix({"pole": [34.5, 29.7], "origin": [124.5, 12.0]})
    pole, origin = (c.ICRS(a * u.deg, b * u.deg) for a, b in ((34.5, 29.7), (124.5, 12.0)))
    assert matrix @ pole.cartesian.xyz.value == pytest.approx([0, 0, 1], abs=1e-12)
    x, y, z = matrix @ origin.cartesian.xyz.value
    assert y == pytest.approx(0, abs=1e-12)
    assert x > 0
    assert np.degrees(np.arccos(z)) == pytest.approx(pole.separation(origin).deg)
    assert np.linalg.det(matrix) == pytest.approx(1)


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        ("GD1Koposov11", "no frame 'GD1Koposov11'. Did you mean 'GD1Koposov10'"),
        ({"pole": [1, 2]}, "takes pole and origin"),
        ({"pole": [34.5, 29.7], "origin": [200, 12]}, "off the great circle of its pole, expected at most 10"),
        ({"pole": [1, 2], "origin": [1, 2]}, "at its pole"),
        ({"pole": [1, 92], "origin": [1, 2]}, "dec must be within"),
        ({"pole": [1, 2], "origin": "here"}, r"expected \[ra, dec\]"),
        ({"pole": [1, 2, 3], "origin": [1, 2]}, r"found \[1, 2, 3\] for the pole of the frame"),
        ([[1, 0, 0], [0, 1, 0], [0, 0.1, 1]], "no rotation"),
        ([[1, 0, 0]], "expected the name of a frame"),
    ],
)
def test_what_is_no_frame_is_said(frame: object, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        sky_matrix(frame)
    with pytest.raises(ValidationError, match=text) as caught:  # and a field of a component says no more
        TypeAdapter(sk.Frame).validate_python(frame)
    assert caught.value.error_count() == 1


def test_gsr_velocities_are_galactocentric_velocities_along_the_line_of_sight(stream: sk.Stream) -> None:
    away = stream.q - SUN.q[:, None]
    expected = (stream.v * away).sum(axis=0) / np.sqrt((away**2).sum(axis=0))
    np.testing.assert_allclose(stream.seen("GD1Koposov10").radial_velocity_gsr, expected, atol=1e-9)


def test_the_way_to_the_sky_and_back() -> None:
    q, v = to_galactocentric("icrs", 140, 30, 9, -5, -8, 40, SUN)
    seen = seen_from(SUN, q[:, None], v[:, None], sky_matrix())
    assert [float(x[0]) for x in seen[:6]] == pytest.approx([140, 30, 9, -5, -8, 40], abs=1e-10)


def test_the_table_has_what_the_sun_sees(stream: sk.Stream) -> None:
    table, sky = stream.table("GD1Koposov10"), stream.sky()
    for name in ("ra", "dec", "distance", "pm_ra_cosdec", "pm_dec", "radial_velocity"):
        np.testing.assert_allclose(table[name].value, getattr(sky, name).value, atol=1e-9)
        assert table[name].unit == getattr(sky, name).unit
    gd1 = stream.sky("GD1Koposov10")
    for name in ("phi1", "phi2", "pm_phi1_cosphi2", "pm_phi2"):
        np.testing.assert_allclose(table[name].value, getattr(gd1, name).value, atol=1e-9)


def test_a_model_is_seen_from_the_sun_of_its_run_file() -> None:
    sun = {"r0": "8.122 kpc", "z": "20.8 pc", "v_circ": "233.4 km/s", "u": 12.9, "v": 12.2, "w": 7.78}
    stream = sk.Model(BASE | {"sun": sun}).stream({"potential.v0": 210})
    assert stream.sun.q == pytest.approx(SUN.q)
    assert stream.sun.v == pytest.approx(SUN.v)


def test_the_rotation_at_the_sun_may_be_the_hosts() -> None:
    """The closed form of the truncated flat curve; fixed run files keep their digests."""
    spec = sk.load(BASE | {"sun": {"v_circ": "host", "r0": {"normal": [8, 0.1]}}})
    assert sk.load(spec.document).document == spec.document
    assert "v_circ" not in "".join(spec.names)
    for v0, r0 in ((200.0, 8.0), (240.0, 8.2)):
        inputs = spec.bind({"potential.v0": v0, "sun.r0": r0})
        assert inputs.sun.v_circ == pytest.approx(v0 * 12.0**0.225 / (12.0**2 + r0**2) ** 0.1125, rel=1e-12)
        assert sk.Model(spec).stream({"potential.v0": v0, "sun.r0": r0}).sun.velocity[1] == inputs.sun.velocity[1]
    with pytest.raises(sk.SpecError, match='or "host"'):
        sk.load(BASE | {"sun": {"v_circ": "hast"}})


def test_the_sky_costs_little() -> None:
    """A fit calls it once per stream: arrays alone, about a millisecond for ten thousand particles."""
    import time

    stream = example_stream()
    stream.seen("GD1Koposov10")
    begin = time.process_time()
    for _ in range(20):
        stream.seen("GD1Koposov10")
    assert (time.process_time() - begin) / 20 < 5e-3


@pytest.mark.parametrize(
    ("former", "name"),
    [("phi1", "lon"), ("phi2", "lat"), ("pm_phi1_cosphi2", "pm_lon_coslat"), ("pm_phi2", "pm_lat")],
)
def test_a_former_name_warns_and_gives_the_same(stream, former, name):
    """CONTRIBUTING, versions: a renamed name works for one minor version, with a warning that has the new one."""
    seen = stream.seen("GD1Koposov10")
    with pytest.warns(DeprecationWarning, match=f"^Seen.{former} is now {name}:") as caught:
        value = getattr(seen, former)
    assert value is getattr(seen, name)
    assert caught[0].filename == __file__
