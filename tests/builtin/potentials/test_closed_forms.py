"""Built-in potentials against closed forms and against galpy."""

import numpy as np
import pytest
from galpy import potential as gp
from of_galpy import galpy_acceleration
from scipy.integrate import quad
from scipy.special import hyp2f1

from streamkit import G
from streamkit.builtin.potentials.closed_forms import (
    NFW,
    Hernquist,
    Isochrone,
    Kepler,
    Logarithmic,
    MiyamotoNagai,
    NFWVirial,
    Plummer,
    TruncatedFlat,
)
from streamkit.engine import build_field
from streamkit.testing import reference

R = np.geomspace(0.05, 300.0, 40)
LM10 = [
    Logarithmic(v_h=121.858, r_h=12.0, q1=1.38, q2=1.0, qz=1.36, phi=97.0),
    MiyamotoNagai(mass=1.0e11, a=6.5, b=0.26),
    Hernquist(mass=3.4e10, a=0.7),
]


def along_x(r):
    return np.stack([r, np.zeros_like(r), np.zeros_like(r)])


def acceleration(potentials, q):
    return reference.acceleration(potentials, 0.0, np.asarray(q, dtype=float))


def mass_profile(potential, r=R):
    """M(r) = -r^2 a_r / G of a spherical potential, in a direction off the axes."""
    direction = np.array([2.0, -1.0, 2.0])[:, None] / 3.0
    a = acceleration([potential], direction * r)
    assert np.allclose(np.cross(a.T, direction.T), 0.0, atol=1e-12 * np.abs(a).max())
    return -(r**2) * (a * direction).sum(axis=0) / G


M, B = 3.0e10, 2.5
MASSES = {
    "tf": (
        TruncatedFlat(v0=210.0, rs=12.0, alpha=0.45),
        lambda r: r * 210.0**2 * 12.0**0.45 / (G * (12.0**2 + r**2) ** 0.225),
    ),
    "tf, flat": (TruncatedFlat(v0=210.0, rs=12.0, alpha=0.0), lambda r: r * 210.0**2 / G),
    "tf, keplerian": (
        TruncatedFlat(v0=210.0, rs=12.0, alpha=1.0),
        lambda r: r * 210.0**2 * 12.0 / (G * np.sqrt(12.0**2 + r**2)),
    ),
    "nfw": (NFW(mass=M, rs=B), lambda r: M * (np.log1p(r / B) - r / (r + B))),
    "hernquist": (Hernquist(mass=M, a=B), lambda r: M * r**2 / (r + B) ** 2),
    "plummer": (Plummer(mass=M, radius=B), lambda r: M * r**3 / (r**2 + B**2) ** 1.5),
    "kepler": (Kepler(mass=M), lambda r: M + 0 * r),
    "isochrone": (
        Isochrone(mass=M, b=B),
        lambda r: M * r**3 / (np.sqrt(B**2 + r**2) * (B + np.sqrt(B**2 + r**2)) ** 2),
    ),
    "logarithmic, round": (
        Logarithmic(v_h=100.0, r_h=B),
        lambda r: 2 * 100.0**2 * r**3 / (G * (r**2 + B**2)),
    ),
}


@pytest.mark.parametrize("name", MASSES)
def test_enclosed_mass(name):
    potential, closed = MASSES[name]
    # the NFW force is a difference of nearly equal terms for r << rs
    assert np.allclose(mass_profile(potential), closed(R), rtol=1e-10)


def test_miyamoto_nagai_rotation_curve():
    """v_c^2 = G M R^2 / (R^2 + (a + b)^2)^(3/2) in the plane (Binney & Tremaine 2008, eq. 2.69a)."""
    a = acceleration([MiyamotoNagai(mass=M, a=6.5, b=0.26)], along_x(R))
    assert np.allclose(-R * a[0], G * M * R**2 / (R**2 + 6.76**2) ** 1.5, rtol=1e-12)


