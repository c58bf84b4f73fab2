"""The progenitor's place and the Sun, against astropy and the numbers of the literature."""

from typing import Any

import numpy as np
import pytest
from astropy import coordinates as c
from astropy import units as u
from pydantic import ValidationError
from runfiles import accepts, changed

import streamkit as sk
from streamkit.runfile import Sun
from streamkit.runfile.progenitor import WAYS, choose_coordinates
from streamkit.stream import seen_from, sky_matrix
from streamkit.stream.frames import CENTRE_ICRS

GalacticSky, EquatorialSky, StreamSky, Galactocentric = WAYS
SGR = {"l": 5.5689, "b": -14.1669, "distance": 25.2, "pm_l_cosb": -2.44, "pm_b": 1.97, "v_los": 153.0}


def astropy_frame(sun: Sun) -> c.Galactocentric:
    ra, dec = CENTRE_ICRS
    return c.Galactocentric(
        galcen_coord=c.ICRS(ra * u.deg, dec * u.deg),
        galcen_distance=sun.r0 * u.kpc,
        galcen_v_sun=c.CartesianDifferential(sun.velocity * u.km / u.s),
        z_sun=sun.z * u.kpc,
    )


def test_sagittarius_has_the_phase_space_position_of_gibbons_2014() -> None:
    q, v = GalacticSky(**SGR, lookback=3.0).today(Sun())
    np.testing.assert_allclose(q, [16.3, 2.4, -6.2], atol=0.05)
    np.testing.assert_allclose(v, [244.0, -21.0, 198.0], atol=0.5)


SUNS = [Sun(), Sun(r0=8.2, v_circ=229.0, u=10.0, v=5.0, w=7.0, z=0.0208), Sun(z=-1.0)]


@pytest.mark.parametrize("sun", SUNS, ids=["paper", "above the plane", "far below"])
@pytest.mark.parametrize(
    ("way", "place", "sky"),
    [
        (GalacticSky, SGR, c.Galactic),
        (EquatorialSky, {"ra": 283.831, "dec": -30.545, "distance": 26.5, "pm_ra_cosdec": -2.692, "pm_dec": -1.359,
                         "v_los": 142.0}, c.ICRS),
    ],
    ids=["galactic", "equatorial"],
)  # fmt: skip
def test_a_place_on_the_sky_agrees_with_astropy(way: Any, place: dict[str, float], sky: Any, sun: Sun) -> None:
    units = [u.deg, u.deg, u.kpc, u.mas / u.yr, u.mas / u.yr, u.km / u.s]
    values = {name.replace("v_los", "radial_velocity"): value for name, value in place.items()}
    seen = sky(**{name: values[name] * unit for name, unit in zip(values, units, strict=True)})
    seen = seen.transform_to(astropy_frame(sun))
    q, v = way(**place, lookback=3.0).today(sun)
    np.testing.assert_allclose(q, seen.cartesian.xyz.to_value(u.kpc), rtol=1e-10)
    np.testing.assert_allclose(v, seen.velocity.d_xyz.to_value(u.km / u.s), rtol=1e-10)


