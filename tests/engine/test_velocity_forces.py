"""Forces that depend on velocity, in every loop: against closed forms and SciPy.

The loops are compiled a second time for them, which takes a minute in a new clone. The slow tests need these loops; the
others take the accelerations of given particles, as SciPy's integrator does.
"""

import itertools
from typing import Annotated, Any, ClassVar

import numpy as np
import pytest
from pydantic import Field
from runfiles import BASE
from scipy.integrate import solve_ivp
from scipy.special import erf

import streamkit as sk
from streamkit.builtin.integrators.adaptive import Adaptive
from streamkit.builtin.integrators.fixed_step import ForestRuth, Leapfrog
from streamkit.builtin.integrators.reference import Reference
from streamkit.builtin.potentials.closed_forms import Hernquist, Kepler
from streamkit.engine import NO_FRICTION, RKN4, Centre, build_field, follow_bodies, split_step
from streamkit.testing.potentials import drag_is_a_drag
from streamkit.units import Unit

OMEGA, RATE = 8.0, 3.0
Q = np.array([[12.0, -4.0, 7.0], [3.0, 16.0, -9.0], [5.0, 1.0, 2.0]])
V = np.array([[30.0, 110.0, -60.0], [140.0, -40.0, 80.0], [-70.0, 60.0, 90.0]])
PerTime = Annotated[float, Unit("km / s / kpc"), Field(ge=0)]


class Sticky(sk.Potential):
    """A harmonic well with linear drag."""

    kind = "test_sticky"
    example: ClassVar[dict[str, Any]] = {"omega": OMEGA, "rate": RATE}
    omega: PerTime = Field(description="Frequency.")
    rate: PerTime = Field(description="Drag over velocity.")

    @staticmethod
    def acceleration(x, y, z, t, omega, rate):
        k = -omega * omega
        return k * x, k * y, k * z

    @staticmethod
    def drag(x, y, z, vx, vy, vz, t, omega, rate):
        return -rate * vx, -rate * vy, -rate * vz


class NumpySticky(sk.Potential):
    """The same through NumPy."""

    kind = "test_numpy_sticky"
    compiled = False
    omega: PerTime = Field(description="Frequency.")
    rate: PerTime = Field(description="Drag over velocity.")

    acceleration, drag = staticmethod(Sticky.acceleration), staticmethod(Sticky.drag)


def damped(q: Any, v: Any, t: float, rate: float = RATE) -> tuple[Any, Any]:
    """x'' = -omega^2 x - rate x', in closed form."""
    half, w = rate / 2, np.sqrt(OMEGA**2 - rate**2 / 4)
    c, s, e = np.cos(w * t), np.sin(w * t), np.exp(-half * t)
    return (
        e * (q * c + (v + half * q) / w * s),
        e * (v * c - (OMEGA**2 * q + half * v) / w * s),
    )


def march(integrator: Any, field: Any, q: Any, v: Any, t1: float, blocks: int = 20) -> tuple[Any, Any]:
    q, v = q.copy(), v.copy()
    edges = np.linspace(0.0, t1, blocks + 1)
    for begin, end in itertools.pairwise(edges):
        integrator.advance(field, q, v, np.full(q.shape[1], begin), end)
    return q, v


ACCURACY = {
    "adaptive": (Adaptive(), 1e-5),
    "pefrl": (Adaptive(method="pefrl", eta=0.2), 1e-4),
    "fixed": (ForestRuth(step=0.002), 1e-6),
    "leapfrog": (Leapfrog(step=0.001), 1e-3),
    "dop853": (Reference(), 1e-8),
}


@pytest.mark.parametrize(
    "which", [pytest.param(which, marks=() if which == "dop853" else pytest.mark.slow) for which in ACCURACY]
)
@pytest.mark.parametrize("kind", [Sticky, NumpySticky])
def test_a_damped_oscillator_is_its_closed_form(which: str, kind: Any) -> None:
    integrator, accuracy = ACCURACY[which]
    host = kind(omega=OMEGA, rate=RATE) if kind is Sticky else kind(omega=OMEGA, rate=RATE, expansion="none")
    q, v = march(integrator, build_field([host]), Q, V, 0.8)
    wanted = damped(Q, V, 0.8)
    assert np.abs(q - wanted[0]).max() < accuracy * 20
    assert np.abs(v - wanted[1]).max() < accuracy * 160