def tf_density(r, v0, rs, alpha):
    """Gibbons+ 2014, the equation after that of the rotation curve."""
    top = rs**2 + (1 - alpha) * r**2
    return v0**2 * rs**alpha / (4 * np.pi * G * r**2) * top / (rs**2 + r**2) ** (1 + alpha / 2)


def isochrone_density(r):
    """Binney & Tremaine 2008, eq. 2.49."""
    a = np.sqrt(B**2 + r**2)
    return M * (3 * (B + a) * a**2 - r**2 * (B + 3 * a)) / (4 * np.pi * (B + a) ** 3 * a**3)


DENSITIES = {
    "tf": (TruncatedFlat(v0=210.0, rs=12.0, alpha=0.45), lambda r: tf_density(r, 210.0, 12.0, 0.45)),
    "nfw": (NFW(mass=M, rs=B), lambda r: M / (4 * np.pi * r * (r + B) ** 2)),
    "hernquist": (Hernquist(mass=M, a=B), lambda r: M * B / (2 * np.pi * r * (r + B) ** 3)),
    "plummer": (
        Plummer(mass=M, radius=B),
        lambda r: 3 * M / (4 * np.pi * B**3) * (1 + r**2 / B**2) ** -2.5,
    ),
    "isochrone": (Isochrone(mass=M, b=B), isochrone_density),
    "kepler": (Kepler(mass=M), lambda r: 0 * r),
}


@pytest.mark.parametrize("name", DENSITIES)
def test_poisson_gives_the_density(name):
    potential, closed = DENSITIES[name]
    q = np.array([[2.0], [-1.0], [2.0]]) / 3.0 * R
    divergence, _ = reference.divergence_and_curl(potential, np.zeros(len(R)), q)
    mean = mass_profile(potential) / (4 / 3 * np.pi * R**3)
    assert np.allclose(-divergence / (4 * np.pi * G) / mean, closed(R) / mean, atol=1e-7)


def test_miyamoto_nagai_density():
    """Binney & Tremaine 2008, eq. 2.69b."""
    a, b = 6.5, 0.8
    x, z = np.array([4.0, 8.0, 20.0]), np.array([0.3, -1.0, 5.0])
    s = np.sqrt(z**2 + b**2)
    top = a * x**2 + (a + 3 * s) * (a + s) ** 2
    wanted = b**2 * M / (4 * np.pi) * top / ((x**2 + (a + s) ** 2) ** 2.5 * s**3)
    q = np.stack([x, np.zeros(3), z])
    divergence, _ = reference.divergence_and_curl(MiyamotoNagai(mass=M, a=a, b=b), np.zeros(3), q)
    assert np.allclose(-divergence / (4 * np.pi * G), wanted, rtol=1e-6)


def test_tf_masses_of_mock_1():
    """M(50, 100, 200 kpc) = 2.66, 3.94, 5.78 x 10^11 Msun for (210 km/s, 12 kpc, 0.45)."""
    result = mass_profile(TruncatedFlat(v0=210.0, rs=12.0, alpha=0.45), np.array([50.0, 100.0, 200.0]))
    assert np.round(result / 1e11, 2).tolist() == [2.66, 3.94, 5.78]


@pytest.mark.parametrize("alpha", [0.0, 0.2, 0.45, 1.0])
def test_tf_potential_difference_is_the_integral_of_the_force(alpha):
    tf = TruncatedFlat(v0=210.0, rs=12.0, alpha=alpha)
    phi = type(tf).potential(np.array([3.0, 90.0]), 0.0, 0.0, 0.0, *tf.in_engine_units())
    wanted, _ = quad(lambda r: 210.0**2 * (1 + (r / 12.0) ** 2) ** (-alpha / 2) / r, 3.0, 90.0, epsabs=1e-9)
    assert phi[1] - phi[0] == pytest.approx(wanted, rel=1e-10)


