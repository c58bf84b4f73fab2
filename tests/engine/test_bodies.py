"""Centres that move in each other's field, friction, and fields seen from one of them."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import Field
from scipy.integrate import solve_ivp
from scipy.special import erf

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import Hernquist, Kepler, Plummer
from streamkit.engine import NO_FRICTION, Centre, Friction, build_field, follow_bodies

Q, V = np.array([30.0, 5.0, -10.0]), np.array([40.0, 190.0, 60.0])
STEP = 0.002 * sk.GYR


class NumpyPlummer(sk.Potential):
    """A Plummer sphere through NumPy."""

    kind = "test_numpy_body"
    compiled = False
    mass: sk.Mass = Field(description="Mass.")
    radius: sk.Length = Field(description="Radius.")

    @staticmethod
    def acceleration(x, y, z, t, mass, radius):
        return tuple(-sk.G * mass * np.stack([x, y, z]) / (x**2 + y**2 + z**2 + radius**2) ** 1.5)


def plummer_pull(mass, radius, d):
    return -sk.G * mass * d / (d @ d + radius**2) ** 1.5


@pytest.mark.parametrize("end", [-2.0, 1.0])
@pytest.mark.parametrize("pulls", [True, False])
def test_three_centres_are_those_of_scipy(end, pulls):
    """Host, a heavy body and a light one that may be held from pulling the host: 18 equations by DOP853."""
    masses, radii = (5e11, 1e11, 2e10), (10.0, 5.0, 2.0)
    starts = [(np.zeros(3), np.zeros(3)), (Q, V), (-1.5 * Q, np.array([80.0, -90.0, 120.0]))]
    bodies = [
        Centre(Plummer(mass=m, radius=r), *start, pulls_host=both)
        for m, r, start, both in zip(masses[1:], radii[1:], starts[1:], (True, pulls), strict=True)
    ]
    host, orbits = follow_bodies([Plummer(mass=masses[0], radius=radii[0])], bodies, NO_FRICTION, end * sk.GYR, STEP)

    def rates(t, w):
        x, v = w.reshape(2, 3, 3)
        a = np.zeros((3, 3))
        for i in range(3):
            for k in range(3):
                if i != k and (i > 0 or k < 2 or pulls):
                    a[i] += plummer_pull(masses[k], radii[k], x[i] - x[k])
        return np.concatenate([v, a]).ravel()

    begin = np.array(starts).transpose(1, 0, 2).ravel()
    done = solve_ivp(rates, (0.0, end * sk.GYR), begin, method="DOP853", rtol=1e-11, atol=1e-11)
    x, v = done.y[:, -1].reshape(2, 3, 3)
    last = 0 if end < 0 else -1
    assert host.t[last] == end * sk.GYR
    assert np.allclose(host.q[:, last], x[0], atol=1e-6)
    assert np.allclose(host.v[:, last], v[0], atol=1e-5)
    for orbit, x_k, v_k in zip(orbits, x[1:], v[1:], strict=True):
        assert np.allclose(orbit.q[:, last], x_k - x[0], atol=1e-6)
        assert np.allclose(orbit.v[:, last], v_k - v[0], atol=1e-5)


def test_two_point_masses_move_on_keplers_ellipse():
    """Equal masses: the relative orbit is that of their sum, and each has half of it about the common centre."""
    mass, a, e = 1e11, 40.0, 0.5
    period = 2 * np.pi * np.sqrt(a**3 / (sk.G * 2 * mass))
    speed = np.sqrt(sk.G * 2 * mass / a * (1 + e) / (1 - e))
    body = Centre(Kepler(mass=mass), np.array([a * (1 - e), 0.0, 0.0]), np.array([0.0, speed, 0.0]))
    host, (orbit,) = follow_bodies([Kepler(mass=mass)], [body], NO_FRICTION, -2.2 * period, STEP)
    assert np.allclose(orbit.apocentres(), [-1.5 * period, -0.5 * period], atol=1e-7 * period)
    assert np.allclose(orbit.at(orbit.apocentres()).q[0], -a * (1 + e), rtol=1e-6)
    assert np.allclose(host.q + 0.5 * orbit.q, body.q[:, None] / 2 + 0.5 * body.v[:, None] * host.t, atol=1e-6)


def test_the_error_falls_with_the_fourth_power_of_the_step():
    """Far out, where no step is divided."""
    body = Centre(Hernquist(mass=1e11, a=10.0), 6 * Q, V)
    ends = []
    for step in (8, 4, 1):
        _, (orbit,) = follow_bodies([Plummer(mass=1e12, radius=20.0)], [body], NO_FRICTION, -0.8 * sk.GYR, step * STEP)
        ends.append(orbit.q[:, 0])
    errors = [np.abs(end - ends[-1]).max() for end in ends[:2]]
    assert errors[0] < 1e-4
    assert 14 < errors[0] / errors[1] < 19


@pytest.mark.parametrize(("mass", "extent"), [(1e11, 3.0), (1e9, 0.0)])
def test_friction_is_chandrasekhars(mass, extent):
    """In an isothermal sphere, rho = s^2 / (2 pi G r^2); b is twice the length, or G M / v^2 of a point mass."""
    sigma = 120.0
    table = np.zeros((60, 8))
    table[:, 0], table[:, 4] = sigma**2 / (2 * np.pi * sk.G), sigma**2
    friction = Friction(table[None], np.log(0.1), 0.1, np.zeros(1))
    host = Kepler(mass=3e11)
    body = Centre(Plummer(mass=mass, radius=1.0), Q, V, pulls_host=False, slowed_mass=mass, extent=extent)
    for end in (-1.0, 0.3):
        centre, (orbit,) = follow_bodies([host], [body], friction, end * sk.GYR, STEP)

        def rates(t, w):
            x, v = w[:3], w[3:]
            d, speed = np.sqrt(x @ x), np.sqrt(v @ v)
            coulomb = np.sqrt(max(np.log(d / (2 * extent if extent else sk.G * mass / speed**2)), 0.0))
            big = speed / (np.sqrt(2) * sigma)
            part = erf(big) - 2 * big / np.sqrt(np.pi) * np.exp(-(big**2))
            slow = 4 * np.pi * sk.G**2 * mass * sigma**2 / (2 * np.pi * sk.G * d**2) * coulomb * part / speed**3
            return np.concatenate([v, -sk.G * host.mass * x / d**3 - slow * v])

        done = solve_ivp(rates, (0, end * sk.GYR), np.concatenate([Q, V]), method="DOP853", rtol=1e-11, atol=1e-11)
        last = 0 if end < 0 else -1
        assert np.allclose(orbit.q[:, last], done.y[:3, -1], atol=2e-6)
        assert (centre.q == 0).all()


def test_a_body_at_rest_feels_no_friction():
    table = np.ones((4, 8))
    body = Centre(Plummer(mass=1e9, radius=1.0), Q, np.zeros(3), pulls_host=False, slowed_mass=1e9, extent=0.5)
    _, (with_drag,) = follow_bodies(
        [Kepler(mass=1e-9)], [body], Friction(table[None], 0.0, 1.0, np.zeros(1)), -1e-3, STEP
    )
    assert np.isfinite(with_drag.q).all()
    assert np.allclose(with_drag.a, 0.0, atol=1e-3)


def test_bodies_through_numpy_move_as_compiled_ones():
    args = {"mass": 1e11, "radius": 8.0}
    host, same = Plummer(mass=5e11, radius=10.0), NumpyPlummer(mass=5e11, radius=10.0)
    orbits = [
        follow_bodies([h], [Centre(kind(**args), Q, V)], NO_FRICTION, -0.2 * sk.GYR, STEP)[1][0]
        for h, kind in ((host, Plummer), (same, NumpyPlummer))
    ]
    assert np.allclose(orbits[0].q, orbits[1].q, rtol=1e-11)


def test_the_frame_of_a_centre_is_accelerated():
    """A particle in the field seen from the host is the one in the inertial frame, less the host's orbit."""
    host, body = Plummer(mass=5e11, radius=10.0), Plummer(mass=1e11, radius=5.0)
    end = -1.0 * sk.GYR
    centre, (orbit,) = follow_bodies([host], [Centre(body, Q, V)], NO_FRICTION, end, STEP)
    field = build_field([host]).with_moving(build_field([body]), orbit).seen_from(centre)
    q, v = np.array([-40.0, 16.0, 6.0]), np.array([30.0, -150.0, 60.0])
    result = field.orbit(q, v, 0.0, end, STEP)

    def rates(t, w):
        x0, x1, x, v0, v1, v = w.reshape(6, 3)
        a0, a1 = plummer_pull(1e11, 5.0, x0 - x1), plummer_pull(5e11, 10.0, x1 - x0)
        a = plummer_pull(5e11, 10.0, x - x0) + plummer_pull(1e11, 5.0, x - x1)
        return np.concatenate([v0, v1, v, a0, a1, a])

    begin = np.concatenate([np.zeros(3), Q, q, np.zeros(3), V, v])
    done = solve_ivp(rates, (0, end), begin, method="DOP853", rtol=1e-12, atol=1e-12)
    x0, _, x, v0, _, v_end = done.y[:, -1].reshape(6, 3)
    assert np.allclose(result.q[:, 0], x - x0, rtol=0, atol=1e-6)
    assert np.allclose(result.v[:, 0], v_end - v0, rtol=0, atol=1e-5)
    t = np.linspace(end, 0.0, 37)
    pulled = np.array([plummer_pull(1e11, 5.0, -x_k) for x_k in orbit.at(t).q.T]).T
    still = build_field([host]).with_moving(build_field([body]), orbit)
    outcome = still.acceleration(t, q[:, None] + 0 * pulled) - field.acceleration(t, q[:, None] + 0 * pulled)
    assert np.allclose(outcome, pulled, rtol=0, atol=1e-6 * np.abs(pulled).max())
    each = np.stack([field.acceleration(when, q[:, None])[:, 0] for when in t], axis=1)
    assert np.allclose(field.acceleration(t, q[:, None] + 0 * pulled), each, rtol=1e-14)


def test_what_loses_mass_may_be_added_last():
    """The loop wants it first: the same field in either order."""
    host, sinking, other = (
        build_field([p]) for p in (Kepler(mass=1e11), Plummer(mass=1e9, radius=1.0), Kepler(mass=1e10))
    )
    orbit = host.orbit(Q, V, 0.0, -0.4 * sk.GYR, STEP)
    losing = replace(orbit, mass_left=np.linspace(1.0, 0.3, len(orbit.t)))
    elsewhere = host.orbit(-Q, V, 0.0, -0.4 * sk.GYR, STEP)
    q, t = np.random.default_rng(1).normal(0, 30.0, (3, 50)), np.linspace(-0.4 * sk.GYR, 0.0, 50)
    one = host.with_moving(sinking, losing).with_moving(other, elsewhere).seen_from(elsewhere)
    two = host.with_moving(other, elsewhere).seen_from(elsewhere).with_moving(sinking, losing)
    assert np.allclose(one.acceleration(t, q), two.acceleration(t, q), rtol=1e-12)
