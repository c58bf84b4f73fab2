"""The compiled engine: elementary functions, the field, kernels and their cache, tracks, tidal radii."""

import importlib.util
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
from numba import njit
from pydantic import Field

import streamkit as sk
from streamkit.builtin.potentials import Hernquist, Kepler, MiyamotoNagai, Plummer, TruncatedFlat
from streamkit.engine import build_field
from streamkit.engine.kernels import content_digest
from streamkit.testing import reference
from streamkit.testing.potentials import positions, times


@njit
def compiled_log(x):
    return sk.log(x)


@njit
def compiled_exp(x):
    return sk.exp(x)


@njit
def compiled_power(x, y):
    return sk.power(x, y)


@njit
def compiled_sqrt(x):
    return sk.sqrt(x)


def apply(function, *columns):
    return np.array([function(*map(float, row)) for row in zip(*columns, strict=True)])


def test_compiled_log_is_numpys():
    step = np.geomspace(1e-15, 0.4, 400)
    near = 1.0 + np.concatenate([-step, step])
    for x in (np.geomspace(1e-300, 1e300, 4000), near):
        assert np.allclose(apply(compiled_log, x), np.log(x), rtol=1e-14, atol=0)


def test_compiled_exp_is_numpys():
    x = np.concatenate([np.linspace(-700, 700, 4001), np.linspace(-1e-3, 1e-3, 101)])
    assert np.allclose(apply(compiled_exp, x), np.exp(x), rtol=1e-14, atol=0)


def test_compiled_power_is_numpys():
    """exp(y ln x) loses |y ln x| units in the last place; the powers in potentials are small."""
    rng = np.random.default_rng(3)
    x, y = 10.0 ** rng.uniform(-6, 6, 2000), rng.uniform(-3, 3, 2000)
    error = np.abs(apply(compiled_power, x, y) / x**y - 1)
    assert (error <= 1e-14 + 3e-16 * np.abs(y * np.log(x))).all()
    assert np.allclose(sk.power(x, y), x**y, rtol=1e-13)


def test_compiled_sqrt_is_numpys():
    x = np.geomspace(1e-300, 1e300, 1000)
    assert np.array_equal(apply(compiled_sqrt, x), np.sqrt(x))


HOST = [
    TruncatedFlat(v0=210.0, rs=12.0, alpha=0.45),
    MiyamotoNagai(mass=3.3e10, a=4.0, b=0.4),
    Hernquist(mass=3e10, a=0.5),
]
Q, V = np.array([16.3, 2.4, -6.2]), np.array([244.0, -21.0, 198.0])


def test_several_potentials_add_up():
    q = positions(1e-1, 3e2, 1000)
    t = times(1000)
    found = build_field(HOST).acceleration(t, q)
    wanted = reference.acceleration(HOST, t, q)
    assert np.allclose(found, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max(axis=0))


def test_the_order_and_number_of_particles_do_not_matter():
    q, t = positions(1e-1, 3e2, 300), times(300)
    whole = build_field(HOST).acceleration(t, q)
    for some in (slice(0, 1), slice(0, 0), slice(250, 127, -1)):
        assert np.array_equal(build_field(HOST).acceleration(t[some], q[:, some]), whole[:, some])


def test_the_satellite_rides_on_the_progenitor():
    """Its force at q and t is the Plummer force at q minus the progenitor's place at t, from the oracle."""
    field = build_field(HOST)
    orbit = field.orbit(Q, V, 0.0, -1.0, 0.002)
    satellite = Plummer(mass=6.4e8, radius=0.85)
    both = field.with_followers(build_field([satellite]), orbit)
    t = np.linspace(-0.99, -0.01, 7)
    place = np.empty((3, 7))
    for i, when in enumerate(t):
        place[:, i] = reference.advance(HOST, Q[:, None], V[:, None], np.zeros(1), when)[0][:, 0]
    q = place + np.random.default_rng(2).normal(0, 1.0, (3, 7))
    wanted = reference.acceleration(HOST, t, q) + reference.acceleration([satellite], t, q - place)
    assert np.allclose(both.acceleration(t, q), wanted, rtol=0, atol=1e-6 * np.abs(wanted).max(axis=0))


