"""Integrators on orbits known in closed form, and against the oracle (order: test_conformance.py)."""

import itertools

import numpy as np
import pytest
from pydantic import ValidationError

from streamkit import GYR, G, Orbit, Potential
from streamkit.builtin.integrators.adaptive import LARGEST_ETA, Adaptive
from streamkit.builtin.integrators.fixed_step import ForestRuth, Leapfrog
from streamkit.builtin.integrators.reference import Reference
from streamkit.builtin.potentials.closed_forms import Isochrone, Kepler, Plummer, TruncatedFlat
from streamkit.engine import LEAPFROG, PEFRL, RKN4, adaptive_step, build_field, split_step
from streamkit.sample.calls.timeout import NO_ANSWER, call_with_timeout
from streamkit.testing import reference

# position error in kpc allowed after one radial period with the default settings: particle noise is 0.2 kpc
DEFAULTS = {Leapfrog: 3e-2, ForestRuth: 3e-3, Adaptive: 3e-3, Reference: 1e-6}


def march(integrator, field, q, v, t0, t1, block=0.02 * GYR):
    """Advance copies of q, v (3, n) from t0 to t1 block by block."""
    q, v = q.copy(), v.copy()
    edges = np.linspace(t0, t1, max(int(np.ceil((t1 - t0) / block)), 1) + 1)
    for begin, end in itertools.pairwise(edges):
        integrator.advance(field, q, v, np.full(q.shape[1], begin), end)
    return q, v


MASS, A, E = 1.0e11, 25.0, 0.5
PERIOD = 2 * np.pi * np.sqrt(A**3 / (G * MASS))
X, Y = np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0])


def kepler(t):
    """Exact state on the ellipse a time t after the pericentre, by Kepler's equation."""
    anomaly = 2 * np.pi * t / PERIOD
    eccentric = anomaly
    for _ in range(60):
        eccentric -= (eccentric - E * np.sin(eccentric) - anomaly) / (1 - E * np.cos(eccentric))
    c, s, root = np.cos(eccentric), np.sin(eccentric), np.sqrt(1 - E**2)
    rate = 2 * np.pi / PERIOD / (1 - E * c)
    q = A * ((c - E) * X + root * s * Y)
    v = A * rate * (-s * X + root * c * Y)
    return q[:, None], v[:, None]


@pytest.mark.parametrize("method", [LEAPFROG, PEFRL, RKN4])
def test_the_longest_step_is_the_last_stable_one_of_the_leapfrog(method):
    """A step of an oscillator of frequency 1 is a linear map of determinant 1, stable where its trace is below 2."""

    def trace(step):
        state = np.eye(2)
        for drift, kick in itertools.zip_longest(method.drift, method.kick, fillvalue=0.0):
            state = np.array([[1, 0], [-kick * step, 1]]) @ np.array([[1, drift * step], [0, 1]]) @ state
        return abs(np.trace(state))

    assert max(map(trace, np.linspace(0.01, 0.99 * LARGEST_ETA, 100))) < 2
    assert (trace(1.01 * LARGEST_ETA) > 2) == (method is LEAPFROG)
    with pytest.raises(ValidationError, match="less than or equal to 2"):
        Adaptive(eta=1.01 * LARGEST_ETA)


@pytest.mark.parametrize("cls", DEFAULTS)
@pytest.mark.parametrize("fraction", [0.37, 1.0])
def test_kepler_orbit(cls, fraction):
    q, _ = march(cls(), build_field([Kepler(mass=MASS)]), *kepler(0.0), 0.0, fraction * PERIOD)
    wanted = kepler(fraction * PERIOD)[0]
    assert np.linalg.norm(q - wanted) < DEFAULTS[cls]


def isochrone_orbit():
    """A start at the pericentre of an orbit in the isochrone, with its exact radial and azimuthal periods.

    Binney & Tremaine 2008, eqs. 3.39-3.41: T_r = 2 pi G M / (-2 E)^(3/2), and in one of them the angle
    pi (1 + L / sqrt(L^2 + 4 G M b)) is swept.
    """
    mass, b, r, speed = 2.0e11, 3.0, 10.0, 320.0
    potential = -G * mass / (b + np.hypot(b, r))
    energy, momentum = 0.5 * speed**2 + potential, r * speed
    period = 2 * np.pi * G * mass / (-2 * energy) ** 1.5
    angle = np.pi * (1 + momentum / np.sqrt(momentum**2 + 4 * G * mass * b))
    return [Isochrone(mass=mass, b=b)], (r * X)[:, None], (speed * Y)[:, None], period, angle


@pytest.mark.parametrize("cls", DEFAULTS)
def test_isochrone_periods(cls):
    """After one radial period: the same radius and speeds, the angle advanced by the closed form."""
    host, q0, v0, period, angle = isochrone_orbit()
    q, v = march(cls(), build_field(host), q0, v0, 0.0, period)
    r = 10.0
    turned = np.cos(angle) * X + np.sin(angle) * Y
    ahead = -np.sin(angle) * X + np.cos(angle) * Y
    assert np.linalg.norm(q[:, 0] - r * turned) < DEFAULTS[cls]
    assert np.linalg.norm(v[:, 0] - 320.0 * ahead) < DEFAULTS[cls] / r * 320.0


