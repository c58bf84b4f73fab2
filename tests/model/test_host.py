"""Mass and circular velocity by Gauss's law, against closed forms and an integral over the density."""

import numpy as np
import pytest
from scipy.integrate import quad

from streamkit import G
from streamkit.builtin.potentials.closed_forms import NFW, Hernquist, Logarithmic, MiyamotoNagai, TruncatedFlat
from streamkit.model import Host

R = np.array([5.0, 20.0, 50.0, 100.0, 200.0])


def host(*potentials):
    return Host({potential.kind: potential for potential in potentials})


def test_truncated_flat_mass_is_that_of_its_circular_velocity():
    v2 = 210.0**2 * 12**0.45 * (12**2 + R**2) ** (-0.225)
    tf = TruncatedFlat(v0=210, rs=12, alpha=0.45)
    np.testing.assert_allclose(host(tf).circular_velocity(R), np.sqrt(v2), rtol=1e-12)
    np.testing.assert_allclose(host(tf).mass_inside(R), R * v2 / G, rtol=1e-12)


def test_nfw_and_hernquist_masses_add_up():
    nfw, hernquist = NFW(mass=3.6e11, rs=9.4), Hernquist(mass=3.4e10, a=0.7)
    expected = 3.6e11 * (np.log1p(R / 9.4) - R / (R + 9.4)) + 3.4e10 * R**2 / (R + 0.7) ** 2
    np.testing.assert_allclose(host(nfw, hernquist).mass_inside(R), expected, rtol=1e-12)


@pytest.mark.parametrize("r", [5.0, 20.0])
def test_a_thin_disc_agrees_with_the_integral_of_its_density(r):
    mass, a, b = 1e11, 6.5, 0.26

    def density(z, big_r):  # Miyamoto & Nagai 1975, eq. 5
        s = np.sqrt(z * z + b * b)
        top = a * big_r**2 + (a + 3 * s) * (a + s) ** 2
        return b * b * mass / (4 * np.pi) * top / ((big_r**2 + (a + s) ** 2) ** 2.5 * s**3)

    def ring(big_r):
        height = np.sqrt(r * r - big_r * big_r)
        return 4 * np.pi * big_r * quad(density, 0, height, args=(big_r,), points=[min(b, height / 2)], limit=200)[0]

    expected = quad(ring, 0, r, limit=200)[0]
    result = host(MiyamotoNagai(mass=mass, a=a, b=b)).mass_inside(np.array([r]))[0]
    assert result == pytest.approx(expected, rel=1e-6)


def test_circular_velocity_of_a_disc():
    mass, a, b = 1e11, 6.5, 0.26
    expected = np.sqrt(G * mass * R**2 / (R**2 + (a + b) ** 2) ** 1.5)
    np.testing.assert_allclose(host(MiyamotoNagai(mass=mass, a=a, b=b)).circular_velocity(R), expected, rtol=1e-12)


def test_a_triaxial_halo_is_averaged_over_azimuth():
    halo = Logarithmic(v_h=121.858, r_h=12, q1=1.38, q2=1.0, qz=1.36, phi=97)
    phi = np.linspace(0, 2 * np.pi, 2001)[:-1]
    p, q, turn = 1 / 1.38**2, 1.0, np.radians(97)
    c1 = np.cos(turn) ** 2 * p + np.sin(turn) ** 2 * q
    c2 = np.cos(turn) ** 2 * q + np.sin(turn) ** 2 * p
    c3 = 2 * np.sin(turn) * np.cos(turn) * (p - q)
    for r, result in zip(R, host(halo).circular_velocity(R), strict=True):
        shape = (c1 * np.cos(phi) ** 2 + c2 * np.sin(phi) ** 2 + c3 * np.sin(phi) * np.cos(phi)) * r * r
        expected = np.sqrt(np.mean(2 * 121.858**2 * shape / (shape + 144.0)))  # R dPhi/dR
        assert result == pytest.approx(expected, rel=1e-6)


def test_mass_goes_with_the_square_of_the_speed():
    mass = [host(TruncatedFlat(v0=v, rs=12, alpha=0.45)).mass_inside(R) for v in (200.0, 220.0)]
    np.testing.assert_allclose(mass[1] / mass[0], 1.21, rtol=1e-12)
