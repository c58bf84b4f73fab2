"""The potentials a Milky Way needs, and its presets: against closed forms, quadrature, galpy and gala."""

from itertools import pairwise

import numpy as np
import pytest
from galpy import potential as galpy_potential
from galpy.potential import MWPotential2014
from of_galpy import galpy_acceleration
from scipy.integrate import quad
from scipy.special import gammainc

from streamkit import G
from streamkit.builtin.potentials import milky_way
from streamkit.builtin.potentials.bar import Bar
from streamkit.builtin.potentials.closed_forms import NFW, Hernquist, Logarithmic, Plummer
from streamkit.builtin.potentials.discs import ExponentialDisc, Sech2Disc
from streamkit.builtin.potentials.halos import LogarithmicHalo, NFWEllipsoidal, NFWTriaxial
from streamkit.builtin.potentials.spheroids import Dehnen, PowerCutoff, Spheroid
from streamkit.components import load_registry
from streamkit.engine import build_field
from streamkit.testing import reference

CLASSES = (NFWTriaxial, NFWEllipsoidal, LogarithmicHalo, Dehnen, Spheroid, PowerCutoff, ExponentialDisc, Sech2Disc, Bar)
M, A = 3.0e10, 2.5
RNG = np.random.default_rng(14)
POINTS = RNG.uniform(-60.0, 60.0, (3, 40))
INSIDE = RNG.uniform(-6.0, 6.0, (3, 40))
EVERYWHERE = np.concatenate([POINTS, INSIDE], axis=1)
RADII = np.geomspace(1e-3, 1e3, 25)
DIRECTION = np.array([2.0, -1.0, 2.0])[:, None] / 3.0


def acceleration(potentials, q, t=0.0):
    return reference.acceleration(potentials, t, np.asarray(q, dtype=float))


def energy(potential, q, t=0.0):
    return type(potential).potential(*np.asarray(q, dtype=float), t, *potential.in_engine_units())


def mass(potential, r):
    return -(r**2) * (acceleration([potential], DIRECTION * r) * DIRECTION).sum(axis=0) / G


def close(found, wanted, tolerance):
    """Difference of accelerations (3, n) relative to their size."""
    size = np.sqrt((wanted**2).sum(axis=0))
    error = np.sqrt(((found - wanted) ** 2).sum(axis=0)) / size
    assert error.max() <= tolerance, error.max()


def in_steps(slope, r, gamma):
    """Integral of ``slope(s) s`` over ln s from 0 to r, where slope(s) s ~ s^(3 - gamma)."""
    top = np.log(r)
    edges = np.linspace(min(top, 0.0) - 40.0 / (3.0 - gamma), top, 60)
    return sum(
        quad(lambda u: slope(np.exp(u)) * np.exp(u), a, b, epsabs=0, epsrel=1e-13)[0] for a, b in pairwise(edges)
    )


def gala_acceleration(potential, q, t=0.0):
    u = pytest.importorskip("astropy.units")
    return potential.acceleration(q * u.kpc, t=t * u.kpc / (u.km / u.s)).to_value((u.km / u.s) ** 2 / u.kpc)


@pytest.fixture(scope="module")
def gala():
    return pytest.importorskip("gala.potential")


@pytest.fixture(scope="module")
def galactic():
    return pytest.importorskip("gala.units").galactic


@pytest.mark.parametrize("cls", CLASSES)
def test_the_force_at_the_centre_vanishes(cls):
    potential = cls(**cls.example)
    assert cls.reference
    centre = np.zeros((3, 1))
    assert np.array_equal(acceleration([potential], centre), centre)
    assert np.array_equal(build_field([potential]).acceleration(0.0, centre), centre)


# Haloes


def test_nfw_triaxial_without_flattening_is_nfw():
    ours = NFWTriaxial(mass=M, rs=A, phi=30.0)
    close(acceleration([ours], EVERYWHERE), acceleration([NFW(mass=M, rs=A)], EVERYWHERE), 1e-12)
    assert np.allclose(energy(ours, EVERYWHERE), energy(NFW(mass=M, rs=A), EVERYWHERE), rtol=1e-12)


@pytest.mark.parametrize(("p", "q"), [(1.0, 0.8), (1.0, 1.3), (0.9, 0.8)])
def test_nfw_triaxial_against_gala(gala, galactic, p, q):
    theirs = gala.NFWPotential(m=M, r_s=A, a=1.0, b=p, c=q, units=galactic)
    ours = NFWTriaxial(mass=M, rs=A, p=p, q=q)
    close(acceleration([ours], EVERYWHERE), gala_acceleration(theirs, EVERYWHERE), 1e-9)