def test_engine_orbit_has_the_isochrones_periods():
    """The progenitor's own integrator: pericentres one radial period apart, the angle by the formula."""
    host, q0, v0, period, angle = isochrone_orbit()
    orbit = build_field(host).orbit(q0[:, 0], v0[:, 0], 0.0, 3.2 * period, 0.002)
    passages = orbit.pericentres()
    passages = passages[passages > 0.1]
    assert np.allclose(passages, period * np.array([1.0, 2.0, 3.0]), rtol=1e-7)
    at = orbit.at(passages).q
    swept = np.arctan2(Y @ at, X @ at)
    wanted = angle * np.array([1.0, 2.0, 3.0])
    assert np.allclose((swept - wanted + np.pi) % (2 * np.pi) - np.pi, 0.0, atol=1e-5)


@pytest.mark.parametrize("cls", DEFAULTS)
def test_energy_and_angular_momentum_over_three_gyr(cls):
    host = [TruncatedFlat(v0=210.0, rs=12.0, alpha=0.45)]
    q0, v0 = np.array([[16.3], [2.4], [-6.2]]), np.array([[244.0], [-21.0], [198.0]])
    q, v = march(cls(), build_field(host), q0, v0, -3 * GYR, 0.0)
    before, after = (reference.energy(host, 0.0, *w)[0] for w in ((q0, v0), (q, v)))
    assert abs(after - before) < 1e-4 * 0.5 * (v0**2).sum()
    momentum, later = np.cross(q0[:, 0], v0[:, 0]), np.cross(q[:, 0], v[:, 0])
    # kicks towards the centre and drifts keep it to rounding, Nystrom's steps only to their error
    error = {Leapfrog: 1e-11, ForestRuth: 1e-11, Adaptive: 1e-6, Reference: 1e-7}[cls]
    assert np.allclose(later, momentum, rtol=0, atol=error * np.linalg.norm(momentum))


def equal_steps(method, field, q, v, t1, n):
    """March from 0 to t1 in n equal steps of a method, in place; None is Nystrom's, which calm particles take."""
    for begin, end in itertools.pairwise(np.linspace(0.0, t1, n + 1)):
        t0 = np.full(q.shape[1], begin)
        if method is None:
            adaptive_step(field, RKN4, q, v, t0, end, np.full(2, 1e3), 0)
        else:
            split_step(field, method, q, v, t0, end, 1)


@pytest.mark.parametrize(("method", "order"), [(LEAPFROG, 2), (PEFRL, 4), (RKN4, 4), (None, 5)])
def test_order_on_keplers_ellipse(method, order):
    """The position error well after the pericentre falls as h^order."""
    steps, errors, t = np.array([128, 256, 512]), [], 0.37 * PERIOD
    for n in steps:
        q, v = kepler(0.0)
        equal_steps(method, build_field([Kepler(mass=MASS)]), q, v, t, n)
        errors.append(np.linalg.norm(q - kepler(t)[0]) / A)
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.3)


HOST = [TruncatedFlat(v0=210.0, rs=12.0, alpha=0.45)]
SATELLITE = [Plummer(mass=6.4e8, radius=0.85)]
TODAY = np.array([16.3, 2.4, -6.2]), np.array([244.0, -21.0, 198.0])


@pytest.fixture(scope="module")
def debris():
    """Particles released near the moving progenitor between the blocks' edges, and the oracle's answer."""
    orbit = build_field(HOST).orbit(*TODAY, 0.0, -0.5, 0.001)
    t0 = np.array([-0.5, -0.487, -0.431, -0.2222, -0.2222, -0.0303])
    state = orbit.at(t0)
    rng = np.random.default_rng(4)
    q = state.q + rng.normal(0, 2.0, (3, 6))
    v = state.v + rng.normal(0, 10.0, (3, 6))
    end = reference.advance(HOST, q, v, t0, 0.0, SATELLITE, (*TODAY, 0.0))
    return orbit, q, v, t0, end


def release(integrator, debris):
    """Advance the debris to today in blocks, each particle from the block in which it is released."""
    orbit, q, v, t0, _ = debris
    field = build_field(HOST).with_moving(build_field(SATELLITE), orbit)
    q, v, now = q.copy(), v.copy(), t0.copy()
    for end in np.linspace(-0.5, 0.0, 26)[1:]:
        out = int((t0 < end).sum())
        x, u = q[:, :out].copy(), v[:, :out].copy()
        integrator.advance(field, x, u, now[:out], end)
        q[:, :out], v[:, :out], now[:out] = x, u, end
    return q, v


