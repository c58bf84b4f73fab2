"""Potentials along turned axes: against closed forms that are turned by hand, in every way a force is computed."""

from typing import Any

import numpy as np
import pytest
from pydantic import Field
from runfiles import BASE
from turned_halos import Foreign, axes, logarithmic

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import NFW
from streamkit.builtin.potentials.halos import LogarithmicHalo, NFWTriaxial
from streamkit.components import Total
from streamkit.engine import NO_FRICTION, Centre, MovingForce, build_field, follow_bodies
from streamkit.model import Host

RNG = np.random.default_rng(38)
Q = RNG.normal(size=(3, 500)) * np.geomspace(0.5, 150, 500)
ANGLES = [25.0, 40.0, -70.0]
HALO: dict[str, Any] = {"mass": 8e11, "rs": 16.0, "p": 0.85, "q": 0.75}


TURN = axes(*ANGLES)


@pytest.mark.parametrize(
    ("halo", "limit"),
    [
        (LogarithmicHalo(v0=220, p=0.85, q=0.75, orientation=ANGLES), 1e-12),
        (Foreign(v0=220, orientation=ANGLES, expansion="none"), 1e-12),
        pytest.param(Foreign(v0=220, orientation=ANGLES, tolerance=1e-5), 1e-5, marks=pytest.mark.slow),
    ],
    ids=["compiled", "NumPy", "expansion"],
)
def test_a_turned_halo_is_the_closed_form_along_its_axes(halo: Any, limit: float) -> None:
    wanted = TURN.T @ logarithmic(TURN @ Q)
    size = np.sqrt((wanted**2).sum(axis=0))
    assert (np.abs(build_field([halo]).acceleration(0.0, Q) - wanted).max(axis=0) < limit * size).all()
    assert (np.abs(Total((halo,)).acceleration(Q) - wanted).max(axis=0) < 1e-12 * size).all()


def test_an_expansion_is_made_along_the_axes_of_the_potential() -> None:
    """Turned, it stays a halo with three planes of symmetry, which needs no sines and no odd harmonics."""
    straight, turned = (Foreign(v0=220, tolerance=1e-2, **turn).expanded() for turn in ({}, {"orientation": ANGLES}))
    assert straight
    assert turned
    assert turned.grid == straight.grid
    assert turned.error == straight.error


def test_simple_turns_are_other_fields_of_the_same_halo() -> None:
    """About z: the field `phi`. About x by 90 deg: the axes y and z are exchanged, here to the other closed form."""
    about_z, about_x = (NFWTriaxial(**HALO, orientation=turn) for turn in ([30, 0, 0], [0, 90, 0]))
    exchanged = HALO | {"p": HALO["q"], "q": HALO["p"]}
    for turned, same in ((about_z, NFWTriaxial(**HALO, phi=30)), (about_x, NFWTriaxial(**exchanged))):
        assert Total((turned,)).acceleration(Q) == pytest.approx(Total((same,)).acceleration(Q), rel=1e-9)
        assert Total((turned,)).potential(Q) == pytest.approx(Total((same,)).potential(Q), rel=1e-12)


def test_what_does_not_depend_on_the_axes_stays() -> None:
    straight, turned = (Total((NFWTriaxial(**HALO, **turn),)) for turn in ({}, {"orientation": ANGLES}))
    radii = np.array([5.0, 20.0, 80.0])
    assert turned.mass_inside(radii) == pytest.approx(straight.mass_inside(radii), rel=1e-4)
    assert turned.density(TURN.T @ Q) == pytest.approx(straight.density(Q), rel=1e-5, abs=1.0)


def test_an_orbit_is_the_turned_orbit_and_keeps_its_energy() -> None:
    q, v = np.array([22.0, 3.0, -8.0]), np.array([-40.0, 90.0, 160.0])
    straight = build_field([NFWTriaxial(**HALO)]).orbit(TURN @ q, TURN @ v, 0.0, -4.0, 1e-3)
    host = Host({"halo": NFWTriaxial(**HALO, orientation=ANGLES)})
    orbit = host.alone.orbit(q, v, 0.0, -4.0, 1e-3)
    assert TURN @ orbit.q == pytest.approx(straight.q, abs=1e-8)
    energy = host.energy(orbit.q, orbit.v)
    assert energy is not None
    assert np.ptp(energy) < 1e-7 * np.abs(energy).max()
    momentum = np.cross(orbit.q, orbit.v, axis=0)
    assert np.ptp(momentum, axis=1).min() > 100  # kpc km/s: no component is kept


def test_a_turned_halo_may_grow() -> None:
    growth = {"t": [-2, 0], "factor": [0.5, 1]}
    halo = LogarithmicHalo(v0=220, p=0.85, q=0.75, orientation=ANGLES, growth=growth)
    times = np.linspace(-3, 0, Q.shape[1])
    wanted = np.interp(times / sk.GYR, [-2, 0], [0.5, 1]) * (TURN.T @ logarithmic(TURN @ Q))
    assert build_field([halo]).acceleration(times, Q) == pytest.approx(wanted, rel=1e-9)


