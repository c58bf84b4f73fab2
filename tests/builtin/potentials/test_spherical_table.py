"""The host from a table: power laws are exact, NFW comes back, energy is kept, and what has no sense is told."""

import numpy as np
import pytest

import streamkit as sk
from streamkit import testing
from streamkit.builtin.potentials.closed_forms import NFW, Hernquist
from streamkit.builtin.potentials.spherical_table import SphericalTable
from streamkit.builtin.potentials.spheroids import HernquistSpeed
from streamkit.components import Potential
from streamkit.engine import build_field
from streamkit.model import Host
from streamkit.runfile import Body

RADII = np.geomspace(1e-3, 1e4, 200)


def mass(potential: Potential, radii: np.ndarray = RADII) -> np.ndarray:
    return Host({"host": potential}).mass_inside(radii)


def nfw_mass(r: np.ndarray) -> np.ndarray:
    return 1e12 * (np.log1p(r / 20) - r / (r + 20))


@pytest.mark.parametrize("slope", [0.0, 0.5, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("count", [2, 5])
def test_a_power_law_is_exact_and_goes_on_beyond_the_table(slope: float, count: int) -> None:
    """M = 1e11 (r / 10)^slope, from a point mass to an even density, over seven decades from knots over one."""
    r = np.array([3.0, 5.0, 11.0, 17.0, 30.0])[[0, 4] if count == 2 else slice(None)]
    table = SphericalTable(r=r, mass=1e11 * (r / 10) ** slope)
    np.testing.assert_allclose(mass(table), 1e11 * (RADII / 10) ** slope, rtol=1e-9)
    q = np.array([[1e-2, 4.0, 1e3], [0.0] * 3, [0.0] * 3])
    depth = Host({"host": table}).potential(q)
    assert depth is not None
    n = slope - 1  # of v_c^2
    v2 = sk.G * 1e10 * (q[0] / 10) ** n
    wanted = v2 / n if n < 0 else sk.G * 1e10 * ((q[0] / 10) ** n - 3.0**n) / n if n else v2 * np.log(q[0] / 30)
    np.testing.assert_allclose(depth, wanted, rtol=1e-9)


def test_the_speeds_and_the_masses_of_nfw_give_nfw() -> None:
    """To 1e-4 from eight knots a decade, 16 times better from twice as many: the order of the spline."""
    inside, worst = np.geomspace(0.1, 900, 300), []
    for count in (33, 65):
        r = np.geomspace(0.01, 1e4, 6 * (count - 1) // 4 + 1)
        by_mass = SphericalTable(r=r, mass=nfw_mass(r))
        by_speed = SphericalTable(r=r, v_c=np.sqrt(sk.G * nfw_mass(r) / r))
        np.testing.assert_allclose(mass(by_speed, inside), mass(by_mass, inside), rtol=1e-10)
        worst.append(np.abs(mass(by_mass, inside) / nfw_mass(inside) - 1).max())
    assert worst[0] < 1e-4
    assert worst[1] < worst[0] / 12


def test_uneven_knots_are_resampled_without_loss() -> None:
    """The cells of the even grid do not meet the knots: the circular speed is still that of SciPy's spline."""
    from scipy.interpolate import CubicSpline

    r = np.array([1.0, 1.4, 4.0, 9.0, 40.0, 55.0, 200.0])
    v = np.array([150.0, 180.0, 230.0, 240.0, 200.0, 190.0, 140.0])
    radii = np.geomspace(1, 200, 500)
    wanted = np.exp(CubicSpline(np.log(r), np.log(v), bc_type="natural")(np.log(radii)))
    speed = Host({"host": SphericalTable(r=r, v_c=v)}).circular_velocity(radii)
    np.testing.assert_allclose(speed, wanted, rtol=1e-7)


def test_energy_is_kept_along_an_orbit_through_all_of_it() -> None:
    """From beyond the last knot to inside the first, in the compiled loop."""
    table = SphericalTable(r=[5.0, 10.0, 30.0, 60.0], v_c=[200.0, 230.0, 210.0, 180.0])
    orbit = build_field([table]).orbit(np.array([90.0, 0.0, 0.0]), np.array([0.0, 4.0, 1.0]), 0.0, -3 * sk.GYR, 1e-4)
    assert orbit.r.min() < 3
    energy = Host({"host": table}).energy(orbit.q, orbit.v)
    assert energy is not None
    assert np.ptp(energy) < 1e-6 * (orbit.v**2).sum(axis=0).max()


def test_its_orbits_are_those_of_the_closed_form() -> None:
    r = np.geomspace(0.1, 1000, 33)
    start = np.array([20.0, 0.0, 5.0]), np.array([50.0, 150.0, 80.0]), 0.0, -2 * sk.GYR, 1e-3
    table = build_field([SphericalTable(r=r, mass=nfw_mass(r))]).orbit(*start)
    exact = build_field([NFW(mass=1e12, rs=20)]).orbit(*start)
    np.testing.assert_allclose(table.q, exact.q, atol=0.02)


def test_a_mass_that_falls_is_no_host() -> None:
    table = SphericalTable(r=[5.0, 10.0, 30.0], v_c=[300.0, 200.0, 200.0])
    with pytest.raises(sk.OutOfDomain, match="falls with radius"):
        build_field([table])


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"r": [8.0, 20.0]}, "one of v_c and mass, found neither"),
        ({"r": [8.0, 20.0], "v_c": [1, 2], "mass": [1, 2]}, "found v_c and mass"),
        ({"r": [8.0, 20.0], "v_c": [1, 2, 3]}, "r has 2 knots and v_c 3"),
        ({"r": [8.0], "v_c": [1]}, "at least 2"),
        ({"r": [20.0, 8.0], "v_c": [1, 2]}, "larger than the one before"),
        ({"r": [8.0, 20.0], "v_c": [0, 2]}, "v_c must be positive, found 0"),
        ({"r": [8.0, 20.0], "mass": [1, float("nan")]}, "finite"),
    ],
)
def test_a_table_without_sense_is_told(values: dict[str, list[float]], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        SphericalTable(**values)


def test_the_sphere_of_a_circular_speed_is_hernquists() -> None:
    """Erkal+ 2019: a = sqrt(G M 8.7 / 91.7^2) - 8.7 kpc, so that every mass has 91.7 km/s at 8.7 kpc."""
    testing.check(HernquistSpeed)
    for m, a in ((5e10, 6.22), (1.38e11, 16.08), (2.5e11, 24.65)):  # kpc, of an independent code
        sphere = HernquistSpeed(mass=m)
        assert sphere.scale_radius == pytest.approx(a, abs=0.01)
        assert Host({"lmc": sphere}).circular_velocity(np.array([8.7])) == pytest.approx(91.7, rel=1e-9)
        np.testing.assert_allclose(mass(sphere), mass(Hernquist(mass=m, a=sphere.scale_radius)), rtol=1e-12)
    assert Body(HernquistSpeed(mass=1.38e11), np.zeros(3), np.zeros(3)).extent == pytest.approx(16.08, abs=0.01)
    with pytest.raises(sk.OutOfDomain, match="too small"):
        build_field([HernquistSpeed(mass=1e10)])