def test_nfw_triaxial_turns_with_its_axes():
    turn = np.radians(40.0)
    matrix = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    straight = {"mass": M, "rs": A, "p": 0.7, "q": 0.9}
    wanted = matrix.T @ acceleration([NFWTriaxial(**straight)], matrix @ EVERYWHERE)
    close(acceleration([NFWTriaxial(**straight, phi=40.0)], EVERYWHERE), wanted, 1e-12)


def test_nfw_ellipsoidal_without_flattening_is_nfw():
    ours = NFWEllipsoidal(mass=M, rs=A, phi=30.0)
    close(acceleration([ours], EVERYWHERE), acceleration([NFW(mass=M, rs=A)], EVERYWHERE), 1e-7)
    assert np.allclose(energy(ours, EVERYWHERE), energy(NFW(mass=M, rs=A), EVERYWHERE), rtol=1e-7)


@pytest.mark.parametrize(("p", "q"), [(1.0, 1.05), (1.0, 0.5), (1.0, 2.0), (0.8, 0.6)])
@pytest.mark.parametrize(("rs", "tolerance"), [(16.0, 1e-8), (1.3, 1e-7)])
def test_nfw_ellipsoidal_against_galpy(p, q, rs, tolerance):
    theirs = galpy_potential.TriaxialNFWPotential(amp=G * M, a=rs, b=p, c=q, glorder=200)
    ours = NFWEllipsoidal(mass=M, rs=rs, p=p, q=q)
    close(acceleration([ours], EVERYWHERE), galpy_acceleration(theirs, EVERYWHERE), tolerance)


def test_nfw_ellipsoidal_has_its_density():
    """Poisson's equation, with the axes turned."""
    ours = NFWEllipsoidal(mass=M, rs=16.0, p=0.8, q=0.6, phi=90.0)
    x, y, z = POINTS
    r = np.sqrt(y**2 + (x / 0.8) ** 2 + (z / 0.6) ** 2)
    divergence, _ = reference.divergence_and_curl(ours, np.zeros(len(r)), POINTS)
    assert np.allclose(-divergence / (4 * np.pi * G), M / (4 * np.pi * r * (r + 16.0) ** 2), rtol=1e-5)


@pytest.mark.parametrize(("rc", "p", "q"), [(0.0, 1.0, 0.9), (3.0, 1.0, 1.2), (12.0, 0.9, 0.8)])
def test_logarithmic_halo_against_galpy(rc, p, q):
    ours = LogarithmicHalo(v0=220.0, rc=rc, p=p, q=q)
    theirs = galpy_potential.LogarithmicHaloPotential(amp=220.0**2, q=q, core=rc, b=p)
    close(acceleration([ours], EVERYWHERE), galpy_acceleration(theirs, EVERYWHERE), 1e-10)


def test_logarithmic_halo_has_the_factor_one_half():
    """v0 is the circular speed far out in the plane; Law & Majewski's v_h is that over the root of two."""
    ours = LogarithmicHalo(v0=220.0, rc=12.0, q=0.9)
    far = acceleration([ours], [[1e5], [0.0], [0.0]])
    assert np.sqrt(-far[0, 0] * 1e5) == pytest.approx(220.0, rel=1e-7)
    other = Logarithmic(v_h=220.0 / np.sqrt(2.0), r_h=12.0, qz=0.9)
    close(acceleration([ours], EVERYWHERE), acceleration([other], EVERYWHERE), 1e-12)
    assert np.allclose(energy(ours, EVERYWHERE), energy(other, EVERYWHERE), rtol=1e-12)


# Spheres


@pytest.mark.parametrize("gamma", [0.0, 0.5, 1.0, 1.5, 2.0, 2.7])
def test_dehnen_mass_and_energy(gamma):
    """Dehnen 1993, eqs. 1-3: the density, and M(r) and Phi from it."""
    ours = Dehnen(mass=M, a=A, gamma=gamma)
    density = lambda s: (3 - gamma) * M * A / (4 * np.pi) * s**-gamma * (s + A) ** (gamma - 4)  # noqa: E731
    r = np.array([0.02, 1.0, 30.0])
    wanted = np.array([in_steps(lambda s: 4 * np.pi * s**2 * density(s), one, gamma) for one in r])
    assert np.allclose(mass(ours, r), wanted, rtol=1e-11)
    q = DIRECTION * r
    shells = [quad(lambda s: 4 * np.pi * s * density(s), one, np.inf, epsabs=0, epsrel=1e-11)[0] for one in r]
    assert np.allclose(energy(ours, q), -G * (wanted / r + shells), rtol=1e-9)


