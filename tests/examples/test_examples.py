"""The other example plugins of the manual, against closed forms; tests/contract checks that each of them conforms."""

import sys
from pathlib import Path

import numpy as np
import pytest

import streamkit as sk

sys.path.insert(0, str(Path(__file__).parent))

from remainder import Remainder
from tabulated import Tabulated
from vertical_force import VerticalForce

sys.path.pop(0)


class PointMass:
    """A host of one solar-mass point, 1e11 of them: what `HostView` promises, in closed form."""

    def acceleration(self, q):
        return -sk.G * 1e11 * q / (q**2).sum(axis=0) ** 1.5

    def mass_inside(self, radii):
        return np.full(len(radii), 1e11)


def test_the_tabulated_host_has_the_circular_velocities_of_its_table():
    host = Tabulated()
    a_x, _, _ = host.acceleration(host.r, 0.0, 0.0, 0.0, *host.in_engine_units())
    assert np.sqrt(-a_x * host.r) == pytest.approx(host.v_c, rel=1e-4)


def test_the_remainder_and_the_rest_of_the_host_have_the_curve():
    r, v_c = np.array([5.0, 20.0, 100.0]), np.array([320.0, 300.0, 200.0])
    prepared = Remainder.prepare(r, v_c, PointMass())
    a_x, _, _ = Remainder.acceleration(r, 0.0, 0.0, 0.0, **prepared)
    assert -a_x * r + sk.G * 1e11 / r == pytest.approx(v_c**2, rel=1e-5)  # 65 nodes


def test_the_remainder_refuses_a_host_that_is_too_heavy():
    with pytest.raises(sk.OutOfDomain, match="more mass"):
        Remainder.prepare(np.array([1.0, 100.0]), np.array([100.0, 100.0]), PointMass())


def test_the_vertical_force_of_a_point_mass():
    """|a_z| = G M z / r^3, so the surface density is M z / (2 pi r^3): 1e6 pc2 in a kpc2."""
    data = VerticalForce(surface_density=(71.0, 6.0), radius=8.0, z=1.1)
    expected = 1e11 * 1.1 / (2 * np.pi * (64 + 1.21) ** 1.5) / 1e6
    assert data.predict(PointMass()).mean == pytest.approx([expected], rel=1e-12)
