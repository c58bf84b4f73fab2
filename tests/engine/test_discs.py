"""Thin discs: their height, and steps that are short enough where a particle crosses them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from streamkit.builtin.potentials.closed_forms import NFW, Hernquist, Kepler, MiyamotoNagai
from streamkit.builtin.potentials.halos import NFWTriaxial
from streamkit.engine import RKN4, adaptive_step, build_field, with_disc
from streamkit.engine.discs import RADII, disc_heights

A, B = 3.0, 0.28
DISC = MiyamotoNagai(mass=6.8e10, a=A, b=B)
HALO = NFW(mass=5e11, rs=16.0)
ETA = np.array([0.4, 0.45])
SPAN = 0.05


def test_a_sphere_has_no_disc_and_steps_as_before():
    for sphere in (HALO, Hernquist(mass=1e10, a=0.6), Kepler(mass=1e11), NFWTriaxial(mass=5e11, rs=16, q=0.8)):
        assert len(disc_heights(build_field([sphere]))) == 0
    field = build_field([HALO])
    assert with_disc(field) is field


def test_the_height_is_where_the_pull_over_z_has_fallen_to_half():
    def pull(z, r):
        s = np.hypot(z, B)
        return (A + s) / ((r * r + (A + s) ** 2) ** 1.5 * s)

    result = disc_heights(build_field([DISC]))
    for height, r in zip(result[2:], RADII[2:], strict=True):
        half = brentq(lambda z: pull(z, r) - 0.5 * pull(0.0, r), 1e-6, r)  # noqa: B023  called at once
        assert 0.5 * half < height <= half


def crossing(n, seed=1):
    """Positions and velocities of particles that cross the plane at 4 to 16 kpc within SPAN."""
    rng = np.random.default_rng(seed)
    r, at = rng.uniform(4, 16, n), rng.uniform(0, SPAN, n)
    v = np.stack([rng.uniform(-100, 100, n), rng.uniform(50, 220, n), rng.uniform(60, 250, n)])
    q = np.stack([r, np.zeros(n), np.zeros(n)]) - v * at
    return q, v


def exact(field, q, v):
    def slope(t, state):
        state = state.reshape(6, -1)
        return np.concatenate([state[3:], field.acceleration(t, state[:3])]).ravel()

    end = solve_ivp(slope, (0, SPAN), np.concatenate([q, v]).ravel(), method="DOP853", rtol=1e-11, atol=1e-9).y[:, -1]
    return end.reshape(6, -1)


@pytest.mark.parametrize("others", [[], [HALO, Hernquist(mass=5e9, a=1.0)]])
def test_a_disc_is_crossed_in_steps_that_see_it(others):
    """SciPy's DOP853 on the same particles; without the disc's height the steps pass over it."""
    field = with_disc(build_field([DISC, *others]))
    q, v = crossing(60)
    expected = exact(field, q, v)
    worst = {}
    for name, each in (("blind", replace(field, heights=np.empty(0))), ("seen", field)):
        x, u = q.copy(), v.copy()
        adaptive_step(each, RKN4, x, u, np.zeros(60), SPAN, ETA, 7)
        worst[name] = np.sqrt(((u - expected[3:]) ** 2).mean(axis=1).sum())
    assert worst["seen"] < 0.005  # km/s
    assert worst["blind"] > 20 * worst["seen"]


def test_far_above_the_disc_nothing_changes():
    field = with_disc(build_field([DISC, HALO]))
    q, v = np.array([[8.0], [0.0], [20.0]]), np.array([[0.0], [150.0], [50.0]])
    ends = []
    for each in (replace(field, heights=np.empty(0)), field):
        x, u = q.copy(), v.copy()
        adaptive_step(each, RKN4, x, u, np.zeros(1), SPAN, ETA, 7)
        ends.append((x, u))
    np.testing.assert_array_equal(ends[0], ends[1])
