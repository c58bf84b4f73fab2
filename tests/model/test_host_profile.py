"""Density, escape speed, tidal radii and orbits of a host, against closed forms and a two-body problem."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import streamkit as sk
from streamkit import G
from streamkit.builtin.potentials.closed_forms import NFW, Logarithmic, MiyamotoNagai, Plummer
from streamkit.model import moving_objects, profile_values

R = np.array([2.0, 8.0, 30.0, 100.0])
PLACES = np.array([[8.0, 3.0, -20.0], [0.0, 5.0, 10.0], [0.0, 1.0, 15.0]])


def host(*potentials: Any) -> sk.Host:
    return sk.Host({potential.kind: potential for potential in potentials})


def test_the_density_of_spheres_and_of_a_disc() -> None:
    """Navarro, Frenk & White's, Plummer's, and Miyamoto & Nagai 1975, eq. 5."""
    r = np.sqrt((PLACES**2).sum(axis=0))
    nfw = 1e12 / (4 * np.pi * r * (r + 15) ** 2)
    plummer = 3e10 / (4 * np.pi / 3 * 4.0**3) * (1 + r**2 / 16) ** -2.5
    result = host(NFW(mass=1e12, rs=15), Plummer(mass=3e10, radius=4)).density(PLACES)
    np.testing.assert_allclose(result, nfw + plummer, rtol=1e-6)
    mass, a, b = 7e10, 3.0, 0.28
    big_r, s = np.hypot(PLACES[0], PLACES[1]), np.sqrt(PLACES[2] ** 2 + b**2)
    top = a * big_r**2 + (a + 3 * s) * (a + s) ** 2
    expected = b * b * mass / (4 * np.pi) * top / ((big_r**2 + (a + s) ** 2) ** 2.5 * s**3)
    np.testing.assert_allclose(host(MiyamotoNagai(mass=mass, a=a, b=b)).density(PLACES), expected, rtol=1e-3)


def test_the_mean_density_of_a_shell_is_the_density_of_a_sphere() -> None:
    values = profile_values(host(NFW(mass=1e12, rs=15)), R)
    np.testing.assert_allclose(values["rho"], 1e12 / (4 * np.pi * R * (R + 15) ** 2), rtol=1e-3)
    np.testing.assert_allclose(values["q"], 1, rtol=1e-9)


def test_the_escape_speed_is_that_of_the_closed_form() -> None:
    """Plummer's and Navarro, Frenk & White's; a logarithmic halo lets nothing escape."""
    depth = G * 3e10 / np.hypot(R, 4) + G * 1e12 * np.log1p(R / 15) / R
    result = host(NFW(mass=1e12, rs=15), Plummer(mass=3e10, radius=4)).escape_speed(R)
    np.testing.assert_allclose(result, np.sqrt(2 * depth), rtol=1e-9)
    result = host(Logarithmic(v_h=120, r_h=12, q1=1, q2=1, qz=1, phi=0)).escape_speed(R)
    assert result is not None
    assert np.isinf(result).all()


def test_the_tidal_radius_about_a_point_mass() -> None:
    """On a circular orbit Omega^2 - d2Phi/dr2 = 3 G M / r^3: Jacobi's radius (King 1962)."""
    mass, small = 1e12, 1e8
    q = np.array([[50.0], [0.0], [0.0]])
    v = np.array([[0.0], [np.sqrt(G * mass / 50.0)], [0.0]])
    result = host(Plummer(mass=mass, radius=1e-3)).tidal_radius(small, q, v)
    assert result == pytest.approx(50 * (small / (3 * mass)) ** (1 / 3), rel=1e-5)


def test_a_body_and_a_progenitor_on_ellipses() -> None:
    """About a point mass the turning radii follow from energy and angular momentum."""
    run = {
        "potential": {"kind": "plummer", "mass": 1e12, "radius": 0.01},
        "progenitor": {"kind": "plummer", "mass": 1e6, "radius": 0.01, "x": 40, "y": 0, "z": 0, "vx": 30, "vy": 0,
                       "vz": 250, "lookback": 4},
        "body": {"lmc": {"kind": "plummer", "mass": 1.0, "radius": 1, "x": 0, "y": 60, "z": 0, "vx": 150, "vy": 20,
                         "vz": 0, "friction": "none", "reflex": False}},
        "stripping": {"kind": "mlcs", "particles": 10},
    }  # fmt: skip
    objects = moving_objects({"version": 1} | run)
    assert list(objects) == ["stream", "body lmc"]
    for moving, r, v, momentum in (
        (objects["stream"], 40, np.hypot(30, 250), 40 * 250), (objects["body lmc"], 60, np.hypot(150, 20), 60 * 150)
    ):  # fmt: skip
        energy = 0.5 * v**2 - G * 1e12 / r
        roots = np.sort(np.roots([2 * energy, 2 * G * 1e12, -(momentum**2)]))
        turning = moving.turning()
        assert [turning["r_peri"], turning["r_apo"]] == pytest.approx(roots, rel=1e-4)
        # at a turning point the bracket is (v / r)^2 + 2 G M / r^3
        bracket = (momentum / roots[0] ** 2) ** 2 + 2 * G * 1e12 / roots[0] ** 3
        assert turning["r_tidal_peri"] == pytest.approx(np.cbrt(G * moving.mass / bracket), rel=1e-3)


def test_the_host_of_a_run_file_at_parameters() -> None:
    run = {
        "version": 1, "potential": {"kind": "tf", "v0": {"uniform": [100, 300]}, "rs": 12, "alpha": 0.45},
        "progenitor": {"kind": "plummer", "mass": 1e8, "radius": 1, "x": 40, "y": 0, "z": 0, "vx": 0, "vy": 0,
                       "vz": 150, "lookback": 1},
        "stripping": {"kind": "mlcs", "particles": 10},
    }  # fmt: skip
    for v0, given in ((200.0, None), (240.0, {"potential.v0": 240})):
        expected = v0 * 12**0.225 / (12**2 + R**2) ** 0.1125
        np.testing.assert_allclose(sk.Host.at(run, given).circular_velocity(R), expected, rtol=1e-12)
    table = sk.host_table(sk.load(run), R)
    np.testing.assert_allclose(table["M"].to_value("Msun"), R * table["v_c"].value ** 2 / G, rtol=1e-9)
    with pytest.raises(ValueError, match="positive numbers"):
        sk.host_table(sk.load(run), [0, 10])