def test_track_interpolation():
    """Quintic Hermite between nodes 2 Myr apart: the states are the oracle's to 1e-7 kpc and 1e-5 km/s."""
    orbit = build_field(HOST).orbit(Q, V, 0.0, -1.0, 0.002)
    t = np.array([-0.99913, -0.70001, -0.3337, -0.0501])
    states = orbit.at(t)
    for i, when in enumerate(t):
        q, v = reference.advance(HOST, Q[:, None], V[:, None], np.zeros(1), when)
        assert np.allclose(states.q[:, i], q[:, 0], atol=1e-6)
        assert np.allclose(states.v[:, i], v[:, 0], atol=1e-4)
    nodes = orbit.at(orbit.t)
    assert np.allclose(nodes.q, orbit.q, atol=1e-12)
    assert np.allclose(nodes.a, orbit.a, rtol=1e-9)


def test_interpolation_error_falls_with_the_sixth_power():
    """Every second node left out, twice: the error at the nodes left out grows by 2^6."""
    orbit = build_field([Kepler(mass=1e11)]).orbit(Q, 0.6 * V, 0.0, -0.3, 0.0005)
    errors = []
    for thin in (16, 32):
        coarse = sk.Orbit(*(a[..., ::thin] for a in (orbit.t, orbit.q, orbit.v, orbit.a, orbit.r_tidal)))
        inside = orbit.t <= coarse.t[-1]
        errors.append(np.abs(coarse.at(orbit.t[inside]).q - orbit.q[:, inside]).max())
    assert 40 < errors[1] / errors[0] < 90


@pytest.mark.parametrize("end", [-1.0, 1.0])
def test_orbit_runs_in_either_direction(end):
    orbit = build_field(HOST).orbit(Q, V, 0.0, end, 0.001)
    assert (np.diff(orbit.t) > 0).all()
    here, there = (0, -1) if end > 0 else (-1, 0)
    assert np.allclose(orbit.q[:, here], Q)
    assert np.allclose(orbit.v[:, here], V)
    q, v = reference.advance(HOST, Q[:, None], V[:, None], np.zeros(1), end)
    assert np.allclose(orbit.q[:, there], q[:, 0], atol=1e-6)
    assert np.allclose(orbit.v[:, there], v[:, 0], atol=1e-4)


def test_turning_points_of_a_kepler_orbit():
    """Pericentre passages one period apart, 2 pi sqrt(a^3 / (G M)), apocentres half way between."""
    mass, a, e = 1e11, 20.0, 0.6
    period = 2 * np.pi * np.sqrt(a**3 / (sk.G * mass))
    speed = np.sqrt(sk.G * mass / a * (1 + e) / (1 - e))
    start = np.array([a * (1 - e), 0.0, 0.0]), np.array([0.0, 0.6 * speed, 0.8 * speed])
    orbit = build_field([Kepler(mass=mass)]).orbit(*start, 0.0, -2.7 * period, 0.0005)
    assert np.allclose(orbit.apocentres(), [-2.5 * period, -1.5 * period, -0.5 * period], atol=1e-6 * period)
    pericentres = orbit.pericentres()
    pericentres = pericentres[pericentres < -0.1 * period]  # today's own is on the edge
    assert np.allclose(pericentres, [-2 * period, -period], atol=1e-6 * period)
    assert np.allclose(orbit.at(orbit.apocentres()).r, a * (1 + e), rtol=1e-6)


def tidal_radius(potentials, q, v, mass):
    orbit = build_field(potentials).orbit(q, v, 0.0, -0.001, 0.0005)
    curvature = build_field(potentials).radial_second_derivative(orbit.t, orbit.q)
    return np.cbrt(sk.G * mass / (orbit.omega**2 - curvature))[-1]