@pytest.mark.parametrize(("cls", "error"), [(Leapfrog, 5e-3), (ForestRuth, 5e-3), (Adaptive, 2e-4), (Reference, 1e-6)])
def test_debris_of_a_moving_progenitor(cls, error, debris):
    """Largest position error in kpc at the default settings."""
    q, v = release(cls(), debris)
    assert np.linalg.norm(q - debris[-1][0], axis=0).max() < error
    assert np.linalg.norm(v - debris[-1][1], axis=0).max() < 100 * error


@pytest.mark.slow
@pytest.mark.parametrize("n", [20, 64])
def test_a_close_passage_is_foreseen_on_a_curved_path(n):
    """Particles that the host's tide bends past the progenitor at 1 kpc: none arrives with too few steps.

    On straight lines a tenth of them would seem to pass further out, and be off by more than 1e-4 kpc.
    """
    field = build_field(HOST)
    orbit = field.orbit(*TODAY, 0.0, 0.06, 0.001)
    end = 0.05 * GYR
    middle = np.full(n, end / 2)
    rng = np.random.default_rng(8)
    towards, any_way = rng.standard_normal((2, 3, n))
    aside = np.cross(towards, any_way, axis=0)
    state = orbit.at(middle)
    q = state.q + 1.0 * towards / np.linalg.norm(towards, axis=0)
    v = state.v + 100.0 * aside / np.linalg.norm(aside, axis=0)
    passage = (*TODAY, 0.0)
    begun = reference.advance(HOST, q, v, middle, 0.0, SATELLITE, passage)
    wanted = reference.advance(HOST, q, v, middle, end, SATELLITE, passage)
    field = field.with_moving(build_field(SATELLITE), orbit)
    q, v = march(Adaptive(eta_progenitor=0.25), field, *begun, 0.0, end, block=end)
    assert np.linalg.norm(q - wanted[0], axis=0).max() < 3e-6


@pytest.mark.parametrize("cls", [Leapfrog, ForestRuth, Adaptive])
def test_a_particle_does_not_know_of_the_others(cls):
    """Bit for bit: alone, in a small crowd or in several batches, among particles with other steps."""
    field = build_field(HOST)
    orbit = field.orbit(*TODAY, 0.0, 0.1, 0.001)
    field = field.with_moving(build_field(SATELLITE), orbit)
    rng = np.random.default_rng(6)
    spread = np.geomspace(0.05, 60.0, 400)
    q = TODAY[0][:, None] + spread * rng.standard_normal((3, 400))
    v = TODAY[1][:, None] + 20.0 * rng.standard_normal((3, 400))
    together = np.concatenate(march(cls(), field, q, v, 0.0, 0.04))
    for some in ([3], [399], list(range(1, 400, 17))):
        alone = np.concatenate(march(cls(), field, q[:, some], v[:, some], 0.0, 0.04))
        assert np.array_equal(alone, together[:, some])


class Gap(Potential):
    """A flat rotation curve without a force in a shell."""

    kind = "gap"

    @staticmethod
    def acceleration(x, y, z, t):
        r2 = x * x + y * y + z * z
        k = np.where((r2 > 20.0**2) & (r2 < 22.0**2), np.nan, -(220.0**2) / r2)
        return k * x, k * y, k * z


@pytest.mark.parametrize("cls", DEFAULTS)
@pytest.mark.parametrize("radius", [15.0, 21.0])
def test_a_particle_without_a_force_is_nan_soon(cls, radius):
    """Outwards at 300 km/s the particle passes 20 kpc after 17 Myr. SciPy's steps from a NaN have no end."""
    q, v = np.array([[radius], [0.0], [0.0]]), np.array([[300.0], [0.0], [0.0]])
    end = call_with_timeout(60.0, march, cls(), build_field([Gap()]), q, v, 0.0, 0.1 * GYR)
    assert not isinstance(end, str), NO_ANSWER
    assert np.isnan(end).any(axis=1).all()


def test_the_oracle_follows_keplers_ellipse():
    q, v = reference.advance([Kepler(mass=MASS)], *kepler(0.0), np.zeros(1), 0.37 * PERIOD)
    wanted = kepler(0.37 * PERIOD)
    assert np.allclose(q, wanted[0], atol=1e-8)
    assert np.allclose(v, wanted[1], atol=1e-7)


def test_the_satellite_alone_holds_a_particle_on_a_circle():
    """A progenitor at rest in a host without weight: one period of a circle in its Plummer sphere."""
    host = [Plummer(mass=1.0, radius=1e3)]
    r = 1.0
    speed = np.sqrt(G * 6.4e8 * r**2 / (r**2 + 0.85**2) ** 1.5)
    period = 2 * np.pi * r / speed
    times = np.linspace(-period, 0.0, 50)
    still = np.zeros((3, 50))
    orbit = Orbit(times, still, still, still, np.full(50, np.nan))
    field = build_field(host).with_moving(build_field(SATELLITE), orbit)
    q0, v0 = (r * X)[:, None], (speed * Y)[:, None]
    q, v = march(Reference(), field, q0, v0, -period, 0.0)
    assert np.allclose(q, q0, atol=1e-6)
    assert np.allclose(v, v0, atol=1e-5)
