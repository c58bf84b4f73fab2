"""The states of an orbit between its nodes."""

import numpy as np

from streamkit.stream import Orbit


def test_the_states_of_many_times_are_those_of_the_formula():
    """Positions of degree 5 in time: the Hermite polynomials of position, velocity and acceleration are exact."""
    powers = np.arange(6)
    c = np.array([[3.0, -1, 0.5, 0.2, -0.1, 0.03], [0.0, 2, 0, 0, 0.3, 0.01], [1.0, 0, -0.4, 0.1, 0, 0]])

    def states(t):
        q = c @ t**powers[:, None]
        v = (c[:, 1:] * powers[1:]) @ t ** powers[:5, None]
        return q, v, (c[:, 2:] * powers[2:] * powers[1:5]) @ t ** powers[:4, None]

    nodes = np.linspace(-2, 0, 9)
    orbit = Orbit(nodes, *states(nodes), r_tidal=2 + nodes, mass_left=1 - 0.1 * nodes)
    times = np.sort(np.random.default_rng(5).uniform(-2, 0, 10_001))  # more than are computed together
    found = orbit.at(times)
    for one, expected in zip((found.q, found.v, found.a), states(times), strict=True):
        np.testing.assert_allclose(one, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.r_tidal, 2 + times, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.mass_left, 1 - 0.1 * times, rtol=0, atol=1e-14)
    assert orbit.at(times[:0]).q.shape == (3, 0)