def test_tidal_radius_in_a_kepler_host():
    """d2Phi/dr2 = -2 G M / r^3: r_t^3 = m / (L^2 / (G r^4) + 2 M / r^3), and r (m / 3M)^(1/3) on a circle."""
    host, m, r = 1e11, 6.4e8, 20.0
    circular = np.sqrt(sk.G * host / r)
    for tangential in (0.4, 1.0, 1.3):
        v = np.array([50.0, tangential * circular * 0.6, tangential * circular * 0.8])
        momentum = r * tangential * circular
        wanted = np.cbrt(m / (momentum**2 / (sk.G * r**4) + 2 * host / r**3))
        found = tidal_radius([Kepler(mass=host)], np.array([r, 0.0, 0.0]), v, m)
        assert found == pytest.approx(wanted, rel=1e-6)
        if tangential == 1.0:
            assert found == pytest.approx(r * np.cbrt(m / (3 * host)), rel=1e-6)


def test_tidal_radius_in_the_tf_host():
    """d2Phi/dr2 = -(v_c^2 / r^2) [1 + alpha r^2 / (rs^2 + r^2)]."""
    q, v = np.array([10.0, -20.0, 20.0]), np.array([100.0, 50.0, -120.0])
    vc2 = 210.0**2 * (1 + 900.0 / 144.0) ** -0.225
    omega = np.linalg.norm(np.cross(q, v)) / 900.0
    curvature = -(vc2 / 900.0) * (1 + 0.45 * 900.0 / (144.0 + 900.0))
    wanted = np.cbrt(sk.G * 6.4e8 / (omega**2 - curvature))
    assert tidal_radius(HOST[:1], q, v, 6.4e8) == pytest.approx(wanted, rel=1e-6)


CONSTANT = """
from numba import njit
from pydantic import Field
from streamkit import G, Mass, Potential

SCALE = {scale}

@njit
def helper(r2):
    return SCALE * G / r2

class Point(Potential):
    \"\"\"A point of adjustable strength.\"\"\"

    kind = "point"
    mass: Mass = Field(default=1e11, description="Mass.")

    @staticmethod
    def acceleration(x, y, z, t, mass):
        \"\"\"Return the acceleration.\"\"\"
        r2 = x * x + y * y + z * z
        k = -{inline} * helper(r2) * mass / r2**0.5
        return k * x, k * y, k * z
"""
PROBE = """
import ctypes
import numpy as np
import point
from streamkit.engine.kernels import compiled_kernel, content_digest
kernel = compiled_kernel(point.Point)
arrays = [np.array(a) for a in ([0.0], [1e11], [3.0, 4.0, 0.0], [0.0, 0.0, 0.0])]
kernel.ctypes(1, *(a.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for a in arrays))
print(content_digest(point.Point.acceleration, 1), arrays[3][0].hex(), kernel.cache_hits)
"""