@pytest.mark.slow
def test_the_order_of_a_splitting_stays() -> None:
    errors = []
    for steps in (20, 40):
        q, v = Q.copy(), V.copy()
        split_step(build_field([Sticky(omega=OMEGA, rate=RATE)]), RKN4, q, v, np.zeros(3), 0.8, steps)
        errors.append(np.abs(q - damped(Q, V, 0.8)[0]).max())
    assert 13 < errors[0] / errors[1] < 19


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Sticky, NumpySticky])
def test_an_orbit_back_and_its_accelerations(kind: Any) -> None:
    host = kind(omega=OMEGA, rate=RATE) if kind is Sticky else kind(omega=OMEGA, rate=RATE, expansion="none")
    orbit = build_field([host]).orbit(Q[:, 0], V[:, 0], 0.0, -0.8, 0.002)
    q, v = damped(Q[:, 0], V[:, 0], -0.8)
    assert np.allclose(orbit.q[:, 0], q, rtol=1e-7)
    assert np.allclose(orbit.v[:, 0], v, rtol=1e-7)
    assert np.allclose(orbit.a, -(OMEGA**2) * orbit.q - RATE * orbit.v, rtol=1e-9)


def test_the_acceleration_without_velocities_is_gravity_alone() -> None:
    field = build_field([Sticky(omega=OMEGA, rate=RATE)])
    assert np.allclose(field.acceleration(0.0, Q), -(OMEGA**2) * Q, rtol=1e-14)
    assert np.allclose(field.acceleration(0.0, Q, V), -(OMEGA**2) * Q - RATE * V, rtol=1e-14)


