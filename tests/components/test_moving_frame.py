"""Potentials with a frame of their own in time: against closed forms, in every way a force is computed."""

import tomllib
from typing import Any, ClassVar

import numpy as np
import pytest
from pydantic import Field
from runfiles import BASE
from turned_halos import Foreign, axes, logarithmic

import streamkit as sk
from streamkit.builtin.potentials.bar import Bar
from streamkit.builtin.potentials.closed_forms import NFW, Hernquist
from streamkit.builtin.potentials.halos import LogarithmicHalo, NFWTriaxial
from streamkit.builtin.potentials.uniform import UniformAcceleration
from streamkit.components import along_axes
from streamkit.engine import PEFRL, build_field, split_step
from streamkit.fields import InTime
from streamkit.model import Host

RNG = np.random.default_rng(39)
N = 200
Q = RNG.normal(size=(3, N))
Q *= np.geomspace(10, 100, N) / np.sqrt((Q**2).sum(axis=0))
T = RNG.uniform(-4, 0, N) * sk.GYR
TRIAXIAL: dict[str, Any] = {"mass": 8e11, "rs": 16.0, "p": 0.85, "q": 0.75}
GRAVITY = np.array([30.0, -50.0, 20.0])  # km^2 / (kpc s^2): what moves the centre
START, SPEED = np.array([22.0, 3.0, -8.0]), np.array([-40.0, 90.0, 160.0])
STEADY = (-7.0, 0.0)  # Gyr: through two knots the angle is linear


def falling(times: Any) -> dict[str, list[float]]:
    """The table of a centre that falls, at rest at the origin today: ``GRAVITY t^2 / 2``."""
    t = np.asarray(times, dtype=float) * sk.GYR
    return {"t": list(times), **{name: list(0.5 * g * t**2) for name, g in zip("xyz", GRAVITY, strict=True)}}


MOVING: dict[str, Any] = {"orientation": [20.0, 40.0, 0.0], "centre": falling([-5, -3, -1, 0])}
TURNING = {"orientation.0": InTime(STEADY, (300.0, 20.0)), "orientation.2": InTime(STEADY, (-700.0, 0.0))}


def wanted(q: Any, t: Any) -> Any:
    """Its force: the axes precess and turn, the centre falls."""
    angles = np.array([20 - 40 * t / sk.GYR, np.full(len(t), 40.0), 100 * t / sk.GYR])
    turn = axes(*angles)
    along = np.einsum("nij,jn->in", turn, q - 0.5 * GRAVITY[:, None] * t**2)
    return np.einsum("nij,in->jn", turn, logarithmic(along))


@pytest.mark.parametrize(
    ("halo", "limit"),
    [
        (LogarithmicHalo(v0=220, p=0.85, q=0.75, **MOVING), 1e-11),
        (Foreign(v0=220, **MOVING, expansion="none"), 1e-11),
        pytest.param(Foreign(v0=220, **MOVING, tolerance=1e-5), 1e-5, marks=pytest.mark.slow),
    ],
    ids=["compiled", "NumPy", "expansion"],
)
def test_a_moving_halo_is_the_closed_form_in_its_frame(halo: Any, limit: float) -> None:
    halo = halo.changing(TURNING)
    for times in (T, np.full(N, -2.3 * sk.GYR)):  # each particle has its time, or all have one
        exact = wanted(Q, times)
        size = np.sqrt((exact**2).sum(axis=0))
        assert (np.abs(build_field([halo]).acceleration(times, Q) - exact).max(axis=0) < limit * size).all()
        assert (np.abs(along_axes("acceleration", halo, Q, times) - exact).max(axis=0) < 1e-11 * size).all()


def test_a_sphere_moves_too_and_grows_on_its_way() -> None:
    growth = {"t": [-4, 0], "factor": [0.2, 1]}
    still = build_field([NFW(mass=8e11, rs=16.0)])
    moving = build_field([NFW(mass=8e11, rs=16.0, centre=falling([-4, -2, 0]), growth=growth)])
    exact = (1 + 0.2 * T / sk.GYR) * still.acceleration(0.0, Q - 0.5 * GRAVITY[:, None] * T**2)
    np.testing.assert_allclose(moving.acceleration(T, Q), exact, rtol=1e-9)