class Wind(sk.Potential):
    """A halo with a drag that is not the same along all axes, and depends on the place."""

    kind = "test_wind"
    v0: sk.Speed = Field(default=1.0, description="Speed.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, v0: Any) -> Any:
        k = -v0 * v0 / (x * x + y * y + z * z)
        return k * x, k * y, k * z

    @staticmethod
    def drag(x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any, t: Any, v0: Any) -> Any:
        return -3.0 * vx, -2.0 * vy * y * y, -1.0 * vz


class NumpyWind(sk.Potential):
    """The same through NumPy."""

    kind = "test_numpy_wind"
    compiled = False
    v0: sk.Speed = Field(default=1.0, description="Speed.")
    acceleration, drag = staticmethod(Wind.acceleration), staticmethod(Wind.drag)


@pytest.mark.parametrize("cls", [Wind, NumpyWind])
def test_a_drag_turns_with_its_axes(cls: Any) -> None:
    v = RNG.normal(size=Q.shape)
    q = Q[:, :100]
    v = v[:, :100]
    field = build_field([cls(orientation=ANGLES)])
    y, (vx, vy, vz) = (TURN @ q)[1], TURN @ v
    wanted = TURN.T @ np.stack([-3 * vx, -2 * vy * y * y, -vz])
    assert field.acceleration(0.0, q, v) - field.acceleration(0.0, q) == pytest.approx(wanted, rel=1e-7, abs=1e-9)


def test_a_body_has_axes_too() -> None:
    """The pull of a turned body on the centre of the host, and on particles beside it."""
    body = LogarithmicHalo(v0=100, p=0.85, q=0.75, orientation=ANGLES)
    place = np.array([30.0, 10.0, -20.0])
    centre, (orbit,) = follow_bodies(
        [NFW(mass=1e12, rs=16)], [Centre(body, place, np.zeros(3), True, 0.0, 0.0)], NO_FRICTION, -0.1, 0.002
    )
    pull = TURN.T @ logarithmic(TURN @ -place[:, None], 100.0)
    assert centre.a[:, -1] == pytest.approx(pull[:, 0], rel=1e-9)
    force = MovingForce(build_field([]), orbit)
    q, v = Q[:, :8].copy(), np.zeros((3, 8))
    force.advance(body, q, v, -1e-5, 0.0, 1, 1)
    again = v.copy()
    assert v / 1e-5 == pytest.approx(TURN.T @ logarithmic(TURN @ (Q[:, :8] - place[:, None]), 100.0), rel=1e-3)
    other = LogarithmicHalo(v0=100, p=0.85, q=0.75, orientation=[0, 0, 0])  # of the same class, with other numbers
    q, v = Q[:, :8].copy(), np.zeros((3, 8))
    force.advance(other, q, v, -1e-5, 0.0, 1, 1)
    assert v / 1e-5 == pytest.approx(logarithmic(Q[:, :8] - place[:, None], 100.0), rel=1e-3)
    assert np.abs(v - again).max() > 1e-4


def loaded(kind: str = "nfw_triaxial", **halo: Any) -> sk.Spec:
    return sk.load(BASE | {"potential": {"kind": kind, "mass": 8e11, "rs": 16} | halo})


def test_angles_are_free_in_a_run_file() -> None:
    spec = loaded(orientation=["0.5 rad", {"uniform": ["0 deg", "90 deg"]}, 0])
    assert "potential.orientation.1" in spec.names
    values = {"potential.orientation.1": 30.0}
    halo = spec.bind_all(values).potentials["potential"]
    assert halo.orientation == pytest.approx([np.degrees(0.5), 30, 0])
    again = sk.load(spec.document)
    assert again.document == spec.document
    assert "orientation" not in loaded().document["potential"]
    assert again.digest() == spec.digest() != loaded().digest()


@pytest.mark.parametrize(
    ("halo", "said"),
    [
        ({"orientation": [30, 40]}, r"potential\.orientation: .*found 2 angle\(s\), expected three"),
        ({"orientation": "30 deg"}, r"potential\.orientation: "),
        ({"orientation": ["30 kpc", 0, 0]}, r"potential\.orientation: .*kpc"),
        ({"orientatoin": [1, 2, 3]}, "Did you mean 'orientation'"),
        ({"kind": "nfw", "orientation": [1, 2, 3]}, "nfw is a sphere, which has no orientation"),
    ],
)
def test_bad_angles_are_told(halo: Any, said: str) -> None:
    with pytest.raises(sk.SpecError, match=said):
        loaded(**halo)


def test_a_plugin_may_not_use_the_name() -> None:
    fields = {"__annotations__": {"orientation": sk.Number}, "orientation": 1.0, "kind": "x", "__module__": __name__}
    with pytest.raises(sk.PluginError, match="the field 'orientation' belongs to every potential"):
        type(sk.Potential)("X", (sk.Potential,), fields | {"acceleration": staticmethod(min)})