@pytest.mark.parametrize("numpy_too", [False, True])
def test_drags_add_up_and_grow(numpy_too: bool) -> None:
    """Two of them, one growing from nothing at t = -1: at -0.5 it has half its size."""
    growth = {"t": [-1 / sk.GYR, 0], "factor": [0, 1]}
    other = NumpySticky(omega=OMEGA, rate=1.0, expansion="none") if numpy_too else Sticky(omega=OMEGA, rate=1.0)
    field = build_field([other, Hernquist(mass=1e-20, a=1.0), Sticky(omega=0.0, rate=RATE, growth=growth)])
    result = field.acceleration(np.full(3, -0.5), Q, V)
    assert np.allclose(result, -(OMEGA**2) * Q - (1.0 + 0.5 * RATE) * V, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("numpy_too", [False, True])
def test_drags_add_up_in_a_loop(numpy_too: bool) -> None:
    other = NumpySticky(omega=OMEGA, rate=1.0, expansion="none") if numpy_too else Sticky(omega=OMEGA, rate=1.0)
    many = build_field([other, Sticky(omega=0.0, rate=RATE - 1.0)])
    q, _ = march(ForestRuth(step=0.002), many, Q, V, 0.4)
    assert np.allclose(q, damped(Q, V, 0.4)[0], rtol=1e-6)


class Chandrasekhar(sk.Potential):
    """A singular isothermal sphere that slows every particle down as if it had a mass."""

    kind = "test_chandrasekhar"
    example: ClassVar[dict[str, Any]] = {"sigma": 140.0, "mass_slowed": 2e9}
    sigma: sk.Speed = Field(description="Dispersion.")
    mass_slowed: sk.Mass = Field(description="Mass that is slowed down.")

    @staticmethod
    def acceleration(x, y, z, t, sigma, mass_slowed):
        k = -2 * sigma * sigma / (x * x + y * y + z * z)
        return k * x, k * y, k * z

    @staticmethod
    def drag(x, y, z, vx, vy, vz, t, sigma, mass_slowed):
        density = sigma * sigma / (2 * np.pi * sk.G * (x * x + y * y + z * z))
        speed = np.sqrt(vx * vx + vy * vy + vz * vz + 1e-12)
        s = speed / (1.4142135623730951 * sigma)
        # erf by Abramowitz & Stegun 7.1.26, to 1.5e-7
        u = 1 / (1 + 0.3275911 * s)
        tail = u * (0.254829592 + u * (-0.284496736 + u * (1.421413741 + u * (-1.453152027 + u * 1.061405429))))
        e = sk.exp(-s * s)
        slower = 1 - tail * e - 1.1283791670955126 * s * e
        k = -4 * np.pi * sk.G * sk.G * mass_slowed * density * 3.0 * slower / (speed * speed * speed)
        return k * vx, k * vy, k * vz


def slowed(t: float, w: Any) -> Any:
    """The same with SciPy's erf; ln Lambda = 3."""
    q, v = w[:3], w[3:]
    r2, speed = q @ q, np.sqrt(v @ v)
    s = speed / (np.sqrt(2) * 140.0)
    density = 140.0**2 / (2 * np.pi * sk.G * r2)
    part = erf(s) - 2 * s / np.sqrt(np.pi) * np.exp(-(s**2))
    return np.concatenate([v, -2 * 140.0**2 * q / r2 - 4 * np.pi * sk.G**2 * 2e9 * density * 3.0 * part / speed**3 * v])


@pytest.mark.slow
def test_chandrasekhars_drag_is_that_of_scipy() -> None:
    q, v = np.array([40.0, 0.0, 10.0]), np.array([20.0, 160.0, 30.0])
    field = build_field([Chandrasekhar(**Chandrasekhar.example)])
    wanted = solve_ivp(slowed, (0, -2.0), np.concatenate([q, v]), method="DOP853", rtol=1e-11, atol=1e-10).y[:, -1]
    back = field.orbit(q, v, 0.0, -2.0, 0.002)
    assert np.allclose(back.q[:, 0], wanted[:3], rtol=0, atol=2e-4)
    again = march(Adaptive(), field, back.q[:, :1].copy(), back.v[:, :1].copy(), 2.0, 40)
    assert np.allclose(again[0][:, 0], q, rtol=0, atol=2e-3)
    assert np.abs(back.q[:, 0] - build_field([NoDrag()]).orbit(q, v, 0.0, -2.0, 0.002).q[:, 0]).max() > 1


class NoDrag(sk.Potential):
    """The isothermal sphere alone."""

    kind = "test_no_drag"

    @staticmethod
    def acceleration(x, y, z, t):
        k = -2 * 140.0**2 / (x * x + y * y + z * z)
        return k * x, k * y, k * z


@pytest.mark.slow
def test_the_hosts_drag_acts_on_bodies_and_not_on_itself() -> None:
    """Host and body against SciPy: the body is slowed down by its velocity from the host."""
    mass = 5e10
    host, body = Sticky(omega=OMEGA, rate=RATE), Centre(Kepler(mass=mass), Q[:, 0], V[:, 0])
    centre, (orbit,) = follow_bodies([host], [body], NO_FRICTION, -0.3, 0.002)

    def rates(t: float, w: Any) -> Any:
        x0, x1, v0, v1 = w.reshape(4, 3)
        d = x1 - x0
        return np.concatenate([v0, v1, sk.G * mass * d / (d @ d) ** 1.5, -(OMEGA**2) * d - RATE * (v1 - v0)])

    start = np.concatenate([np.zeros(3), Q[:, 0], np.zeros(3), V[:, 0]])
    x0, x1, *_ = solve_ivp(rates, (0, -0.3), start, method="DOP853", rtol=1e-11, atol=1e-11).y[:, -1].reshape(4, 3)
    assert np.allclose(centre.q[:, 0], x0, rtol=0, atol=1e-5)
    assert np.allclose(orbit.q[:, 0], x1 - x0, rtol=0, atol=1e-5)
    with pytest.raises(ValueError, match="may not depend on velocity"):
        follow_bodies([NoDrag()], [Centre(host, Q[:, 0], V[:, 0])], NO_FRICTION, -0.3, 0.002)
    with pytest.raises(ValueError, match="may not depend on velocity"):
        build_field([NoDrag()]).with_moving(build_field([host]), orbit)


def test_a_drag_with_other_arguments_or_that_raises_is_refused() -> None:
    with pytest.raises(sk.PluginError, match=r"drag: the arguments must be \(x, y, z, vx, vy, vz, t, rate\)"):

        class Wrong(sk.Potential):
            kind = "test_wrong_drag"
            rate: PerTime = Field(description="Rate.")

            @staticmethod
            def acceleration(x, y, z, t, rate):
                return x, y, z

            @staticmethod
            def drag(x, y, z, t, vx, vy, vz, rate):
                return vx, vy, vz

    with pytest.raises(sk.PluginError, match="drag: compiled code cannot raise"):

        class Raises(sk.Potential):
            kind = "test_raising_drag"

            @staticmethod
            def acceleration(x, y, z, t):
                return x, y, z

            @staticmethod
            def drag(x, y, z, vx, vy, vz, t):
                raise ValueError(x)


class Constant(sk.Potential):
    """A drag that is none."""

    kind = "test_constant_drag"
    example: ClassVar[dict[str, Any]] = {"mass": 1e11}
    mass: sk.Mass = Field(description="Mass.")

    @staticmethod
    def acceleration(x, y, z, t, mass):
        k = -sk.G * mass / (x * x + y * y + z * z + 1.0) ** 1.5
        return k * x, k * y, k * z

    @staticmethod
    def drag(x, y, z, vx, vy, vz, t, mass):
        return x, y, z


def test_the_conformance_kit_looks_at_a_drag() -> None:
    drag_is_a_drag(Sticky(**Sticky.example))
    drag_is_a_drag(Chandrasekhar(**Chandrasekhar.example))
    with pytest.raises(AssertionError, match="does not depend on the velocity"):
        drag_is_a_drag(Constant(**Constant.example))


class Deaf(sk.Integrator):
    """Knows no forces that depend on velocity."""

    kind = "test_deaf"
    order = 2

    def advance(self, field, q, v, t0, t1):
        q += v * (t1 - t0)


def test_a_run_file_may_not_combine_a_drag_with_what_does_not_know_it() -> None:
    host = {"potential": {"kind": "test_sticky", "omega": OMEGA, "rate": RATE}}
    deaf = {"integrator": {"kind": "test_deaf"}}
    sentence = (
        r"integrator: 'test_deaf' does not support forces that depend on velocity, and potential \('test_sticky'\) has "
        "one; these support it: adaptive, dop853, leapfrog, pefrl"
    )
    with pytest.raises(sk.SpecError, match=sentence):
        sk.load(BASE | host | deaf, components=[Sticky, Deaf])
    body = {"kind": "test_constant_drag", "mass": 1e10, "x": 30, "y": 1, "z": 2, "vx": 1, "vy": 2, "vz": 3}
    with pytest.raises(sk.SpecError, match=r"body.a.kind: 'test_constant_drag' has a force that depends on velocity"):
        sk.load(BASE | {"body": {"a": body}}, components=[Constant])


@pytest.mark.slow
def test_the_progenitor_of_a_run_feels_it() -> None:
    host = {"potential": {"kind": "test_chandrasekhar", "sigma": 140, "mass_slowed": 2e9}}
    short = {"progenitor": BASE["progenitor"] | {"lookback": 1.0}}
    stream = sk.Model(sk.load(BASE | host | short, components=[Chandrasekhar])).stream()
    track = stream.orbit
    start = np.concatenate([track.q[:, -1], track.v[:, -1]])
    wanted = solve_ivp(slowed, (0, track.t[0]), start, method="DOP853", rtol=1e-11, atol=1e-10).y[:, -1]
    assert np.allclose(track.q[:, 0], wanted[:3], rtol=0, atol=1e-3)
    assert np.isfinite(stream.q).all()
