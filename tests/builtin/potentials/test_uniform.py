"""A host in a frame that accelerates: the orbit is that of the frame at rest, minus the motion of its origin."""

import numpy as np
import pytest
from runfiles import FIT

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import Plummer
from streamkit.engine import build_field
from streamkit.model import Host

HOST = {"kind": "plummer", "mass": 5e11, "radius": 10.0}


def spec_with(**fields):
    potential = {"halo": HOST, "frame": {"kind": "uniform_acceleration", **fields}}
    return sk.load(FIT | {"potential": potential, "sampler": {}})


def test_a_free_particle_falls_as_in_a_lift():
    """Constant, and growing with time: x = a t^2 / 2, and b t^3 / 6."""
    q, v = np.zeros(3), np.zeros(3)
    spec = spec_with(ax=-80.0, az={"times": [-4, 0], "values": [-4 * 20.0 * sk.GYR, 0.0]})
    frame = spec.host()["frame"]
    orbit = build_field([frame]).orbit(q, v, 0.0, -3.0, 0.01)
    np.testing.assert_allclose(orbit.q[0], -40.0 * orbit.t**2, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(orbit.q[2], 20.0 * orbit.t**3 / 6, rtol=1e-9, atol=1e-9)
    assert not orbit.q[1].any()


def test_in_a_falling_frame_an_orbit_is_that_beside_a_fixed_host_that_moves():
    """The host moves with x = a t^2 / 2 in the frame at rest; there the orbit about it is found by itself."""
    from scipy.integrate import solve_ivp

    a, halo = np.array([60.0, -30.0, 45.0]), Plummer(mass=5e11, radius=10.0)
    state = np.array([15.0, 2.0, 6.0, -30.0, 120.0, 60.0])

    def at_rest(t, y):
        return [*y[3:], *build_field([halo]).acceleration(0.0, (y[:3] - 0.5 * a * t**2)[:, None])[:, 0]]

    exact = solve_ivp(at_rest, (0.0, -2.0), state, rtol=1e-10, atol=1e-10).y[:3, -1] - 0.5 * a * 2.0**2
    potentials = spec_with(ax=-a[0], ay=-a[1], az=-a[2]).host()
    orbit = build_field(list(potentials.values())).orbit(state[:3], state[3:], 0.0, -2.0, 0.002)
    assert np.abs(orbit.q[:, 0] - exact).max() < 1e-5


def test_energies_and_escape_speeds_are_not_told():
    host = Host(spec_with(ax=50.0).host())
    q, v = np.array([8.0, 0.0, 0.0]), np.array([0.0, 220.0, 0.0])
    assert host.energy(q[:, None], v[:, None]) is None
    assert host.escape_speed(np.array([8.0])) is None
    assert host.unbinds(q, v) is None
    alone = Host({"halo": Plummer(mass=5e11, radius=10.0)})
    assert host.circular_velocity(np.array([8.0])) == pytest.approx(alone.circular_velocity(np.array([8.0])))
