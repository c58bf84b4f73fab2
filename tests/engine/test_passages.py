"""Steps near a body that flies past particles faster than its dynamical time."""

import numpy as np
import pytest

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import Plummer
from streamkit.engine import RKN4, adaptive_step, build_field
from streamkit.stream import Orbit

MASS, RADIUS, SPEED, END = 1e6, 0.01, 150.0, 0.05


def field_of(size, start=-3.0):
    """A Plummer sphere that moves along x, alone."""
    t = np.linspace(-0.001, END + 0.001, 60)
    q, v = np.zeros((3, 60)), np.zeros((3, 60))
    q[0], v[0] = start + SPEED * t, SPEED
    orbit = Orbit(t, q, v, np.zeros((3, 60)), np.full(60, np.nan))
    body = build_field([Plummer(mass=MASS, radius=RADIUS)])
    return build_field([]).with_passing([(body, orbit, size)]) if size else build_field([]).with_moving(body, orbit)


def kicks(size, distances, start=-3.0, deepest=7):
    n = len(distances)
    q, v = np.zeros((3, n)), np.zeros((3, n))
    q[1] = distances
    q[0] = np.linspace(-0.2, 0.2, n)
    adaptive_step(field_of(size, start), RKN4, q, v, np.zeros(n), END, np.array([0.4, 0.45]), deepest)
    return v


@pytest.mark.parametrize("start", [-3.0, -3.77, -4.2])
def test_one_block_holds_a_passage_and_the_kick_is_that_of_the_impulse_approximation(start):
    distances = np.array([0.015, 0.02, 0.03, 0.05, 0.1, 0.2, 0.3])
    expected = -2 * sk.G * MASS * distances / (SPEED * (distances**2 + RADIUS**2))
    assert kicks(RADIUS, distances, start)[1] == pytest.approx(expected, rel=0.02)
    without = kicks(0.0, distances, start)[1]
    assert np.abs(without / expected - 1).max() > 0.2  # dynamical times alone do not show the passage
