"""The compiled engine: the field of several forces, tracks, tidal radii, forces in plain NumPy."""

import pickle
import signal
import sys
from dataclasses import replace

import numpy as np
import pytest
from pydantic import Field

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import Hernquist, Kepler, MiyamotoNagai, Plummer, TruncatedFlat
from streamkit.engine import RKN4, adaptive_step, build_field, split_step
from streamkit.engine.kernels import NumpyKernel
from streamkit.testing import reference
from streamkit.testing.potentials import positions, times

HOST = [
    TruncatedFlat(v0=210.0, rs=12.0, alpha=0.45),
    MiyamotoNagai(mass=3.3e10, a=4.0, b=0.4),
    Hernquist(mass=3e10, a=0.5),
]
Q, V = np.array([16.3, 2.4, -6.2]), np.array([244.0, -21.0, 198.0])


def test_several_potentials_add_up():
    q = positions(1e-1, 3e2, 1000)
    t = times(1000)
    result = build_field(HOST).acceleration(t, q)
    wanted = reference.acceleration(HOST, t, q)
    assert np.allclose(result, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max(axis=0))


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
    both = field.with_moving(build_field([satellite]), orbit)
    t = np.linspace(-0.99, -0.01, 7)
    place = np.empty((3, 7))
    for i, when in enumerate(t):
        place[:, i] = reference.advance(HOST, Q[:, None], V[:, None], np.zeros(1), when)[0][:, 0]
    q = place + np.random.default_rng(2).normal(0, 1.0, (3, 7))
    wanted = reference.acceleration(HOST, t, q) + reference.acceleration([satellite], t, q - place)
    assert np.allclose(both.acceleration(t, q), wanted, rtol=0, atol=1e-6 * np.abs(wanted).max(axis=0))


OTHER = Q[[1, 2, 0]], -V[[1, 2, 0]]  # today's state of a second body, whose orbit is another one


@pytest.mark.parametrize("released", ["together", "one by one"])
def test_steps_foresee_every_moving_body(released):
    """Close passages of the second body: integrated as if the first one, which weighs nothing, were not there."""
    host, satellite = build_field(HOST), build_field([Plummer(mass=6.4e8, radius=0.85)])
    orbit, elsewhere = (host.orbit(*today, 0.0, 0.05, 0.001) for today in ((Q, V), OTHER))
    alone = host.with_moving(satellite, orbit)
    both = host.with_moving(build_field([Plummer(mass=1e-30, radius=1.0)]), elsewhere).with_moving(satellite, orbit)
    rng = np.random.default_rng(5)
    q = Q[:, None] + 0.5 * rng.standard_normal((3, 40))
    v = V[:, None] + 20.0 * rng.standard_normal((3, 40))
    t0 = np.zeros(40) if released == "together" else np.linspace(0.0, 0.01, 40)
    ends = []
    for field in (alone, both):
        ends.append(np.concatenate([q, v]))
        adaptive_step(field, RKN4, ends[-1][:3], ends[-1][3:], t0, 0.04, np.full(2, 0.3), 20)
    assert np.abs(ends[0][:3] - q).max() > 1.0
    assert np.allclose(ends[1], ends[0], rtol=1e-12)


def test_moving_bodies_that_the_loop_could_not_follow_are_refused():
    host, satellite = build_field(HOST), build_field([Plummer(mass=6.4e8, radius=0.85)])
    orbit = host.orbit(Q, V, 0.0, -0.4, 0.002)
    moving = host.with_moving(satellite, orbit)
    with pytest.raises(ValueError, match="one grid of times"):
        moving.with_moving(satellite, host.orbit(*OTHER, 0.0, -0.5, 0.002))
    losing = replace(orbit, mass_left=np.linspace(1.0, 0.5, len(orbit.t)))
    with pytest.raises(ValueError, match="can lose mass"):
        host.with_moving(satellite, losing).with_moving(satellite, losing)
    with pytest.raises(ValueError, match="one grid of times"):
        moving.seen_from(host.orbit(*OTHER, 0.0, -0.5, 0.002))
    with pytest.raises(ValueError, match="move already"):
        host.with_moving(moving, orbit)


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
        result = tidal_radius([Kepler(mass=host)], np.array([r, 0.0, 0.0]), v, m)
        assert result == pytest.approx(wanted, rel=1e-6)
        if tangential == 1.0:
            assert result == pytest.approx(r * np.cbrt(m / (3 * host)), rel=1e-6)


def test_tidal_radius_in_the_tf_host():
    """d2Phi/dr2 = -(v_c^2 / r^2) [1 + alpha r^2 / (rs^2 + r^2)]."""
    q, v = np.array([10.0, -20.0, 20.0]), np.array([100.0, 50.0, -120.0])
    vc2 = 210.0**2 * (1 + 900.0 / 144.0) ** -0.225
    omega = np.linalg.norm(np.cross(q, v)) / 900.0
    curvature = -(vc2 / 900.0) * (1 + 0.45 * 900.0 / (144.0 + 900.0))
    wanted = np.cbrt(sk.G * 6.4e8 / (omega**2 - curvature))
    assert tidal_radius(HOST[:1], q, v, 6.4e8) == pytest.approx(wanted, rel=1e-6)


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


