"""A host whose centre moves: streams are as in the host at rest, by Galileo's transformation and Einstein's lift."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import MiyamotoNagai
from streamkit.builtin.potentials.halos import NFWTriaxial
from streamkit.engine import Motion
from streamkit.model import NODE, Host, Model
from streamkit.stream import Observer
from streamkit.stream import seen_from as on_sky
from streamkit.units import GYR

TIMES = np.linspace(-3, 0, 25)
LOOKBACK = 2.0
START, SPEED = np.array([15.0, 2.0, 5.0]), np.array([-20.0, 150.0, 50.0])
HALO: dict[str, Any] = {"kind": "nfw_triaxial", "mass": 1e12, "rs": 15.0, "p": 0.9, "q": 0.8}
DISC: dict[str, Any] = {"kind": "miyamoto_nagai", "mass": 6e10, "a": 3.0, "b": 0.3}
SATELLITE: dict[str, Any] = {"kind": "hernquist", "mass": 1e11, "a": 10.0}  # another galaxy on a path of its own
RECORDS = ("q", "v", "t_strip", "dq_galactocentric", "winding", "chi")


def table(place: Any, velocity: Any = None) -> dict[str, list[float]]:
    """The table of a centre: ``place(t)`` (3, n) in kpc at times in kpc/(km/s)."""
    rows = {"t": TIMES, **dict(zip("xyz", place(TIMES * GYR), strict=True))}
    if velocity is not None:
        rows |= dict(zip(("vx", "vy", "vz"), velocity(TIMES * GYR), strict=True))
    return {name: np.asarray(column).tolist() for name, column in rows.items()}


def evenly(x: Any, v: Any, a: Any) -> Any:
    """A path of constant acceleration."""
    x, v, a = (np.array(one, dtype=float)[:, None] for one in (x, v, a))
    return lambda t: x + v * t + 0.5 * a * t**2


def run_file(x: Any = (0, 0, 0), v: Any = (0, 0, 0), a: Any = (0, 0, 0), **more: Any) -> dict[str, Any]:
    """A stream in a galaxy of two parts, or the same one on a path: everything that is in it moves along."""
    path, x, v = evenly(x, v, a), np.array(x), np.array(v)
    away = {"centre": table(path)} if x.any() or v.any() or np.any(a) else {}
    lift = dict(zip(("ax", "ay", "az"), map(float, a), strict=True))
    far = evenly([60, -20, 30], [-100, 150, 40], [0, 0, 0])
    parts = {"halo": HALO | away, "disc": DISC | away} | {
        "satellite": SATELLITE | {"centre": table(lambda t: path(t) + far(t))}
    }
    if np.any(a):  # what makes the galaxy move acts on all in it
        parts["lift"] = {"kind": "uniform_acceleration", **lift}
    place = dict(zip(("x", "y", "z", "vx", "vy", "vz"), [*(START + x).tolist(), *(SPEED + v).tolist()], strict=True))
    progenitor = {"kind": "plummer", "mass": 1e5, "radius": "10 pc", "lookback": LOOKBACK, **place}
    return {"potential": parts, "progenitor": progenitor, "stripping": {"kind": "mlcs", "particles": 100}} | more


PATHS: dict[str, dict[str, Any]] = {
    "boost": {"v": (150.0, -80.0, 40.0)},
    "elsewhere": {"x": (40.0, -30.0, 20.0), "v": (150.0, -80.0, 40.0)},
    "lift": {"v": (10.0, 20.0, -30.0), "a": (40.0, 30.0, -20.0)},
}


@pytest.mark.parametrize("path", PATHS.values(), ids=PATHS)
def test_a_stream_in_a_host_that_moves_is_that_in_the_host_at_rest(path: dict[str, Any]) -> None:
    """Releases, tidal radii, steps and records are those about its centre; so are all positions and velocities."""
    still, moved = (Model(run_file(**at)).stream() for at in ({}, path))
    assert moved.orbit.r_tidal == pytest.approx(still.orbit.r_tidal, rel=1e-10)
    assert moved.orbit.apocentres() == pytest.approx(still.orbit.apocentres(), abs=1e-8)
    for name in RECORDS:
        assert getattr(moved, name) == pytest.approx(getattr(still, name), abs=1e-6), name


def test_a_live_progenitor_moves_along() -> None:
    """A round-off decides whether single particles are bound, and moves no mean."""
    live = {"stripping": {"kind": "restricted_nbody", "particles": 4000}}
    documents = [run_file(**at, **live) for at in ({}, PATHS["lift"])]
    for document in documents:
        document["progenitor"] |= {"mass": 2e6, "radius": 0.03}
    still, moved = (Model(document).stream() for document in documents)
    assert 0.05 < still.bound_share < 0.95
    assert moved.bound_share == pytest.approx(still.bound_share, abs=0.02)
    assert np.std(moved.winding) == pytest.approx(np.std(still.winding), rel=0.02)
    assert np.median(moved.orbit.r_tidal / still.orbit.r_tidal) == pytest.approx(1.0, abs=0.01)


def test_bodies_and_friction_move_along() -> None:
    """A body with friction, and the reflex to it, about a galaxy that moves evenly or falls."""
    place = {"x": 50.0, "y": 10.0, "z": -20.0, "vx": -60.0, "vy": -180.0, "vz": 120.0}

    def stream(**path: Any) -> sk.Stream:
        moved = np.concatenate([path.get("x", np.zeros(3)), path.get("v", np.zeros(3))])
        there = {name: value + shift for (name, value), shift in zip(place.items(), moved.tolist(), strict=True)}
        return Model(run_file(**path, body={"lmc": {"kind": "hernquist", "mass": 8e10, "a": 8.0, **there}})).stream()

    still = stream()
    for path in (PATHS["elsewhere"], PATHS["lift"]):
        moved = stream(**path)
        assert moved.q == pytest.approx(still.q, abs=1e-5)
        assert moved.orbit.q == pytest.approx(still.orbit.q, abs=1e-7)


def test_the_sun_sees_the_same_sky() -> None:
    """The Sun moves along with the galaxy: its velocity is one in the coordinates of the run file, as all others."""
    drift = np.array(PATHS["boost"]["v"])
    place = {"ra": 200.0, "dec": 30.0, "distance": 12.0, "pm_ra_cosdec": -3.0, "pm_dec": -4.0, "v_los": 60.0}
    sky = {"progenitor": {"kind": "plummer", "mass": 1e5, "radius": "10 pc", "lookback": LOOKBACK, **place}}
    suns = ({"u": 11.1, "v": 12.24, "w": 7.25}, dict(zip("uvw", drift + np.array([11.1, 12.24, 7.25]), strict=True)))
    still, moved = (
        Model(run_file(**path) | sky | {"sun": {name: float(value) for name, value in sun.items()}}).stream()
        for path, sun in zip(({}, {"v": drift}), suns, strict=True)
    )
    assert moved.q == pytest.approx(still.q, abs=1e-6)
    for one, other in zip(moved.seen(), still.seen(), strict=True):
        assert one == pytest.approx(other, abs=1e-6)


def test_the_sun_sees_the_sky_from_its_place_in_the_run_file() -> None:
    """From a galaxy that is not at the origin today: the same lines of sight in the coordinates of the run file."""
    stream = Model(run_file(**PATHS["elsewhere"])).stream()
    x, v = (np.array(PATHS["elsewhere"][name])[:, None] for name in ("x", "v"))
    exact = on_sky(Observer(), stream.q + x, stream.v + v, sk.sky_matrix(None))
    for name in ("lon", "lat", "distance", "pm_lon_coslat", "pm_lat", "radial_velocity"):
        assert getattr(stream.seen(), name) == pytest.approx(getattr(exact, name), abs=1e-8), name


@pytest.mark.parametrize("velocities", [False, True], ids=["spline", "velocities"])
def test_orbits_are_those_in_the_coordinates_of_the_run_file(velocities: bool) -> None:
    """A centre that sways by 8 kpc, and nothing sways along: from the frame that moves along, or from the origin."""
    w = 5.0 / GYR

    def place(t: Any) -> Any:
        return np.stack([8 * np.sin(w * t), 5 * np.cos(w * t), 3 * np.sin(2 * w * t)])

    def velocity(t: Any) -> Any:
        return w * np.stack([8 * np.cos(w * t), -5 * np.sin(w * t), 6 * np.cos(2 * w * t)])

    away = table(place, velocity if velocities else None)
    spec = sk.load(run_file() | {"potential": {"halo": HALO | {"centre": away}, "disc": DISC | {"centre": away}}})
    inputs, end = spec.bind(), -LOOKBACK * GYR
    halo, disc = ({name: value for name, value in one.items() if name != "kind"} for one in (HALO, DISC))
    given = Host({"halo": NFWTriaxial(**halo, centre=away), "disc": MiyamotoNagai(**disc, centre=away)})
    exact = given.alone.orbit(START, SPEED, 0.0, end, NODE)
    orbit = Host(inputs.potentials).alone.orbit(inputs.q, inputs.v, 0.0, end, NODE)
    path = np.array([given.potentials["halo"].motion().state_at(float(t)) for t in orbit.t])
    size = 1e-2 if velocities else 1e-4  # kpc: with velocities the accelerations of the cubics jump at the rows
    assert orbit.q + path[:, 0].T == pytest.approx(exact.q, abs=size)
    assert orbit.v + path[:, 1].T == pytest.approx(exact.v, abs=50 * size)
    assert np.abs(path).max() > 7


def test_the_host_is_the_heaviest_galaxy_on_a_path() -> None:
    """Its centre is the origin, and masses, speeds and energies are those about it; the others move past it."""
    still, moved = (Host.at(run_file(**path)) for path in ({}, PATHS["boost"]))
    radii = np.array([1.0, 10.0, 50.0])
    assert not len(moved.potentials["halo"].motion().centre)
    assert moved.potentials["satellite"].drifts
    assert moved.mass_inside(radii) == pytest.approx(still.mass_inside(radii), rel=1e-12)
    assert moved.circular_velocity(radii) == pytest.approx(still.circular_velocity(radii), rel=1e-12)
    falls = Host.at(run_file(**PATHS["lift"]))  # the force of the frame is none of the host's
    assert falls.density(START[:, None]) == pytest.approx(still.density(START[:, None]), rel=1e-6)
    assert falls.mass_inside(radii) == pytest.approx(still.mass_inside(radii), rel=1e-12)
    alone = run_file(**PATHS["boost"])
    del alone["potential"]["satellite"]
    inputs = sk.load(alone).bind()
    assert Host(inputs.potentials).energy(inputs.q[:, None], inputs.v[:, None]) is not None  # it moves evenly


def test_a_part_with_mass_at_the_origin_holds_the_centre_there() -> None:
    document = run_file(**PATHS["boost"])
    del document["potential"]["disc"]["centre"]
    spec = sk.load(document)
    assert spec.sections.host_centre is None
    assert spec.bind().q == pytest.approx(START)


def test_a_part_without_mass_does_not() -> None:
    document = run_file(**PATHS["lift"])  # with a uniform acceleration
    assert sk.load(document).sections.host_centre is not None


def test_free_parameters_do_not_move_the_centre() -> None:
    """Which galaxy is the host is decided at the centres of the priors."""
    document = run_file(**PATHS["boost"])
    document["potential"]["satellite"] |= {"mass": {"uniform": [1e10, 5e12]}, "a": 40.0}
    document["potential"]["halo"] |= {"mass": {"uniform": [2e12, 6e12]}}
    spec = sk.load(document)
    for mass in (1e10, 4e12):
        inputs = spec.bind({"potential.satellite.mass": mass})
        assert not len(inputs.potentials["halo"].motion().centre)
        assert inputs.v == pytest.approx(SPEED)


def test_paths_with_rows_at_other_times_are_subtracted() -> None:
    """The difference of two cubics on their own times, before and after them too."""
    rng = np.random.default_rng(39)
    first, second = (np.sort(rng.uniform(-3, 0, n)) for n in (7, 5))
    one, other = (Motion(centre=Motion.cubics(t, rng.normal(size=(4, len(t) - 1, 3)))) for t in (first, second))
    row = np.zeros((1, 13))
    row[0, 1::4] = 3.0, -2.0, 1.0
    at_rest = Motion(centre=row)
    for a, b in ((one, other), (one, at_rest), (at_rest, one), (Motion(), one)):
        difference = a.seen_from(b.centre)
        for t in rng.uniform(-5, 2, 200).tolist():
            exact = np.array(a.state_at(t)) - np.array(b.state_at(t))
            assert np.array(difference.state_at(t)) == pytest.approx(exact, abs=1e-9)
    assert not len(one.seen_from(one.centre.copy()).centre)