def test_a_single_row_is_a_place_at_rest() -> None:
    there = NFWTriaxial(**TRIAXIAL, centre={"t": [0], "x": [3], "y": [-2], "z": [1]})
    assert not there.drifts
    exact = build_field([NFWTriaxial(**TRIAXIAL)]).acceleration(0.0, Q - np.array([[3.0], [-2.0], [1.0]]))
    np.testing.assert_allclose(build_field([there]).acceleration(T, Q), exact, rtol=1e-12)
    np.testing.assert_allclose(Host({"halo": there}).total.acceleration(Q), exact, rtol=1e-12)


def test_galileo_a_host_that_moves_evenly_is_one_at_rest() -> None:
    """Seen from the centre the orbits are the same; two rows are a straight line at all times, velocities or not."""
    drift = np.array([90.0, -60.0, 30.0])  # km/s
    still = build_field([NFWTriaxial(**TRIAXIAL)]).orbit(START, SPEED, 0.0, -3.0 * sk.GYR, 1e-3)
    rows = {"t": [-1, 0], **{n: [-v * sk.GYR, 0] for n, v in zip("xyz", drift, strict=True)}}
    faster = rows | {f"v{n}": [v, v] for n, v in zip("xyz", drift, strict=True)}
    for table in (rows, faster):
        moving = build_field([NFWTriaxial(**TRIAXIAL, centre=table)])
        orbit = moving.orbit(START, SPEED + drift, 0.0, -3.0 * sk.GYR, 1e-3)
        np.testing.assert_allclose(orbit.q - drift[:, None] * orbit.t, still.q, atol=1e-8)
        np.testing.assert_allclose(orbit.v - drift[:, None], still.v, atol=1e-6)


def test_a_host_and_all_in_it_that_fall_together_are_one_at_rest() -> None:
    """Einstein's lift: a centre on a constant acceleration, and the same uniform acceleration of the particles."""
    times = np.full(N, -3.0 * sk.GYR)
    v = 150.0 * np.cross(Q, [0.3, 0.5, 0.8], axis=0) / np.sqrt((Q**2).sum(axis=0))
    lift = UniformAcceleration(ax=GRAVITY[0], ay=GRAVITY[1], az=GRAVITY[2])
    falls = build_field([NFWTriaxial(**TRIAXIAL, centre=falling([-4, -2.5, -1, 0])), lift])
    rests, ends = build_field([NFWTriaxial(**TRIAXIAL)]), []
    for field, shift in ((rests, np.zeros((3, 1))), (falls, GRAVITY[:, None])):
        q, u = Q + 0.5 * shift * times**2, v + shift * times
        split_step(field, PEFRL, q, u, times, 0.0, 4096)
        ends.append(np.concatenate([q, u]))
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-5)  # kpc, km/s
    assert np.abs(GRAVITY * (3 * sk.GYR) ** 2).max() > 400  # kpc: it falls far


def test_a_turning_halo_keeps_the_jacobi_energy() -> None:
    """E - Omega L_z, with Omega about the halo's own z axis, and not the energy (Binney & Tremaine 2008, 3.112)."""
    pattern = 30.0  # deg/Gyr
    halo = NFWTriaxial(**TRIAXIAL, orientation=[0, 0, 0])
    turning = halo.changing({"orientation.2": InTime(STEADY, (7 * -pattern, 0.0))})
    orbit = build_field([turning]).orbit(START, SPEED, 0.0, -4.0 * sk.GYR, 1e-3)
    energy = 0.5 * (orbit.v**2).sum(axis=0) + along_axes("potential", turning, orbit.q, orbit.t)
    momentum = orbit.q[0] * orbit.v[1] - orbit.q[1] * orbit.v[0]
    jacobi = energy - np.radians(pattern) / sk.GYR * momentum
    assert np.ptp(jacobi) < 1e-7 * np.abs(jacobi).max()
    assert np.ptp(energy) > 1e-3 * np.abs(energy).max()


def test_a_bar_that_is_turned_is_the_bar_with_a_pattern_speed() -> None:
    bar: dict[str, Any] = {"mass": 1e10, "a": 3.5, "b": 0.5, "c": 0.6, "angle": -27.0}
    speed = -39.0  # km/s/kpc
    own = build_field([Bar(**bar, pattern_speed=speed)])
    angles = InTime((-10.0, 0.0), (float(np.degrees(-10.0 * sk.GYR * speed)), 0.0))
    turned = build_field([Bar(**bar, pattern_speed=0.0, orientation=[0, 0, 0]).changing({"orientation.2": angles})])
    np.testing.assert_allclose(turned.acceleration(T, Q), own.acceleration(T, Q), rtol=1e-9)