class Recorded(sk.Potential):
    """Known for the last Gyr only, as a potential from snapshots would be."""

    kind = "test_recorded"
    compiled = False
    mass: sk.Mass = Field(default=1e11, description="Mass.")

    @staticmethod
    def acceleration(x, y, z, t, mass):
        if np.min(t) < -sk.GYR * (1 + 1e-9) or np.max(t) > 1e-9:
            raise ValueError("off the record")
        return tuple(-sk.G * mass * np.stack([x, y, z]) / (x**2 + y**2 + z**2) ** 1.5)


def test_an_orbit_asks_for_no_force_beyond_its_time():
    orbit = build_field([Recorded()]).orbit(Q, V, 0.0, -sk.GYR, 0.01 * sk.GYR)
    assert np.isfinite(orbit.q).all()
    assert orbit.t[0] == -sk.GYR


def test_a_numpy_body_gives_the_same_force_and_mixes_with_compiled_ones():
    q, t = positions(1e-1, 3e2, 500), times(500)
    compiled = build_field([*HOST, Plummer(mass=6.4e8, radius=0.85)]).acceleration(t, q)
    mixed = build_field([*HOST, SplineHost()]).acceleration(t, q)
    assert np.allclose(mixed, compiled, rtol=1e-12)


def test_a_numpy_body_can_ride_on_the_progenitor():
    field = build_field(HOST)
    orbit = field.orbit(Q, V, 0.0, -0.5, 0.002)
    q, t = Q[:, None] + positions(0.1, 5.0, 50), np.linspace(-0.5, 0.0, 50)
    one = field.with_moving(build_field([SplineHost()]), orbit)
    other = field.with_moving(build_field([Plummer(mass=6.4e8, radius=0.85)]), orbit)
    assert np.allclose(one.acceleration(t, q), other.acceleration(t, q), rtol=1e-11)


def test_an_error_in_a_numpy_body_names_the_component_and_its_parameters():
    field = build_field([HOST[0], Broken(mass=2e9)])
    inside, outside = np.full((3, 1), 10.0), np.full((3, 1), 200.0)
    with pytest.raises(sk.ComponentError, match=r"test_broken raised ValueError: off the table .*2000000000\.0"):
        field.acceleration(0.0, outside)
    assert np.isfinite(field.acceleration(0.0, inside)).all()


class Stopping(sk.Potential):
    """Is stopped, by ``STOP``, in its tenth call."""

    kind = "test_stopping"
    compiled = False
    mass: sk.Mass = Field(default=1e11, description="Mass.")

    @staticmethod
    def acceleration(x, y, z, t, mass):
        CALLS.append(len(x))
        if len(CALLS) == 10:
            STOP[0]()
        return tuple(-sk.G * mass * np.stack([x, y, z]) / (x**2 + y**2 + z**2) ** 1.5)


CALLS, STOP = [], [lambda: None]


def advanced(field):
    q, v, t0 = positions(5.0, 50.0, 20), np.zeros((3, 20)), np.full(20, -0.2)
    split_step(field, RKN4, q, v, t0, 0.0, 30)
    return q


WAYS = {
    "orbit": lambda field: field.orbit(Q, V, 0.0, -1.0, 0.002),
    "advance": advanced,
    "acceleration": lambda field: [field.acceleration(0.0, positions(5.0, 50.0, 20)) for _ in range(20)],
}


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    ("stop", "wanted"),
    [
        (lambda: signal.raise_signal(signal.SIGINT), KeyboardInterrupt),
        (lambda: sys.exit(3), sk.ComponentError),
        (lambda: 1 / 0, sk.ComponentError),
    ],
)
def test_what_ends_a_numpy_body_ends_the_loop_at_once(monkeypatch, capfd, way, stop, wanted):
    """Ctypes prints what a callback raises and goes on; with Ctrl-C the stream was wrong by up to 55 kpc."""
    monkeypatch.setattr(f"{__name__}.STOP", [stop])
    CALLS.clear()
    with pytest.raises(wanted):
        WAYS[way](build_field([Stopping()]))
    assert len(CALLS) == 10  # the rest of the loop does not call the body
    assert capfd.readouterr().err == ""
    WAYS[way](build_field([Stopping()]))  # and nothing of it is left


@pytest.mark.parametrize("way", WAYS)
def test_a_signal_at_the_threshold_of_a_callback_is_not_lost(monkeypatch, capfd, way):
    """Python answers a signal that came in compiled code at the first instruction of the callback, before its try."""
    calls, call = [], NumpyKernel._call

    def answering(kernel, *arguments):
        calls.append(1)
        if len(calls) == 10:
            raise KeyboardInterrupt
        call(kernel, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(NumpyKernel, "_call", answering)
        field = build_field([Stopping()])
        kernel = NumpyKernel(Stopping())
    forces = field.forces._replace(address=np.array([kernel.address], dtype=np.int64))
    CALLS.clear()
    with pytest.raises(KeyboardInterrupt):
        WAYS[way](replace(field, forces=forces, kernels=(kernel,)))
    assert len(CALLS) <= 10
    assert capfd.readouterr().err == ""


def test_ctrl_c_at_any_moment_ends_an_orbit_through_numpy():
    field, caught = build_field([HOST[0], SplineHost()]), 0
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        for delay in np.linspace(0.01, 0.05, 8):
            try:
                signal.setitimer(signal.ITIMER_REAL, delay)
                field.orbit(Q, V, 0.0, -100.0, 0.001)
            except KeyboardInterrupt:
                caught += 1
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert caught == 8


def test_a_field_stays_in_its_process():
    with pytest.raises(TypeError, match="send the Spec"):
        pickle.dumps(build_field(HOST))
