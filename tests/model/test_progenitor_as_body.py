"""A progenitor that the host slows down, and that the host moves for: against Kepler, SciPy and a body alike."""

from dataclasses import replace

import numpy as np
import pytest
from runfiles import changed
from scipy.integrate import solve_ivp
from scipy.special import erf

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import NFW, Kepler, Plummer
from streamkit.model import Host, progenitor_track, simulate, standard_normals
from streamkit.runfile import Body
from streamkit.stream import Orbit

HALO = {"halo": NFW(mass=5.4e11, rs=15.62)}
Q, V = np.array([60.0, 0.0, 0.0]), np.array([0.0, 110.0, 40.0])


def inputs_of(potentials, mass=1e10, lookback=2.0, **moving):
    document = changed("potential", {name: {"kind": p.kind, **p.model_dump()} for name, p in potentials.items()})
    place = dict(zip(("x", "y", "z", "vx", "vy", "vz"), [*Q, *V], strict=True))
    document["progenitor"] |= {"mass": mass, "radius": 1.0, "lookback": lookback, **place, **moving}
    document["stripping"] |= {"sigma": 10.0}
    return sk.load(document).bind()


def host_of(inputs):
    return Host(inputs.potentials, inputs.bodies, inputs.companion)


def track_of(inputs):
    return progenitor_track(host_of(inputs), inputs)


def test_nothing_changes_unless_told():
    plain, inputs = inputs_of(HALO), inputs_of(HALO, friction="none", reflex=False)
    assert plain.companion is None
    assert np.array_equal(track_of(plain).q, track_of(inputs).q)
    assert "friction" not in sk.load(changed("seed", 7)).document["progenitor"]


def test_a_moving_host_is_a_two_body_problem():
    """The orbit about the host is that of a test particle in the field of both masses."""
    inputs = inputs_of({"point": Kepler(mass=2e11)}, mass=5e10, reflex=True)
    inputs = replace(inputs, satellite=Plummer(mass=5e10, radius=1e-6))
    both = inputs_of({"point": Kepler(mass=2.5e11)})
    ours, exact = host_of(inputs).paths(-2.0 * sk.GYR).progenitor, track_of(both)
    assert np.abs(ours.q - exact.q).max() < 1e-6 * exact.r.min()


def test_friction_against_scipy():
    """Chandrasekhar's formula with the dispersion of Jeans's equation, ln(d / 2 a)^(1/2) for the logarithm."""
    inputs = inputs_of(HALO, friction="chandrasekhar")
    m, rs, satellite = 5.4e11, 15.62, 1e10
    radii = np.geomspace(5.0, 3e5, 4000)
    density = m / (4 * np.pi * radii * (radii + rs) ** 2)
    inside = m * (np.log1p(radii / rs) - radii / (radii + rs))
    push = density * sk.G * inside / radii**2
    pieces = 0.5 * (push[1:] + push[:-1]) * np.diff(radii)
    dispersion2 = np.append(np.cumsum(pieces[::-1])[::-1], 0.0) / density

    def rate(t, y):
        d, speed = np.linalg.norm(y[:3]), np.linalg.norm(y[3:])
        x = speed / np.sqrt(2 * np.interp(d, radii, dispersion2))
        slower = erf(x) - 2 * x / np.sqrt(np.pi) * np.exp(-x * x)
        rho = m / (4 * np.pi * d * (d + rs) ** 2)
        drag = 4 * np.pi * sk.G**2 * satellite * rho * np.sqrt(max(np.log(d / 2.0), 0.0)) * slower / speed**3
        pull = sk.G * m * (np.log1p(d / rs) - d / (d + rs)) / d**3
        return np.concatenate([y[3:], -pull * y[:3] - drag * y[3:]])

    theirs = solve_ivp(rate, (0.0, -2.0 * sk.GYR), np.concatenate([Q, V]), rtol=1e-9, atol=1e-9).y[:, -1]
    ours = track_of(inputs)
    assert ours.q[:, 0] == pytest.approx(theirs[:3], abs=0.02)
    energy = host_of(inputs).energy(ours.q, ours.v)
    assert (np.diff(energy) < 0).all()
    assert energy[0] - energy[-1] > 1000.0


def test_it_moves_as_a_body_would_and_beside_bodies():
    inputs = inputs_of(HALO, friction="chandrasekhar", reflex=True)
    cloud = Body(Plummer(mass=5e10, radius=5.0), np.array([0.0, -40.0, -25.0]), np.array([-60.0, -220.0, 210.0]))
    alike = Host(HALO, {"cloud": cloud, "copy": inputs.companion}).paths(-sk.GYR)
    ours = Host(HALO, {"cloud": cloud}, inputs.companion).paths(-sk.GYR)
    assert np.array_equal(ours.progenitor.q, alike.bodies["copy"].q)
    assert np.array_equal(ours.centre.q, alike.centre.q)
    assert list(ours.bodies) == ["cloud"]


def test_streams_feel_it():
    still, moved = inputs_of(HALO, mass=3e9), inputs_of(HALO, mass=3e9, friction="chandrasekhar", reflex=True)
    streams = [simulate(s, standard_normals(s.stripping, s.seed)) for s in (still, moved)]
    assert all(isinstance(stream.future, Orbit) for stream in streams)
    assert np.array_equal(streams[1].orbit.q[:, -1], Q)
    assert np.abs(streams[1].q - streams[0].q).max() > 0.5
    distances = np.sqrt(((streams[1].q - Q[:, None]) ** 2).sum(axis=0))
    assert np.median(distances) < 30.0
