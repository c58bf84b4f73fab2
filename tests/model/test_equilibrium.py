"""Particles drawn from distribution functions: what they must be at every radius, by closed forms and by Jeans."""

import numpy as np
import pytest

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import NFW, Hernquist, Isochrone, MiyamotoNagai, Plummer
from streamkit.builtin.potentials.progenitors import King, TruncatedNFW
from streamkit.builtin.potentials.spheroids import Dehnen, Spheroid
from streamkit.model.equilibrium import Equilibrium

N = 2**15
SPHERES = [
    Plummer(mass=6.4e8, radius=0.85),
    Hernquist(mass=1e9, a=1.0),
    Dehnen(mass=1e9, a=1.0, gamma=1.0),
    Dehnen(mass=1e9, a=1.0, gamma=0.0),
    Dehnen(mass=1e9, a=1.0, gamma=1.5),
    Isochrone(mass=1e9, b=0.7),
    Spheroid(mass=3e9, a=1.0, alpha=2.0, beta=5.0, gamma=0.0),
    King(mass=2e4, rc=0.005, w0=6.0),
    TruncatedNFW(mass=1e9, rs=1.0, rt=8.0),
]


def named(potential):
    return f"{potential.kind}-{getattr(potential, 'gamma', '')}"


@pytest.fixture(scope="module")
def points():
    from scipy.stats import qmc

    return np.clip(qmc.Sobol(6, scramble=True, rng=np.random.default_rng(3)).random(N).T, 1e-12, 1 - 1e-12)