def test_dehnen_is_hernquist_and_galpy():
    hernquist = acceleration([Hernquist(mass=M, a=A)], EVERYWHERE)
    close(acceleration([Dehnen(mass=M, a=A, gamma=1.0)], EVERYWHERE), hernquist, 1e-12)
    theirs = galpy_potential.DehnenSphericalPotential(amp=(3 - 1.3) * G * M, a=A, alpha=1.3)
    close(acceleration([Dehnen(mass=M, a=A, gamma=1.3)], EVERYWHERE), galpy_acceleration(theirs, EVERYWHERE), 1e-9)


SLOPES = [
    (1.0, 3.0, 1.0), (1.0, 3.0, 0.0), (1.0, 3.0, 2.5), (1.0, 3.0 + 1e-9, 0.3), (1.0, 3.0001, 1.0), (1.0, 4.0, 1.5),
    (2.0, 5.0, 0.0), (1.7, 5.5, 1.2), (0.6, 3.3, 0.8), (1.0, 2.6, 1.0), (0.5, 2.6, 0.0), (4.0, 8.0, 0.0),
    (4.0, 3.0, 2.5), (0.5, 8.0, 2.5), (0.5, 8.0, 0.0), (1.0, 3.2, 2.0),
]  # fmt: skip


@pytest.mark.parametrize("slopes", SLOPES)
def test_spheroid_mass_by_quadrature(slopes):
    """From r/a = 1e-3 to 1e3, and at the radius where one series follows the other."""
    alpha, beta, gamma = slopes
    r = A * np.array([1e-3, 0.03, 0.5, 0.999, 1.0, 1.001, 2.0, 50.0, 1e3])
    shape = lambda s: s ** (2 - gamma) * np.exp((gamma - beta) / alpha * np.log1p(s**alpha))  # noqa: E731
    wanted = M * np.array([in_steps(shape, one, gamma) for one in r / A])
    result = mass(Spheroid(mass=M, a=A, alpha=alpha, beta=beta, gamma=gamma), r)
    assert np.allclose(result, wanted, rtol=1e-12 if alpha == 1.0 else 1e-10)


@pytest.mark.parametrize("slopes", SLOPES)
def test_spheroid_energy_by_quadrature(slopes):
    alpha, beta, gamma = slopes
    ours = Spheroid(mass=M, a=A, alpha=alpha, beta=beta, gamma=gamma)
    r = A * np.array([0.01, 0.5, 3.0, 80.0])
    shape = lambda u: np.exp((2 - gamma) * u + (gamma - beta) / alpha * np.logaddexp(0.0, alpha * u))  # noqa: E731

    def shells(s):
        edges = np.linspace(np.log(s), max(np.log(s), 0.0) + 40.0 / (beta - 2.0), 60)
        return sum(quad(shape, a, b, epsabs=0, epsrel=1e-12)[0] for a, b in pairwise(edges))

    outer = M / A * np.array([shells(one) for one in r / A])
    inner = mass(ours, r) / r  # tested above
    assert np.allclose(energy(ours, DIRECTION * r), -G * (inner + outer), rtol=1e-9)


def test_spheroid_in_its_special_cases():
    nfw = Spheroid(mass=M, a=A)
    wanted = M * (np.log1p(RADII / A) - RADII / (RADII + A))
    assert np.allclose(mass(nfw, RADII)[8:], wanted[8:], rtol=1e-10)  # the closed form cancels further in
    plummer = Spheroid(mass=3 * M, a=A, alpha=2.0, beta=5.0, gamma=0.0)
    close(acceleration([plummer], EVERYWHERE), acceleration([Plummer(mass=M, radius=A)], EVERYWHERE), 1e-12)
    dehnen = Spheroid(mass=(3 - 1.4) * M, a=A, beta=4.0, gamma=1.4)
    close(acceleration([dehnen], EVERYWHERE), acceleration([Dehnen(mass=M, a=A, gamma=1.4)], EVERYWHERE), 1e-12)
    theirs = galpy_potential.TwoPowerSphericalPotential(amp=G * M, a=A, alpha=0.7, beta=3.4)
    gnfw = Spheroid(mass=M, a=A, beta=3.4, gamma=0.7)
    close(acceleration([gnfw], EVERYWHERE), galpy_acceleration(theirs, EVERYWHERE), 1e-9)


