"""Orbits in forces that are called through Python: as exact as compiled ones, with few calls."""

import numpy as np
import pytest
from pydantic import Field

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import NFW
from streamkit.engine import build_field

HALO = NFW(mass=3.6e11, rs=9.4)
CALLS = []


class Counted(sk.Potential):
    """The halo in NumPy, which counts its calls."""

    kind = "counted"
    compiled = False
    edge: sk.Length = Field(default=1e3, description="No force beyond.")

    @staticmethod
    def acceleration(x, y, z, t, edge):
        CALLS.append(len(x))
        a = NFW.acceleration(x, y, z, t, HALO.mass, HALO.rs)
        return tuple(np.where(x * x + y * y + z * z < edge**2, k, np.nan) for k in a)


START = np.array([70.0, 0.0, 0.0]), np.array([0.0, 60.0, 20.0])


@pytest.mark.parametrize("end", [-4.0, 2.0])
def test_an_orbit_is_that_of_the_compiled_force(end):
    CALLS.clear()
    result = build_field([Counted()]).orbit(*START, 0.0, end, 0.002)
    exact = build_field([HALO]).orbit(*START, 0.0, end, 0.0005)
    assert len(result.t) == len(exact.t[::4])
    for name, limit in (("q", 1e-5), ("v", 1e-4), ("a", 2e-3)):
        assert np.abs(getattr(result, name) - getattr(exact, name)[:, ::4]).max() < limit
    assert np.array_equal(result.t, np.sort(result.t))
    single = sum(n == 1 for n in CALLS)
    assert single < 600 * abs(end)  # three for each of the nodes, 500 a unit of time, would be 1500


def test_an_orbit_that_leaves_the_force_is_not_finite_from_there():
    orbit = build_field([Counted(edge=72.0)]).orbit(START[0], np.array([60.0, 60.0, 0.0]), 0.0, 1.0, 0.002)
    assert np.isfinite(orbit.q[:, 0]).all()
    assert np.isnan(orbit.q[:, -1]).all()
