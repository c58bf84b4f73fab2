"""The schemes as streamkit's components, and their formulas by hand."""

from importlib.metadata import entry_points

import numpy as np
import pytest
from streamkit_spray import Chen25, Fardal15, Fardal15Gala

from streamkit import LEADING, TRAILING, G, Orbit
from streamkit.testing import check

R_TIDAL, OMEGA, MASS = 1.5, 10.0, 5.0e8


@pytest.fixture
def orbit():
    """One leading and one trailing release at 20 kpc on the x axis, moving in y and outwards."""
    two = np.ones(2)
    q = np.outer([20.0, 0.0, 0.0], two)
    v = np.outer([30.0, 20.0 * OMEGA, 0.0], two)
    return Orbit(-two, q, v, np.zeros((3, 2)), R_TIDAL * two)


TAIL = np.array([LEADING, TRAILING])


@pytest.mark.parametrize("cls", [Fardal15, Fardal15Gala, Chen25])
def test_conforms(cls):
    check(cls)


def test_is_found_by_its_entry_point():
    points = [p for p in entry_points(group="streamkit") if p.value == "streamkit_spray"]
    assert points
    for point in points:
        assert point.load().streamkit_components() == [Fardal15, Fardal15Gala, Chen25]


def test_fardal15_mean_is_two_tidal_radii_and_three_tenths_of_v(orbit):
    release = Fardal15().release(orbit, TAIL, MASS, np.zeros((4, 2)))
    assert np.allclose(release.q - orbit.q, [[-3.0, 3.0], [0, 0], [0, 0]])
    assert np.allclose(release.v - orbit.v, [[0, 0], [-4.5, 4.5], [0, 0]])


def test_gala_variant_multiplies_the_tangential_kick_by_the_radial_draw(orbit):
    normals = np.zeros((4, 2))
    normals[0], normals[1] = 1.0, 1.0
    release = Fardal15Gala().release(orbit, TAIL, MASS, normals)
    assert np.allclose((release.q - orbit.q)[0], [-2.5 * R_TIDAL, 2.5 * R_TIDAL])
    assert np.allclose((release.v - orbit.v)[1], np.array([-1, 1]) * 2.5 * 0.8 * OMEGA * R_TIDAL)


def test_chen25_mean_direction_and_escape_speed(orbit):
    release = Chen25().release(orbit, TAIL, MASS, np.zeros((5, 2)))
    offset, kick = (release.q - orbit.q)[:, 1], (release.v - orbit.v)[:, 1]
    assert np.linalg.norm(offset) == pytest.approx(1.6 * R_TIDAL)
    assert np.degrees(np.arctan2(offset[1], offset[0])) == pytest.approx(-30.0)
    assert np.linalg.norm(kick) == pytest.approx(np.sqrt(2 * G * MASS / (1.6 * R_TIDAL)))
    assert np.degrees(np.arctan2(kick[1], kick[0])) == pytest.approx(20.0)


def test_chen25_has_the_covariance_of_the_paper(orbit):
    """Variances 0.1225, 529, 144, 400, 484 and cov(D, alpha) = -4.9, read back from the particles."""
    n = 40000
    state = Orbit(*(np.repeat(a[..., :1], n, axis=-1) for a in (orbit.t, orbit.q, orbit.v, orbit.a, orbit.r_tidal)))
    normals = np.random.default_rng(5).standard_normal((5, n))
    release = Chen25().release(state, np.full(n, TRAILING), MASS, normals)
    dq, dv = release.q - state.q, release.v - state.v
    d = np.linalg.norm(dq, axis=0) / R_TIDAL
    phi, alpha = (np.degrees(np.arctan2(a[1], a[0])) for a in (dq, dv))
    theta, beta = (np.degrees(np.arcsin(a[2] / np.linalg.norm(a, axis=0))) for a in (dq, dv))
    wanted = np.diag([0.1225, 529.0, 144.0, 400.0, 484.0])
    wanted[0, 3] = wanted[3, 0] = -4.9
    sigma = np.sqrt(np.diag(wanted))
    assert np.allclose(
        np.cov([d, phi, theta, alpha, beta]) / np.outer(sigma, sigma),
        wanted / np.outer(sigma, sigma),
        atol=0.03,
    )


def test_chen25_survives_the_rarest_draws(orbit):
    normals = np.zeros((5, 2))
    normals[0] = -6.0
    release = Chen25().release(orbit, TAIL, MASS, normals)
    assert np.isfinite(release.v).all()