def test_tf_potential_in_its_special_cases():
    """alpha = 1 gives -v0^2 artanh(rs / sqrt(rs^2 + r^2)); any other its hypergeometric form."""
    tf = TruncatedFlat(v0=210.0, rs=12.0, alpha=1.0)
    phi = type(tf).potential(R, 0.0, 0.0, 0.0, *tf.in_engine_units())
    assert np.allclose(phi, -(210.0**2) * np.arctanh(12.0 / np.hypot(12.0, R)), rtol=1e-12)
    half = TruncatedFlat(v0=210.0, rs=12.0, alpha=0.45)
    u = 144.0 / (144.0 + R**2)
    wanted = -(210.0**2 / 0.45) * u**0.225 * hyp2f1(1, 0.225, 1.225, u)
    assert np.allclose(type(half).potential(R, 0.0, 0.0, 0.0, *half.in_engine_units()), wanted, rtol=1e-12)


def test_nfw_by_virial_mass():
    """M200 = 7.5e11, c = 20, H0 = 70: scale mass 3.584843593e11 Msun, scale radius 9.370845158 kpc."""
    q = np.array([[2.0], [-1.0], [2.0]]) / 3.0 * R
    virial = acceleration([NFWVirial(m200=7.5e11, c200=20.0, h0=70.0)], q)
    scale = acceleration([NFW(mass=3.584843593e11, rs=9.370845158)], q)
    assert np.allclose(virial, scale, rtol=1e-8)
    r200 = 20.0 * 9.370845158
    assert mass_profile(NFWVirial(m200=7.5e11, c200=20.0), np.array([r200]))[0] == pytest.approx(7.5e11, rel=1e-8)
    critical = 3 * 0.07**2 / (8 * np.pi * G)  # 70 km/s/Mpc in km/s/kpc
    assert 7.5e11 / (4 / 3 * np.pi * r200**3) == pytest.approx(200 * critical, rel=1e-8)


def test_nfw_depends_on_the_hubble_constant():
    """r200^3 = G M200 / (100 H0^2): H0 = 100 shrinks it by (70/100)^(2/3)."""
    rs = 9.370845158 * 0.7 ** (2 / 3)
    a = mass_profile(NFWVirial(m200=7.5e11, c200=20.0, h0=100.0))
    assert np.allclose(a, mass_profile(NFW(mass=3.584843593e11, rs=rs)), rtol=1e-8)


def test_law_majewski_circular_velocity_at_the_sun():
    """220.24 km/s at 8 kpc, from the radial force of halo, disc and bulge towards the Sun."""
    a = acceleration(LM10, [[-8.0], [0.0], [0.0]])
    assert np.sqrt(8.0 * a[0, 0]) == pytest.approx(220.24, abs=0.005)


GALPY = {
    "nfw": (NFW(mass=M, rs=B), gp.NFWPotential(amp=G * M, a=B)),
    "hernquist": (Hernquist(mass=M, a=B), gp.HernquistPotential(amp=2 * G * M, a=B)),
    "plummer": (Plummer(mass=M, radius=B), gp.PlummerPotential(amp=G * M, b=B)),
    "kepler": (Kepler(mass=M), gp.KeplerPotential(amp=G * M)),
    "isochrone": (Isochrone(mass=M, b=B), gp.IsochronePotential(amp=G * M, b=B)),
    "miyamoto_nagai": (
        MiyamotoNagai(mass=M, a=6.5, b=0.26),
        gp.MiyamotoNagaiPotential(amp=G * M, a=6.5, b=0.26),
    ),
}
POINTS = np.random.default_rng(11).uniform(-60.0, 60.0, (3, 30))