@pytest.mark.parametrize("velocities", [False, True])
def test_a_centre_is_of_fourth_order_in_time(velocities: bool) -> None:
    """A centre on a circle of 3 kpc: half the step has a sixteenth of the error, or less where the ends dominate."""
    rate, radius, errors = 4.0, 3.0, []  # per Gyr, kpc
    for count in (40, 80):
        t = np.linspace(-4, 0, count + 1)
        table = {"t": t, "x": radius * np.cos(rate * t), "y": radius * np.sin(rate * t), "z": 0 * t}
        if velocities:
            table |= {"vx": -rate / sk.GYR * table["y"], "vy": rate / sk.GYR * table["x"], "vz": 0 * t}
        halo = LogarithmicHalo(v0=220, p=1.0, q=1.0, centre=table)
        place = np.stack([radius * np.cos(rate * T / sk.GYR), radius * np.sin(rate * T / sk.GYR), 0 * T])
        q = 20.0 * Q / np.sqrt((Q**2).sum(axis=0))
        ours = build_field([halo]).acceleration(T, q)
        errors.append(np.sqrt(((ours - logarithmic(q - place, p=1.0, f=1.0)) ** 2).mean()))
    assert errors[0] / errors[1] > 12


FILE = BASE | {"progenitor": BASE["progenitor"] | {"lookback": 3.0}}
HALO: dict[str, Any] = {"kind": "nfw_triaxial", **TRIAXIAL}


def test_knots_of_an_angle_are_free_parameters_of_a_run_file() -> None:
    """A tumbling halo: a prior on where its axes were is one on its pattern speed."""
    angles = [0, "30 deg", {"times": ["-4 Gyr", 0], "values": [{"uniform": [-300, 300]}, 0]}]
    spec = sk.load(FILE | {"potential": HALO | {"orientation": angles}})
    name = "potential.orientation.2.values.0"
    assert name in spec.names
    assert sk.load(tomllib.loads(spec.toml())).document == spec.document
    (halo,) = spec.bind({name: 120.0}).potentials.values()
    exact = NFWTriaxial(**TRIAXIAL, orientation=[0, 30, 0]).changing({"orientation.2": InTime((-4, 0), (120, 0))})
    assert halo == exact
    fixed = spec.with_values({name: 120.0})
    assert name not in fixed.names
    assert fixed.bind().potentials["potential"] == exact


def test_a_body_is_a_part_of_the_host_on_the_path_of_the_body() -> None:
    """With minus the acceleration of the host's centre as a uniform one, of which a body takes care by itself."""
    body = {"kind": "hernquist", "mass": 1e11, "a": 10.0, "x": 50, "y": 0, "z": 0, "vx": 0, "vy": 150, "vz": 200}
    host = Host.at(FILE | {"body": {"lmc": body | {"friction": "none"}}})
    paths = host.paths(-4.0 * sk.GYR)
    path, frame = (orbit.at(np.linspace(-4.0, 0.0, 801) * sk.GYR) for orbit in (paths.bodies["lmc"], paths.centre))
    rows = {"t": path.t / sk.GYR, **dict(zip("xyz", path.q, strict=True))}
    given = dict(zip(("ax", "ay", "az"), -frame.a, strict=True))
    lift = UniformAcceleration().changing({n: InTime(tuple(rows["t"]), tuple(a)) for n, a in given.items()})
    parts = [*host.potentials.values(), Hernquist(mass=1e11, a=10.0, centre=rows), lift]
    exact = host.until(-4.0 * sk.GYR).acceleration(T, Q)
    assert np.abs(build_field(parts).acceleration(T, Q) - exact).max() < 1e-5 * np.abs(exact).max()


def test_energies_are_not_told_where_a_centre_moves() -> None:
    table = {"t": [-4, 0], "x": [10, 0], "y": [0, 0], "z": [0, 0]}
    moving = Host({"halo": NFW(mass=8e11, rs=16.0, centre=table)})
    assert moving.energy(Q, Q) is None
    assert moving.unbinds(START, SPEED) is None
    assert moving.escape_speed(np.array([8.0])) is None
    spec = sk.load(FILE | {"potential": {"kind": "nfw", "mass": 8e11, "rs": 16.0, "centre": table}})
    assert np.isfinite(sk.Model(spec).stream().q).all()