def test_galactocentric_coordinates_are_taken_as_they_are() -> None:
    q, v = Galactocentric(x=1, y=2, z="3000 pc", vx=4, vy=5, vz=6, lookback=3).today(Sun(r0=1, v_circ=0))
    np.testing.assert_array_equal(q, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(v, [4.0, 5.0, 6.0])


def test_the_sun_itself() -> None:
    """At zero distance: the Sun's place, its velocity (u, v_circ + v, w) and right-handed axes."""
    sun = Sun()
    place = np.array([-8.0, 0.0, 0.0])
    q, v = GalacticSky(l=90, b=0, distance=1e-9, pm_l_cosb=0, pm_b=0, v_los=0, lookback=1).today(sun)
    np.testing.assert_allclose(q, place, atol=1e-8)
    np.testing.assert_allclose(v, [11.1, 237.0 + 12.24, 7.25])
    axes = [{"l": 0, "b": 0}, {"l": 90, "b": 0}, {"l": 0, "b": 90}]
    rest = {"distance": 1, "pm_l_cosb": 0, "pm_b": 0, "v_los": 0, "lookback": 1}
    steps = [GalacticSky(**axis, **rest).today(sun)[0] - place for axis in axes]
    np.testing.assert_allclose(np.array(steps), np.eye(3), atol=2e-4)  # l = b = 0 lies 0.2 arcmin off the centre


def test_the_sun_must_be_near_the_plane() -> None:
    with pytest.raises(ValidationError, match="less than r0"):
        Sun(r0=8, z=9)


@pytest.mark.parametrize("frame", ["GD1Koposov10", "SagittariusLaw10", {"pole": (30.0, 40.0), "origin": (120.0, 0.0)}])
def test_a_place_in_a_frame_of_a_stream_is_the_same_place_in_icrs(frame: Any) -> None:
    """Left-handed frames too; the way there is the one that streams are seen by."""
    star = {"ra": 140.0, "dec": 30.0, "distance": 9.0, "pm_ra_cosdec": -5.0, "pm_dec": -8.0, "v_los": 40.0}
    q, v = EquatorialSky(**star, lookback=1).today(Sun())
    seen = seen_from(Sun().observer, q[:, None], v[:, None], sky_matrix(frame))
    names = ("phi1", "phi2", "distance", "pm_phi1_cosphi2", "pm_phi2", "v_los")
    there = {name: float(value[0]) for name, value in zip(names, seen[:6], strict=True)}
    found = StreamSky(frame=frame, **there, lookback=1).today(Sun())
    np.testing.assert_allclose(found, (q, v), rtol=1e-11, atol=1e-9)


def test_a_progenitor_in_a_frame_that_does_not_exist_is_said() -> None:
    with pytest.raises(ValidationError, match="Did you mean 'GD1Koposov10'"):
        StreamSky(frame="GD1Koposov", phi1=0, phi2=0, distance=1, pm_phi1_cosphi2=0, pm_phi2=0, v_los=0, lookback=1)


def sagittarius(ra: np.ndarray, dec: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y, z = sky_matrix("SagittariusBelokurov14") @ c.ICRS(ra * u.deg, dec * u.deg).cartesian.xyz.value
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(z))


def test_sagittarius_frame_at_the_core() -> None:
    core = c.Galactic(SGR["l"] * u.deg, SGR["b"] * u.deg).transform_to(c.ICRS())
    lam, beta = sagittarius(core.ra.deg, core.dec.deg)
    assert lam == pytest.approx(-0.087, abs=5e-4)
    assert beta == pytest.approx(-1.549, abs=5e-4)


def test_sagittarius_frame_is_that_of_law_and_majewski_with_both_signs_changed() -> None:
    phi, theta, psi = np.radians([183.8 - 0.05, 76.5 + 0.04, 194.1 + 0.011534])

    def turn(angle: float, axis: str) -> np.ndarray:
        return c.matrix_utilities.rotation_matrix(angle * u.rad, axis)

    matrix = np.diag([1.0, 1.0, -1.0]) @ turn(psi, "z") @ turn(theta, "x") @ turn(phi, "z")
    rng = np.random.default_rng(1)
    lon, lat = rng.uniform(0, 360, 50), np.degrees(np.arcsin(rng.uniform(-1, 1, 50)))
    sky = c.Galactic(lon * u.deg, lat * u.deg)
    x, y, z = matrix @ sky.cartesian.xyz.value
    icrs = sky.transform_to(c.ICRS())
    lam, beta = sagittarius(icrs.ra.deg, icrs.dec.deg)
    np.testing.assert_allclose((lam + np.degrees(np.arctan2(y, x)) + 180) % 360 - 180, 0.0, atol=1e-4)
    np.testing.assert_allclose(beta, -np.degrees(np.arcsin(z)), atol=1e-4)


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.title)
def test_the_coordinates_choose_the_way(way: type) -> None:
    assert choose_coordinates(way.coordinates()) is way
    assert choose_coordinates([*way.coordinates()[:2], "lookback"]) is way  # the rest is then reported as missing