@pytest.mark.parametrize("name", GALPY)
def test_against_galpy(name):
    ours, theirs = GALPY[name]
    wanted = galpy_acceleration(theirs, POINTS)
    assert np.allclose(acceleration([ours], POINTS), wanted, rtol=1e-9, atol=1e-12 * np.abs(wanted).max())
    phi = type(ours).potential(*POINTS, 0.0, *ours.in_engine_units())
    radius, angle = np.hypot(*POINTS[:2]), np.arctan2(POINTS[1], POINTS[0])
    where = zip(radius, POINTS[2], angle, strict=True)
    galpy_phi = [
        float(gp.evaluatePotentials(theirs, float(r), float(z), phi=float(f), use_physical=False)) for r, z, f in where
    ]
    assert np.allclose(phi, galpy_phi, rtol=1e-10)


def test_tf_against_galpy_through_its_density():
    """The density is two Zhao spheroids of inner slope 2; galpy integrates them."""
    v0, rs, alpha = 210.0, 12.0, 0.45
    factor = v0**2 * rs**alpha / (4 * np.pi)  # G is in galpy's density unit

    def density(r):
        inner = (1 - alpha) * r**-2 * (rs**2 + r**2) ** (-alpha / 2)
        outer = alpha * rs**2 * r**-2 * (rs**2 + r**2) ** (-1 - alpha / 2)
        return factor * (inner + outer)

    wanted = galpy_acceleration(gp.AnySphericalPotential(dens=density), POINTS)
    ours = acceleration([TruncatedFlat(v0=v0, rs=rs, alpha=alpha)], POINTS)
    assert np.allclose(ours, wanted, rtol=1e-6)


def test_triaxial_rotated_halo_against_galpy():
    """galpy's halo has its long axes on the coordinate axes and a factor 1/2: turn the points, double v^2.

    (x'/q1)^2 + (y'/q2)^2 + (z/qz)^2 + rh^2 is galpy's x^2 + (y/b)^2 + (z/q)^2 + core^2, times q1^2.
    """
    v, rh, q1, q2, qz, phi = 121.858, 12.0, 1.38, 1.0, 1.36, np.radians(97.0)
    halo = gp.LogarithmicHaloPotential(amp=2 * v**2, b=q2 / q1, q=qz / q1, core=rh * q1)
    turn = np.array([[np.cos(phi), np.sin(phi), 0], [-np.sin(phi), np.cos(phi), 0], [0, 0, 1.0]])
    wanted = turn.T @ galpy_acceleration(halo, turn @ POINTS)
    ours = acceleration(LM10[:1], POINTS)
    assert np.allclose(ours, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())


def test_law_majewski_coefficients():
    """C1, C2, C3 = 0.99295, 0.53215, 0.11489, read back from the force at three points."""
    halo = LM10[0]
    v, rh = 121.858, 12.0
    x, y = acceleration([halo], [[3.0, 0.0], [0.0, 3.0], [0.0, 0.0]]).T
    # a = -v^2 (2 C1 x, C3 x) / (C1 x^2 + rh^2) on the x axis, and likewise on the y axis
    c1 = -x[0] * rh**2 / (v**2 * 2 * 3.0 + x[0] * 9.0)
    c2 = -y[1] * rh**2 / (v**2 * 2 * 3.0 + y[1] * 9.0)
    c3 = -x[1] * (c1 * 9.0 + rh**2) / (v**2 * 3.0)
    assert [round(c, 5) for c in (c1, c2, c3)] == [0.99295, 0.53215, 0.11489]


@pytest.mark.parametrize("potentials", [[TruncatedFlat(v0=210.0, rs=12.0, alpha=0.45)], LM10], ids=["tf", "lm10"])
def test_energy_is_conserved_along_an_orbit(potentials):
    orbit = build_field(potentials).orbit(
        np.array([16.3, 2.4, -6.2]), np.array([244.0, -21.0, 198.0]), 0.0, -3.0, 0.0005
    )
    energy = reference.energy(potentials, orbit.t, orbit.q, orbit.v)
    assert np.ptp(energy) < 1e-7 * np.abs(energy).max()