@pytest.mark.parametrize("alpha", [0.0, 0.5, 1.0, 1.8, 2.0, 2.4, 2.8])
def test_power_cutoff_mass_and_energy(alpha):
    ours = PowerCutoff(mass=M, alpha=alpha, rc=A)
    radii = np.append(RADII, A * np.sqrt(5.0) * np.array([0.999, 1.0, 1.001]))
    assert np.allclose(mass(ours, radii), M * gammainc(1.5 - alpha / 2, (radii / A) ** 2), rtol=1e-12)
    r = np.array([0.05, 1.0, 4.0, 40.0])
    slope = 3 - alpha
    whole = quad(lambda u: np.exp(slope * u - np.exp(2 * u)), -60.0 / slope, 4.0, epsrel=1e-12, limit=400)[0]
    shell = lambda s: s ** (1 - alpha) * np.exp(-(s**2))  # noqa: E731
    shells = [quad(shell, one / A, 8.0, epsabs=0, epsrel=1e-11)[0] for one in r[:3]]
    wanted = -G * M * (gammainc(slope / 2, (r / A) ** 2) / r + np.append(shells, 0.0) / whole / A)
    assert np.allclose(energy(ours, DIRECTION * r), wanted, rtol=1e-9)


def test_power_cutoff_against_galpy():
    whole = quad(lambda s: 4 * np.pi * s**0.2 * np.exp(-((s / 1.9) ** 2)), 0.0, 20.0, epsabs=0, epsrel=1e-12)[0]
    theirs = galpy_potential.PowerSphericalPotentialwCutoff(amp=G * M / whole, alpha=1.8, rc=1.9)
    ours = PowerCutoff(mass=M, alpha=1.8, rc=1.9)
    close(acceleration([ours], EVERYWHERE), galpy_acceleration(theirs, EVERYWHERE), 1e-9)


# Discs


@pytest.mark.parametrize(("cls", "sech"), [(ExponentialDisc, False), (Sech2Disc, True)])
@pytest.mark.parametrize("height", [0.1, 0.3, 0.9, 1.9])
def test_discs_against_gala_and_galpy(gala, galactic, cls, sech, height):
    ours = cls(mass=M, rd=2.6, height=height)
    theirs = gala.MN3ExponentialDiskPotential(m=M, h_R=2.6, h_z=height, sech2_z=sech, units=galactic)
    close(acceleration([ours], EVERYWHERE), gala_acceleration(theirs, EVERYWHERE), 1e-9)
    density = G * M / (4 * np.pi * 2.6**2 * height)
    other = galpy_potential.MN3ExponentialDiskPotential(amp=density, hr=2.6, hz=height, sech=sech, posdens=True)
    close(acceleration([ours], EVERYWHERE), galpy_acceleration(other, EVERYWHERE), 1e-9)


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")  # in galpy's quadrature
def test_exponential_disc_is_near_the_exponential():
    """galpy integrates the double exponential disc: 1.2 per cent up to five scale lengths.

    Far out the three discs are up to 15 per cent heavier.
    """
    density = G * M / (4 * np.pi * 2.5**2 * 0.3)
    theirs = galpy_potential.DoubleExponentialDiskPotential(amp=density, hr=2.5, hz=0.3)
    disc = ExponentialDisc(mass=M, rd=2.5, height=0.3)
    q = np.stack([np.linspace(2.5, 12.5, 9), np.zeros(9), np.zeros(9)])
    close(acceleration([disc], q), galpy_acceleration(theirs, q), 0.012)
    far = mass(disc, np.array([1e4]))[0]
    assert 1.10 * M < far < 1.15 * M


# The bar

BAR = {"mass": M, "a": 3.5, "b": 0.5, "c": 0.6}


def test_bar_against_gala(gala, galactic):
    u = pytest.importorskip("astropy.units")
    for angle in (0.0, 25.0, -27.0, 153.0):
        ours = Bar(**BAR, pattern_speed=-39.0, angle=angle)
        theirs = gala.LongMuraliBarPotential(m=M, a=3.5, b=0.5, c=0.6, alpha=angle * u.deg, units=galactic)
        close(acceleration([ours], EVERYWHERE), gala_acceleration(theirs, EVERYWHERE), 1e-9)


