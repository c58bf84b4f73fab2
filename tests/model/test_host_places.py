"""A host at one place or many, with units or without: Plummer's closed forms, and what is refused."""

from __future__ import annotations

import astropy.units as u
import numpy as np
import pytest

import streamkit as sk
from streamkit import G
from streamkit.builtin.potentials.closed_forms import Plummer

HOST = sk.Host({"sphere": Plummer(mass=3e10, radius=4.0)})


def test_one_radius_or_many_with_units_or_without() -> None:
    inside = 3e10 * 8.0**3 / (8.0**2 + 16) ** 1.5
    for radius in (8, 8.0, 8000 * u.pc, np.array(8.0)):
        assert HOST.mass_inside(radius).shape == ()
        assert HOST.mass_inside(radius) == pytest.approx(inside, rel=1e-9)
    assert HOST.circular_velocity([8] * 2) == pytest.approx(np.sqrt(G * inside / 8), rel=1e-9)
    assert HOST.escape_speed(8) == pytest.approx(np.sqrt(2 * G * 3e10 / np.sqrt(80)), rel=1e-6)
    assert HOST.flattening(5, [3, 9] * u.kpc) == pytest.approx([1, 1], rel=1e-9)


def test_one_position_or_many_with_units_or_without() -> None:
    depth, density = -G * 3e10 / np.sqrt(80), 3e10 / (4 * np.pi / 3 * 64) * 5**-2.5
    for q in ([0, 8, 0], (0, 8000, 0) * u.pc):
        assert HOST.potential(q) == pytest.approx(depth, rel=1e-9)
        assert HOST.density(q) == pytest.approx(density, rel=1e-6)
        np.testing.assert_allclose(HOST.acceleration(q), [0, -G * 3e10 * 8 / 80**1.5, 0], rtol=1e-9)
    assert HOST.acceleration(np.ones((3, 5))).shape == (3, 5)


@pytest.mark.parametrize(
    ("q", "said"),
    [
        (np.ones((1, 3)), r"found \(1, 3\); transposed, \(3, 1\), it is right"),
        (np.ones((3, 2, 2)), r"found \(3, 2, 2\)$"),
        ([1, 2, 3] * u.s, "are lengths, such as 8 kpc: 's' "),
        ("here", "numbers in kpc; found 'here'"),
        (None, "numbers in kpc; found None"),
    ],
)
def test_positions_that_are_none(q: object, said: str) -> None:
    for what in (HOST.acceleration, HOST.potential, HOST.density):
        with pytest.raises(ValueError, match=said):
            what(q)


@pytest.mark.parametrize(("radii", "said"), [([2, -1], "found -1"), (np.ones((1, 3)), "shape"), ("x", "found 'x'")])
def test_radii_that_are_none(radii: object, said: str) -> None:
    for what in (HOST.mass_inside, HOST.circular_velocity, HOST.escape_speed):
        with pytest.raises(ValueError, match=said):
            what(radii)