def with_halo(**fields: Any) -> Any:
    return sk.load(FILE | {"potential": HALO | fields})


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"centre": {"t": [-2, 0], "x": [0, 0], "y": [0, 0], "z": [0, 0]}},
         r"potential.centre: it is known from -2 to 0 Gyr; expected all times from -3 Gyr, where progenitor.lookback"),
        ({"centre": {"t": [0, -4], "x": [0, 0], "y": [0, 0], "z": [0, 0]}}, r"centre: column 't'.*larger than"),
        ({"centre": {"t": [-4, 0], "x": [0, 0], "y": [0, 0]}}, r"potential.centre: the column 'z' is missing"),
        ({"centre": {"t": [-4, 0], "x": [0, 0], "y": [0, 0], "z": [0, 0], "vx": [0, 0]}}, r"all of vx, vy and vz, or"),
        ({"centre": {"t": [0], "x": [0], "y": [0], "z": [0], "vx": [0], "vy": [0], "vz": [0]}}, r"a place at rest"),
        ({"centre": [1, 2, 3]}, r"potential.centre: found \[1, 2, 3\], expected a file"),
        ({"centre": "none.ecsv"}, r"potential.centre: .*none.ecsv"),
        ({"orientation": [0, 0, {"times": [-4], "values": [0]}]}, r"potential.orientation.2: found 1 times and 1"),
        ({"orientation": [0, 0, {"times": [-4, 0], "values": [0, "3 kpc"]}]},
         r"potential.orientation.2: values\[1\]: expected a quantity in deg"),
        ({"orientation": [{"times": [-4, 0], "values": [0, 3]}]}, r"found 1 angle\(s\), expected three"),
    ],
)  # fmt: skip
def test_bad_frames_are_told(fields: dict[str, Any], said: str) -> None:
    with pytest.raises(sk.SpecError, match=said):
        with_halo(**fields)


def test_only_a_host_moves_by_a_table() -> None:
    table = {"t": [-4, 0], "x": [0, 0], "y": [0, 0], "z": [0, 0]}
    body = {"kind": "hernquist", "mass": 1e11, "a": 10.0, "x": 50, "y": 0, "z": 0, "vx": 0, "vy": 100, "vz": 0}
    with pytest.raises(sk.SpecError, match=r"body.lmc.centre"):
        sk.load(FILE | {"body": {"lmc": body | {"centre": table}}})
    with pytest.raises(sk.SpecError, match=r"progenitor.centre"):
        sk.load(FILE | {"progenitor": FILE["progenitor"] | {"centre": table}})
    turning = {"times": [-4, 0], "values": [0, 90]}
    disc = body | {"kind": "miyamoto_nagai", "a": 3.0, "b": 0.3, "orientation": [0, 0, turning]}
    with pytest.raises(sk.SpecError, match=r"body.lmc.orientation.2: only a number of a host's potential may change"):
        sk.load(FILE | {"body": {"lmc": disc}})
    with pytest.raises(sk.SpecError, match=r"is a sphere, which has no orientation"):
        sk.load(FILE | {"potential": {"kind": "nfw", "mass": 8e11, "rs": 16.0, "orientation": [0, 0, turning]}})


class Dragging(sk.Potential):
    """A halo with friction."""

    kind = "test_dragging_halo"
    example: ClassVar[dict[str, Any]] = {"v0": 220.0}
    v0: sk.Speed = Field(description="Speed.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, v0: Any) -> Any:
        k = -v0 * v0 / (x * x + y * y + z * z)
        return k * x, k * y, k * z

    @staticmethod
    def drag(x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any, t: Any, v0: Any) -> Any:
        return -0.1 * vx, -0.1 * vy, -0.1 * vz


def test_a_force_that_depends_on_velocity_stays_where_it_is() -> None:
    with pytest.raises(ValueError, match="depends on velocity, whose centre is that of the host"):
        Dragging(v0=220, centre=falling([-4, 0]))
    with pytest.raises(ValueError, match="cannot change in time: a part of its force depends on velocity"):
        Dragging(v0=220, orientation=[0, 0, 0]).changing({"orientation.2": InTime(STEADY, (0.0, 1.0))})