@pytest.mark.parametrize("t", [0.0, 0.031, -0.7, -4.9, 0.5])
def test_bar_turns_as_in_galpy(t):
    ours = Bar(**BAR, pattern_speed=-39.0, angle=25.0)
    pa = np.radians(25.0)
    theirs = galpy_potential.SoftenedNeedleBarPotential(amp=G * M, a=3.5, b=0.5, c=0.6, pa=pa, omegab=-39.0)
    close(acceleration([ours], EVERYWHERE, t), galpy_acceleration(theirs, EVERYWHERE, t), 1e-9)
    wanted = [
        galpy_potential.evaluatePotentials(theirs, np.hypot(x, y), z, phi=np.arctan2(y, x), t=t, use_physical=False)
        for x, y, z in POINTS.T
    ]
    assert np.allclose(energy(ours, POINTS, t), wanted, rtol=1e-9)


def test_bar_from_far_away_is_its_mass():
    far = acceleration([Bar(**BAR, pattern_speed=0.0)], [[0.0], [0.0], [1e4]])
    assert -far[2, 0] * 1e8 / G == pytest.approx(M, rel=1e-3)


# The presets


PRESETS = {
    preset.name: preset for preset in (milky_way.BOVY2014, milky_way.MCMILLAN2017, milky_way.GALA_V1, milky_way.GALA_V2)
}


def build(name):
    registry = load_registry()
    return [
        registry.find("potential", section["kind"], part)(**{k: v for k, v in section.items() if k != "kind"})
        for part, section in PRESETS[name].sections.items()
    ]


@pytest.mark.parametrize("name", PRESETS)
def test_presets_have_papers_and_a_sensible_rotation_curve(name):
    assert PRESETS[name].reference
    a = acceleration(build(name), [[8.2], [0.0], [0.0]])
    assert 215.0 < np.sqrt(-8.2 * a[0, 0]) < 240.0


def test_bovy_2014_against_galpy():
    wanted = galpy_acceleration(MWPotential2014, EVERYWHERE / 8.0) * 220.0**2 / 8.0
    close(acceleration(build("bovy2014"), EVERYWHERE), wanted, 1e-9)
    assert -8.0 * acceleration(build("bovy2014"), [[8.0], [0.0], [0.0]])[0, 0] == pytest.approx(220.0**2, rel=1e-9)


def test_gala_presets_against_gala(gala):
    for ours, theirs in {
        "gala_v1": gala.MilkyWayPotential(version="v1"),
        "gala_v2": gala.MilkyWayPotential(version="v2"),
        "bovy2014": gala.BovyMWPotential2014(),
    }.items():
        close(acceleration(build(ours), EVERYWHERE), gala_acceleration(theirs, EVERYWHERE), 1e-8)
    close(acceleration(build("gala_v2"), POINTS), gala_acceleration(gala.MilkyWayPotential(version="v2"), POINTS), 1e-9)


# R and z in kpc, radial and vertical force in (km/s)^2/kpc: galpy 1.12.1's McMillan17, which takes minutes to set up.
MCMILLAN = np.array([
    (3.0, 0.0, -14722.29, 0.0), (5.0, 0.0, -10221.79, 0.0), (8.21, 0.0, -6623.843, 0.0), (12.0, 0.0, -4407.069, 0.0),
    (20.0, 0.0, -2486.234, 0.0), (30.0, 0.0, -1587.685, 0.0), (70.0, 0.0, -583.1033, 0.0), (100.0, 0.0, -366.7491, 0.0),
    (200.0, 0.0, -137.9584, 0.0), (3.35689, 4.14817, -4445.039, -7279.21), (5.47098, 5.19057, -4017.312, -4766.489),
    (10.0291, 5.18541, -3676.878, -2323.521), (7.13123, 13.267, -1400.061, -2760.0),
    (19.0709, 9.45575, -1994.124, -1053.088), (31.0194, 13.3218, -1259.547, -554.2991),
    (45.8168, 13.3051, -891.464, -262.0278), (48.8688, 52.0917, -387.4661, -413.9916),
    (62.8066, 86.5441, -196.5439, -271.0472),
])  # fmt: skip


def test_mcmillan_2017_against_galpy():
    """As near as the comment beside the preset says."""
    r, z, radial, up = MCMILLAN.T
    a = acceleration(build("mcmillan2017"), np.stack([r, 0.0 * r, z]))
    error = np.hypot(a[0] - radial, a[2] - up) / np.hypot(radial, up)
    distance = np.hypot(r, z)
    assert error[distance > 4].max() < 0.03
    assert error[distance > 8].max() < 0.02
    assert error[distance > 15].max() < 0.008
    plane = z == 0
    assert np.abs(np.sqrt(-r * a[0]) - np.sqrt(-r * radial))[plane].max() < 1.7