def probe(folder):
    """Digest, acceleration along x, and whether the machine code came from the disk, in a fresh process."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", PROBE], env=environment, capture_output=True, text=True, cwd=folder
    )
    assert done.returncode == 0, done.stderr
    digest, value, hits = done.stdout.split()
    return digest, float.fromhex(value), int(hits)


def test_kernels_are_cached_by_content(tmp_path):
    """The same text gives the same machine code from the disk; a changed constant elsewhere does not."""
    file = tmp_path / "point.py"
    expected = -sk.G * 1e11 * 3.0 / 125.0
    file.write_text(CONSTANT.format(scale=1.0, inline=1.0))
    digest, value, hits = probe(tmp_path)
    assert value == pytest.approx(expected, rel=1e-12)
    assert hits == 0
    assert probe(tmp_path) == (digest, value, 1)
    file.write_text(CONSTANT.format(scale=2.0, inline=1.0))
    other, value, hits = probe(tmp_path)
    assert value == pytest.approx(2 * expected, rel=1e-12)
    assert hits == 0
    assert other != digest


def digest_of(file, text):
    """Digest of the class Point in a file with this text."""
    file.write_text(text)
    spec = importlib.util.spec_from_file_location(file.stem, file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return content_digest(module.Point.acceleration, 1)


def test_the_digest_follows_the_content_and_not_the_place(tmp_path):
    text = CONSTANT.format(scale=1.0, inline=1.0)
    same = {digest_of(tmp_path / "one.py", text), digest_of(tmp_path / "two.py", "\n\n# moved\n" + text)}
    assert len(same) == 1
    changes = (
        CONSTANT.format(scale=2.0, inline=1.0),
        CONSTANT.format(scale=1.0, inline=2.0),
        text.replace("r2**0.5", "r2**0.75"),
        text.replace("x * x + y * y", "x * x - y * y"),
        text.replace("helper(r2)", "helper(mass)"),
    )
    others = {digest_of(tmp_path / f"change{i}.py", change) for i, change in enumerate(changes)}
    assert len(others) == len(changes)
    assert None not in others
    assert not same & others


def test_what_cannot_be_described_is_not_cached():
    table = [1.0, 2.0]
    assert content_digest(lambda x: table[0] * x, 0) is None


class SplineHost(sk.Potential):
    """A Plummer sphere as a NumPy-only body."""

    kind = "test_numpy_plummer"
    compiled = False
    mass: sk.Mass = Field(default=6.4e8, description="Mass.")
    radius: sk.Length = Field(default=0.85, description="Radius.")

    @staticmethod
    def acceleration(x, y, z, t, mass, radius):
        where = np.stack([x, y, z])
        return tuple(-sk.G * mass * where / (np.sum(where**2, axis=0) + radius**2) ** 1.5)


class Broken(sk.Potential):
    """Raises beyond 100 kpc."""

    kind = "test_broken"
    compiled = False
    mass: sk.Mass = Field(default=1e9, description="Mass.")

    @staticmethod
    def acceleration(x, y, z, t, mass):
        if np.max(np.abs(x)) > 100:
            raise ValueError("off the table")
        return -x, -y, -z


def test_a_numpy_body_gives_the_same_force_and_mixes_with_compiled_ones():
    q, t = positions(1e-1, 3e2, 500), times(500)
    compiled = build_field([*HOST, Plummer(mass=6.4e8, radius=0.85)]).acceleration(t, q)
    mixed = build_field([*HOST, SplineHost()]).acceleration(t, q)
    assert np.allclose(mixed, compiled, rtol=1e-12)


def test_a_numpy_body_can_ride_on_the_progenitor():
    field = build_field(HOST)
    orbit = field.orbit(Q, V, 0.0, -0.5, 0.002)
    q, t = Q[:, None] + positions(0.1, 5.0, 50), np.linspace(-0.5, 0.0, 50)
    one = field.with_followers(build_field([SplineHost()]), orbit)
    other = field.with_followers(build_field([Plummer(mass=6.4e8, radius=0.85)]), orbit)
    assert np.allclose(one.acceleration(t, q), other.acceleration(t, q), rtol=1e-11)


def test_an_error_in_a_numpy_body_names_the_component_and_its_parameters():
    field = build_field([HOST[0], Broken(mass=2e9)])
    inside, outside = np.full((3, 1), 10.0), np.full((3, 1), 200.0)
    with pytest.raises(
        sk.ComponentError, match=r"test_broken raised ValueError: off the table .*2000000000\.0"
    ):
        field.acceleration(0.0, outside)
    assert np.isfinite(field.acceleration(0.0, inside)).all()


def test_an_error_during_an_orbit_surfaces():
    with pytest.raises(sk.ComponentError, match="off the table"):
        build_field([Broken()]).orbit(np.array([99.0, 0, 0]), np.array([900.0, 0, 0]), 0.0, 1.0, 0.01)


def test_a_field_stays_in_its_process():
    with pytest.raises(TypeError, match="send the Spec"):
        pickle.dumps(build_field(HOST))
