"""Threads inside one stream: the same stream bit for bit, from several cores."""

from dataclasses import replace

import numpy as np
import pytest
from runfiles import changed

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import NFW
from streamkit.engine import build_field

ARRAYS = ("q", "v", "t_strip", "winding", "chi", "bound", "dq_galactocentric")


@pytest.mark.parametrize(("kind", "particles"), [("adaptive", 13_001), ("leapfrog", 13_001), ("adaptive", 50_001)])
def test_a_stream_does_not_depend_on_them(kind, particles):
    document = changed("progenitor", "lookback", 0.6)
    document["stripping"] |= {"particles": particles, "sigma": 10.0}
    document["progenitor"]["mass"] = 5e8
    document["integrator"] = {"kind": kind}
    one, three = (sk.Model(document, threads).stream() for threads in (1, 3))
    for name in ARRAYS:
        assert np.array_equal(getattr(one, name), getattr(three, name)), name


def test_few_particles_and_forces_in_python_take_one():
    field = replace(build_field([NFW(mass=5e11, rs=16.0)]), threads=4)
    assert len(field.pieces(4000)) == 1
    assert len(field.pieces(3 * 4096)) == 3
    assert [field.pieces(50_000)[i].stop for i in (0, 3)] == [12_500, 50_000]
    assert [field.pieces(160_000)[i].stop for i in (0, 15)] == [10_000, 160_000]

    class Slow(sk.Potential):
        """A sphere in NumPy."""

        kind = "slow_sphere"
        compiled = False

        @staticmethod
        def acceleration(x, y, z, t):
            return -x, -y, -z

    assert len(replace(build_field([Slow()]), threads=4).pieces(100_000)) == 1