@pytest.mark.parametrize("given", [(), ("distance", "v_los"), ("l", "dec"), ("l", "b", "x")])
def test_none_or_mixed_sets_name_the_sets(given: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="exactly one of the sets") as caught:
        choose_coordinates(given)
    for name in ("l, b, distance, pm_l_cosb", "ra, dec, distance", "x, y, z, vx, vy, vz", *given):
        assert name in str(caught.value)


def test_a_potential_with_a_field_of_the_same_name_takes_it() -> None:
    assert choose_coordinates(("x", "y"), taken=("mass", "b")) is Galactocentric
    with pytest.raises(ValueError, match=r"Galactic sky is not available here.* a field b of its own"):
        choose_coordinates(("l", "distance"), taken=("mass", "b"))


@pytest.mark.parametrize("path", ["progenitor", "body.lmc"])
def test_the_line_of_sight_velocity_may_be_called_radial_velocity(path):
    """That is its name in the tables of a track."""
    place = {"ra": 80.0, "dec": -69.0, "distance": 50.0, "pm_ra_cosdec": 1.9, "pm_dec": 0.4, "v_los": 262.0}
    other = {"radial_velocity" if name == "v_los" else name: value for name, value in place.items()}
    specs = []
    for each in (place, other):
        document = changed("seed", 1)
        if path == "progenitor":
            own = {"kind": "plummer", "mass": 1e8, "radius": 1.0, "lookback": 2.0}
            document["progenitor"] = own | each
        else:
            document["body"] = {"lmc": {"kind": "hernquist", "mass": 1e11, "a": 10.0} | each}
        specs.append(sk.load(document))
    assert specs[0].document == specs[1].document
    assert specs[0].digest() == specs[1].digest()
    if path == "progenitor":
        document["progenitor"]["v_los"] = 262.0
        with pytest.raises(sk.SpecError, match="progenitor: found v_los and radial_velocity, two names of one number"):
            sk.load(document)


@pytest.fixture
def on_sky() -> dict[str, Any]:
    """A run file whose progenitor has Galactic coordinates, and no free parameter."""
    document = changed("stripping", "sigma", 10.0)
    document["potential"]["v0"] = 220.0
    document["progenitor"] = {"kind": "plummer", "mass": 1e8, "radius": 1.0, "lookback": 2.0} | SGR
    return document


def test_radial_velocity_is_a_name_in_settings_and_at_parameters(on_sky):
    """`with_values` is what --set and --vary call."""
    spec, name, other = sk.load(on_sky), "progenitor.v_los", "progenitor.radial_velocity"
    free, same = (spec.with_values({each: {"normal": [142.0, 5.0]}}) for each in (name, other))
    assert free.document == same.document
    assert same.names == (name,)
    assert same.bind({other: 150.0}).values == {name: 150.0}
    for call in (same.bind, same.with_values):
        with pytest.raises(sk.SpecError, match=rf"found {name} and {other}, two names of one number"):
            call({name: 150.0, other: 150.0})
    with pytest.raises(sk.SpecError, match=r"there is no field 'stripping\.radial_velocity'"):
        spec.with_values({"stripping.radial_velocity": 1.0})


def test_the_schema_has_both_names_of_the_line_of_sight_velocity(on_sky, schema):
    place = on_sky["progenitor"]
    other = {"radial_velocity" if name == "v_los" else name: value for name, value in place.items()}
    for progenitor, good in ((place, True), (other, True), (place | other, False), (place | {"vlos": 1.0}, False)):
        assert accepts(schema, on_sky | {"progenitor": progenitor}, schema) is good
    del other["radial_velocity"]
    assert not accepts(schema, on_sky | {"progenitor": other}, schema)