@pytest.mark.parametrize("potential", SPHERES, ids=named)
def test_density_is_that_of_the_potential(potential, points):
    sphere = Equilibrium(potential)
    q, _ = sphere.sample(points)
    r = np.sort(np.sqrt((q**2).sum(axis=0)))
    assert r[-1] <= sphere.cut * 1.001
    quantiles = np.array([0.05, 0.2, 0.5, 0.8, 0.95])
    at = r[(quantiles * N).astype(int)]
    assert sphere.mass_inside(at) / sphere.mass == pytest.approx(quantiles, abs=0.003)
    assert np.abs(q.mean(axis=1)).max() < 0.02 * r[N // 2] + 4 * r.std() / np.sqrt(N)


@pytest.mark.parametrize("potential", SPHERES, ids=named)
def test_dispersion_is_that_of_jeans(potential, points):
    """In shells: <v^2>/3 = (1/rho) integral of rho G M / r^2 outwards (Binney & Tremaine 2008, eq. 4.216)."""
    sphere = Equilibrium(potential)
    q, v = sphere.sample(points)
    r = np.sqrt((q**2).sum(axis=0))
    order = np.argsort(r)
    shells = np.array_split(order[N // 50 : N - N // 20], 8)
    fine = np.geomspace(1e-3 * r[order[N // 50]], 1e3 * r.max(), 20001)
    mass = sphere.mass_inside(fine)
    density = np.gradient(mass, fine) / fine**2
    middle = 0.5 * (fine[1:] + fine[:-1])
    push = 0.5 * (density[1:] + density[:-1]) * sk.G * np.interp(middle, fine, mass) / middle**2 * np.diff(fine)
    outward = np.append(np.cumsum(push[::-1])[::-1], 0.0)
    with np.errstate(all="ignore"):
        dispersion2 = np.where(density > 0, outward / density, 0.0)
    for shell in shells:
        expected = np.interp(r[shell], fine, dispersion2).mean()
        assert (v[:, shell] ** 2).sum(axis=0).mean() / 3 == pytest.approx(expected, rel=0.03)
        assert np.abs(np.var(v[:, shell], axis=1) / expected - 1).max() < 0.08  # on each axis


@pytest.mark.parametrize("potential", SPHERES, ids=named)
def test_nobody_is_faster_than_the_escape_speed(potential, points):
    sphere = Equilibrium(potential)
    q, v = sphere.sample(points)
    table = sphere.table
    depth = np.interp(0.5 * np.log((q**2).sum(axis=0)), table.ln_r, table.depth)
    assert (0.5 * (v**2).sum(axis=0) <= depth * 1.001).all()


def test_eddington_gives_the_closed_forms(points):
    """Plummer's and Hernquist's spheres by the table: the speeds at the same random numbers."""
    for potential in SPHERES[:2]:
        sphere = Equilibrium(potential)
        share = points[0] * sphere.mass / sphere.total
        r, speed = type(potential).equilibrium(share, points[1], *potential.in_engine_units())
        r_table, speed_table = sphere._drawn(share, points[1])
        inner = (points[0] > 0.01) & (points[1] < 0.99)
        assert r_table[inner] == pytest.approx(r[inner], rel=2e-3)
        assert speed_table[inner] == pytest.approx(speed[inner], rel=0.02)
        assert np.abs(speed_table[inner] / speed[inner] - 1).mean() < 2e-3


@pytest.mark.parametrize("tail", [1e-2, 1e-3, 1e-4])
def test_particles_near_the_speed_of_escape_are_as_rare_as_they_should_be(tail):
    """Plummer's s^2 (1 - s^2)^(7/2), and Hernquist's eq. 17 integrated at r = a, beyond 99 to 99.99 % of the speeds."""
    from scipy.integrate import quad
    from scipy.optimize import brentq
    from scipy.special import betaincinv

    def hernquist(s):
        q2 = 0.5 * (1 - s * s)
        q = np.sqrt(q2)
        return s * s * (
            3 * np.arcsin(q) + q * np.sqrt(1 - q2) * (1 - 2 * q2) * (8 * q2 * q2 - 8 * q2 - 3)
        ) / (1 - q2) ** 2.5

    whole = quad(hernquist, 0, 1)[0]
    at_a = brentq(lambda s: quad(hernquist, s, 1)[0] - tail * whole, 0.5, 0.9999)
    for potential, share, expected in (
        (SPHERES[0], 0.5, np.sqrt(betaincinv(1.5, 4.5, 1 - tail))), (SPHERES[1], 0.25, at_a),
    ):  # fmt: skip
        r, speed = type(potential).equilibrium(np.array([share]), np.array([1 - tail]), *potential.in_engine_units())
        _, by_table = Equilibrium(potential)._drawn(np.array([share]), np.array([1 - tail]))
        escape = np.sqrt(2 * np.interp(np.log(r), *(Equilibrium(potential).table[k] for k in (0, 2))))
        assert speed / escape == pytest.approx(expected, rel=2e-3)
        assert by_table / escape == pytest.approx(expected, rel=5e-3)


def test_scale_of_plummer_and_hernquist_is_their_own():
    assert Equilibrium(SPHERES[0]).scale == pytest.approx(0.85, rel=1e-6)
    assert Equilibrium(SPHERES[1]).scale == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize(
    ("potential", "words"),
    [
        (NFW(mass=1e9, rs=1.0), "an infinite mass"),
        (MiyamotoNagai(mass=1e9, a=1.0, b=0.3), "is no sphere"),
    ],
)
def test_what_is_no_finite_sphere_is_refused(potential, words):
    with pytest.raises(sk.OutOfDomain, match=words):
        Equilibrium(potential).sample(np.full((6, 10), 0.5))


class Hollow(sk.Potential):
    """A thick shell with nothing inside: its particles would have to fall in and leave again."""

    kind = "hollow_shell"
    mass: sk.Mass = 1e9
    a: sk.Length = 1.0

    @staticmethod
    def acceleration(x, y, z, t, mass, a):
        """Return the pull of M r^6 / (r^2 + a^2)^3, whose density vanishes at the centre."""
        d2 = x * x + y * y + z * z
        s = d2 + a * a
        k = -sk.G * mass * d2 * sk.sqrt(d2) / (s * s * s)
        return k * x, k * y, k * z


def test_negative_distribution_function_is_an_error_with_a_sentence():
    with pytest.raises(sk.OutOfDomain, match=r"hollow_shell has no isotropic equilibrium.*negative"):
        Equilibrium(Hollow()).sample(np.full((6, 10), 0.5))


def plummer(a):
    return lambda r: (1 + (r / a) ** 2) ** -2.5


def hernquist(a):
    return lambda r: 1 / (r * (r + a) ** 3)


def test_stars_that_fall_less_steeply_than_their_halo_are_carried_by_all_particles(points):
    """f ~ E^(n - 3/2) far out where the density falls as r^-n: for stars with n = 4 in a halo with n = 5 the ratio is
    1 / E, and so large only for particles that are nearly free, which are as rare as E^(9/2)."""
    sphere = Equilibrium(TruncatedNFW(mass=2e9, rs=1.0, rt=5.0))
    weight = sphere.weigh(*sphere.sample(points), hernquist(0.7))
    assert weight.max() < 20
    assert weight.sum() ** 2 / (weight**2).sum() > 0.6 * N


@pytest.mark.parametrize(
    ("halo", "a"),
    [(Plummer(mass=6.4e8, radius=0.85), 0.4), (Dehnen(mass=1e9, a=1.0, gamma=0.0), 0.3)],
    ids=["plummer", "cored"],
)
def test_weighted_particles_are_the_stars(halo, a, points):
    """The shares of their mass inside radii, and <v^2> = <G M(<r) / r> by the virial theorem of a tracer."""
    sphere = Equilibrium(halo)
    q, v = sphere.sample(points)
    weight = sphere.weigh(q, v, plummer(a))
    assert weight.mean() == pytest.approx(1)
    r = np.sqrt((q**2).sum(axis=0))
    for radius in (0.5 * a, a, 2 * a, 4 * a):
        share = (1 + (a / radius) ** 2) ** -1.5
        assert weight[r < radius].sum() / weight.sum() == pytest.approx(share, abs=0.01)
    fine = np.geomspace(1e-3 * a, 1e3 * a, 20001)
    shell = plummer(a)(fine) * fine**3
    virial = (shell * sk.G * sphere.mass_inside(fine) / fine).sum() / shell.sum()
    assert np.average((v**2).sum(axis=0), weights=weight) == pytest.approx(virial, rel=0.02)


def test_stars_like_the_mass_all_weigh_the_same(points):
    sphere = Equilibrium(Plummer(mass=6.4e8, radius=0.85))
    weight = sphere.weigh(*sphere.sample(points), plummer(0.85))
    assert np.quantile(weight, [0.01, 0.5, 0.97]) == pytest.approx(1, abs=0.02)


def test_core_of_stars_in_a_cusp_has_no_isotropic_equilibrium(points):
    """Evans, An & Walker 2009, MNRAS 393, L50: cored light in cusped haloes."""
    sphere = Equilibrium(TruncatedNFW(mass=1e9, rs=1.0, rt=8.0))
    with pytest.raises(sk.OutOfDomain, match=r"no isotropic equilibrium.*a core in a cusp"):
        sphere.weigh(*sphere.sample(points), plummer(0.3))
