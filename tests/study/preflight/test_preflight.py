"""The preflight, against orbits in closed form and the erratum of the paper."""

from __future__ import annotations

import copy
import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import streamkit as sk
from streamkit.builtin.observables.apocentres.observable import Apocentres
from streamkit.runfile import Sun
from streamkit.study.preflight import describe_preflight, run_preflight
from streamkit.study.preflight.draws import PriorDraws, time_call, try_prior_draws
from streamkit.study.preflight.knot_warnings import knot_warnings
from streamkit.study.preflight.orbit import summarise_orbit
from streamkit.study.preflight.warnings import orbit_warnings, prior_warnings, sun_warnings

SAGITTARIUS = Path(__file__).parents[3] / "examples" / "sagittarius" / "sagittarius.toml"
SATELLITE = 1.0e8


def document(potential: dict[str, Any], q: tuple[float, ...], v: tuple[float, ...]) -> dict[str, Any]:
    place = dict(zip(("x", "y", "z", "vx", "vy", "vz"), (*q, *v), strict=True))
    return {
        "potential": potential,
        "progenitor": {"kind": "plummer", "mass": SATELLITE, "radius": 0.5, "lookback": 2.0} | place,
        "stripping": {"kind": "mlcs", "particles": 100},
    }


def inputs_of(*args: Any) -> Any:
    return sk.load(document(*args)).bind()


def isochrone_orbit(mass: float, b: float, r: float, v2: float, momentum: float) -> tuple[Any, ...]:
    """Pericentre, apocentre (kpc) and radial period (Gyr): Binney & Tremaine 2008, section 3.1(c).

    With s = 1 + sqrt(1 + r^2/b^2) the potential is -GM/(b s) and r^2 = b^2 (s^2 - 2 s), so the turning points
    2 E r^2 + 2 GM r^2/(b s) = L^2 are the roots of a quadratic in s; T_r = 2 pi GM / (-2E)^(3/2).
    """
    gm = sk.G * mass
    energy = 0.5 * v2 - gm / (b + math.sqrt(b * b + r * r))
    a2, a1, a0 = 2 * energy * b**2, 2 * gm * b - 4 * energy * b**2, -4 * gm * b - momentum**2
    s = np.sort(np.roots([a2, a1, a0]))
    peri, apo = b * np.sqrt(s**2 - 2 * s)
    return peri, apo, 2 * math.pi * gm / (-2 * energy) ** 1.5 / sk.GYR


@pytest.mark.parametrize("v", [(60.0, 110.0, 40.0), (-150.0, 80.0, 10.0), (5.0, 40.0, -30.0)])
def test_isochrone_turning_points_and_period(v: tuple[float, float, float]) -> None:
    q = (20.0, -3.0, 5.0)
    momentum = float(np.linalg.norm(np.cross(q, v)))
    peri, apo, period = isochrone_orbit(2e11, 3.0, float(np.linalg.norm(q)), float(np.dot(v, v)), momentum)
    result = summarise_orbit(inputs_of({"kind": "isochrone", "mass": 2e11, "b": 3.0}, q, v))
    np.testing.assert_allclose(result.pericentres, peri, rtol=1e-5)
    np.testing.assert_allclose(result.apocentres, apo, rtol=1e-5)
    assert result.period == pytest.approx(period, rel=1e-4)
    assert result.escapes is False
    assert result.returns
    assert abs(result.completed - 2.0 / period) <= 1


def test_kepler_tidal_radius_at_the_turning_points() -> None:
    """There Omega^2 = G M (1 +- e) / r^3 and Phi'' = -2 G M / r^3, so r_t = r (m / (M (3 +- e)))^(1/3)."""
    mass, a, e = 2e11, 40.0, 0.5
    speed = math.sqrt(sk.G * mass * (1 - e) / (a * (1 + e)))  # at the apocentre
    result = summarise_orbit(inputs_of({"kind": "kepler", "mass": mass}, (a * (1 + e), 0, 0), (0, speed, 0)))
    low = a * (1 - e) * (SATELLITE / (mass * (3 + e))) ** (1 / 3)
    high = a * (1 + e) * (SATELLITE / (mass * (3 - e))) ** (1 / 3)
    assert result.period == pytest.approx(2 * math.pi * math.sqrt(a**3 / (sk.G * mass)) / sk.GYR, rel=1e-4)
    np.testing.assert_allclose(result.r_tidal, (low, high), rtol=1e-3)


@pytest.mark.parametrize(("factor", "escapes"), [(0.99, False), (1.01, True)])
def test_escape_speed_of_a_point_mass(factor: float, escapes: bool) -> None:
    speed = factor * math.sqrt(2 * sk.G * 1e11 / 30.0)
    result = summarise_orbit(inputs_of({"kind": "kepler", "mass": 1e11}, (30.0, 0, 0), (0, speed, 0)))
    assert result.escapes is escapes


def test_nothing_escapes_a_logarithmic_halo_but_it_may_be_too_slow_to_return() -> None:
    halo = {"kind": "logarithmic", "v_h": 120.0, "r_h": 12.0}
    loaded = sk.load(document(halo, (20.0, 0, 0), (2500.0, 300.0, 0)))
    result = summarise_orbit(loaded.bind())
    assert result.escapes is False
    assert len(result.apocentres) == 0
    assert not result.returns
    (text,) = orbit_warnings(loaded, loaded.bind(), result)
    assert "no apocentre within the last 13.8 Gyr" in text


def test_energy_is_unknown_without_a_potential(monkeypatch: pytest.MonkeyPatch) -> None:
    inputs = inputs_of({"kind": "kepler", "mass": 1e11}, (30.0, 0, 0), (0, 500.0, 0))
    monkeypatch.setattr(type(inputs.potentials["potential"]), "potential", sk.Potential.potential)
    assert summarise_orbit(inputs).escapes is None


def paper(**progenitor: Any) -> sk.Spec:
    run = tomllib.loads(SAGITTARIUS.read_text())
    run["progenitor"] |= progenitor
    run["stripping"]["particles"] = 200
    return sk.load(run)


def test_the_papers_swapped_proper_motions_are_caught() -> None:
    swapped = paper(
        pm_l_cosb={"normal": ["1.97 mas/yr", "0.3 mas/yr"]}, pm_b={"normal": ["-2.44 mas/yr", "0.3 mas/yr"]}
    )
    preflight = run_preflight(swapped, draws=0)
    assert len(preflight.streams["stream"].orbit.apocentres) == 0
    text = preflight.warnings[0]
    assert "unbound" in text
    assert "two proper motions swapped?" in text
    assert "progenitor.pm_l_cosb and progenitor.pm_b exchanged" in text


def test_an_unbound_progenitor_is_not_always_a_swap() -> None:
    wild = paper(pm_l_cosb="9 mas/yr", pm_b="8 mas/yr")
    inputs = wild.bind()
    (text,) = orbit_warnings(wild, inputs, summarise_orbit(inputs))
    assert "unbound" in text
    assert "swapped" not in text


def test_the_paper_as_corrected_has_no_orbit_warning() -> None:
    right = paper()
    inputs = right.bind()
    assert orbit_warnings(right, inputs, summarise_orbit(inputs)) == []


def test_a_short_lookback_is_named() -> None:
    texts = run_preflight(paper(lookback="0.2 Gyr"), draws=0).warnings
    assert "shorter than the radial period" in texts[0]
    assert "Raise progenitor.lookback." in texts[0]
    assert texts[1] == (
        "There is no prediction at the prior's centre: the look-back time covers fewer than 1 apocentre of the "
        "progenitor. The look-back time covers 0 apocentres of the progenitor. Raise progenitor.lookback."
    )


def test_a_lookback_before_the_universe_is_named() -> None:
    old = paper(lookback="14 Gyr")
    inputs = old.bind()
    (text,) = orbit_warnings(old, inputs, summarise_orbit(inputs))
    assert "14 Gyr, exceeds the age of the Universe, 13.8 Gyr" in text


def test_the_tidal_radius_is_that_of_the_mass_left() -> None:
    """At pericentre r_t is smallest; with half of the mass gone by today, it is smaller by at most a cube root of 2."""
    whole, losing = (
        summarise_orbit(paper().with_values({"stripping.mass_loss": x}).bind()).r_tidal for x in (0.0, 0.5)
    )
    assert 0.5 ** (1 / 3) <= losing[0] / whole[0] < 0.95
    assert 0.9 < losing[1] / whole[1] <= 1


def test_the_epoch_aware_rule_needs_two_apocentres() -> None:
    inputs = paper().bind()
    period = summarise_orbit(inputs).period
    short = paper(lookback=1.2 * period).with_values({"observable.recent_debris": "epoch_aware"})
    preflight = run_preflight(short, draws=0)
    assert preflight.streams["stream"].orbit.completed == 1
    assert orbit_warnings(short, short.bind(), preflight.streams["stream"].orbit) == []
    text = next(text for text in preflight.warnings if "no prediction" in text)
    assert "covers fewer than 2 apocentres" in text
    assert "covers 1 apocentre of" in text
    assert text.endswith("Raise progenitor.lookback.")


STRANGER = '''
import numpy as np
from streamkit import Observable, Prediction, hookimpl

class Stranger(Observable):
    """What nobody here knows, and never has a value."""

    kind = "stranger"

    def data(self):
        return np.ones(1), np.ones(1)

    def predict(self, stream):
        return Prediction(("what",), np.full(1, np.nan), np.full(1, np.nan), why_not="something is missing")

@hookimpl
def streamkit_components():
    return [Stranger]
'''


@pytest.mark.parametrize(("lookback", "advised"), [("1.0 Gyr", True), ("3.5 Gyr", False)])
def test_a_longer_lookback_is_advised_by_the_orbit_whatever_the_observable(
    tmp_path: Path, lookback: str, advised: bool
) -> None:
    """The period is about 0.9 Gyr and there is always an earlier apocentre: one is covered, or several."""
    run = tomllib.loads(SAGITTARIUS.read_text())
    run["progenitor"]["lookback"] = lookback
    run["stripping"]["particles"] = 200
    run["observable"] = {"kind": "stranger"}
    (tmp_path / "stranger.py").write_text(STRANGER)
    run["plugins"] = [str(tmp_path / "stranger.py")]
    preflight = run_preflight(sk.load(run), draws=0)
    assert (preflight.streams["stream"].orbit.completed < 2) == advised
    text = next(text for text in preflight.warnings if "no prediction" in text)
    assert text.startswith("There is no prediction at the prior's centre: something is missing.")
    assert text.endswith("Raise progenitor.lookback.") == advised


@pytest.mark.parametrize(
    ("walkers", "text"),
    [(22, "too few for 11"), (23, "too few"), (24, "is few"), (27, "33 or more mix"), (28, "")],
)
def test_walkers(walkers: int, text: str) -> None:
    spec = paper().with_values({"sampler.walkers": walkers})
    advice = list(spec.sampler.advice(len(spec.names)))
    assert (text in advice[0]) if text else advice == []


def test_odd_suns() -> None:
    assert sun_warnings(Sun()) == []
    assert "sun.r0 = 80 kpc" in sun_warnings(Sun(r0=80.0))[0]
    assert "sun.z = 1 kpc" in sun_warnings(Sun(z=1.0))[0]
    assert "sun.v_circ = 23 km/s" in sun_warnings(Sun(v_circ=23.0))[0]


def test_the_prior_draws_end_when_enough_can_be_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = sk.load(SAGITTARIUS)  # four of ten draws of its prior have a stream
    tried = try_prior_draws(spec, 12)
    assert tried.draws == 12
    monkeypatch.setattr("streamkit.study.preflight.draws.ENOUGH", 2)
    fewer = try_prior_draws(spec, 12)
    np.testing.assert_array_equal(fewer.good, tried.good[:2])
    assert fewer.draws == 2 + fewer.reasons.total() < 12


def test_the_prior_draws_count_every_draw_once_and_repeats_itself() -> None:
    first, second = (try_prior_draws(paper(), 12) for _ in range(2))
    assert first.draws == 12
    assert len(first.good) + sum(first.reasons.values()) == 12
    assert len(first.good) == len(first.seconds)
    np.testing.assert_array_equal(first.good, second.good)


def test_rare_and_dear_streams_are_named() -> None:
    rare = PriorDraws(64, np.zeros((2, 11)), np.ones(2), reasons=try_prior_draws(paper(), 0).reasons)
    spec = paper()
    assert "Only 2 of 64" in prior_warnings(spec, spec.bind_all(), rare)[0]
    dear = PriorDraws(64, np.zeros((20, 11)), np.r_[np.ones(18), 40.0, 40.0], reasons=rare.reasons)
    assert "40 times the usual" in prior_warnings(spec, spec.bind_all(), dear)[0]
    even = PriorDraws(64, np.zeros((20, 11)), np.ones(20), reasons=rare.reasons)
    assert prior_warnings(spec, spec.bind_all(), even) == []


def test_the_cost_is_that_of_a_call_of_this_process() -> None:
    preflight = run_preflight(paper(), draws=0)
    assert 0 < preflight.cost.call < 5
    assert preflight.cost.where == "the prior's centre"
    assert preflight.prior_draws is None


@pytest.mark.parametrize("compiled", [True, False])
def test_a_first_call_with_compilation_is_not_the_cost_of_a_call(compiled: bool) -> None:
    spec = paper()
    seconds, _ = time_call(spec, spec.centre(), 100.0, compiled=compiled)
    assert (seconds < 5) == compiled
    assert seconds == 100.0 or compiled


def test_a_run_file_without_data_says_that_it_cannot_be_fitted() -> None:
    run = copy.deepcopy(paper().document)
    for name in ("leading", "trailing", "precession"):
        del run["observable"][name]
    preflight = run_preflight(sk.load(run), draws=0)
    assert any("cannot be fitted: observable" in text for text in preflight.warnings)


@pytest.mark.parametrize(
    ("first", "last", "text"),
    [(0.0, 125.0, ""), (0.0, 95.0, "ends 15 deg beyond"), (60.0, 150.0, "20 deg before")],
)
def test_an_arm_that_ends_inside_the_fitted_window_is_named(first: float, last: float, text: str) -> None:
    details = {"trailing_angle": -np.arange(first, last + 1), "trailing_peak": np.array([-80.0, 100.0])}
    prediction = sk.Prediction(("trailing",), np.array([100.0]), np.array([1.0]), details=details)
    result = Apocentres().remarks(prediction)
    assert (text in result[0]) if text else result == ()


def test_how_far_the_bodies_go() -> None:
    """A clump on a circle of 30 kpc, in a host that it does not move and that does not slow it down."""
    mass, radius = 1e11, 30.0
    speed = math.sqrt(sk.G * mass / radius)
    clump = {"kind": "plummer", "mass": 1e6, "radius": 1.0, "friction": "none", "reflex": False}
    clump |= {"x": radius, "y": 0.0, "z": 0.0, "vx": 0.0, "vy": 0.0, "vz": speed}
    whole = document({"kind": "kepler", "mass": mass}, (20.0, 0.0, 0.0), (0.0, 100.0, 0.0)) | {"body": {"clump": clump}}
    preflight = run_preflight(sk.load(whole), draws=0)
    assert preflight.streams["stream"].orbit.bodies == {
        "clump": (pytest.approx(radius, rel=1e-6), pytest.approx(radius, rel=1e-6))
    }
    assert "body clump" in describe_preflight(sk.load(whole), preflight)


def test_a_body_that_cannot_be_followed_further_ends_the_look_back_alone() -> None:
    """It falls into the centre 1.6 Gyr ago; the stream needs the last 0.5 Gyr only."""
    mass = 1e11
    infall = {"kind": "plummer", "mass": 1e6, "radius": 1.0, "friction": "none", "reflex": False}
    far = (math.sqrt(2 * sk.G * mass) * 1.5 * 1.6 * sk.GYR) ** (2 / 3)  # the parabola: r^(3/2) grows with time
    infall |= {"x": far, "y": 0.0, "z": 0.0, "vx": math.sqrt(2 * sk.G * mass / far), "vy": 0.0, "vz": 0.0}
    whole = document({"kind": "kepler", "mass": mass}, (60.0, 0.0, 0.0), (0.0, 60.0, 0.0)) | {"body": {"in": infall}}
    whole["progenitor"]["lookback"] = 0.5
    result = summarise_orbit(sk.load(whole).bind())
    assert result.bodies["in"][1] == pytest.approx(far, rel=1e-9)
    whole["progenitor"]["lookback"] = 2.0
    with pytest.raises(sk.OutOfDomain, match="the body in passes too near the Galactic centre"):
        sk.Model(sk.load(whole)).stream()


@pytest.mark.parametrize(
    ("times", "free", "text"),
    [
        ([-2, 0], 0, ""),
        ([-2, 0], 1, ""),
        ([-3, -2, 0], 0, "potential.v0.values.0 is its value at -3 Gyr, and the streams begin at -2 Gyr."),
        ([-3, -1, 0], 0, ""),
        ([0, 3], 1, "potential.v0.values.1 is its value at 3 Gyr, which is to come: the past is negative."),
        ([-1, 3], 1, ""),
    ],
)
def test_a_free_knot_that_acts_at_no_time_of_a_stream_is_told(times: list[float], free: int, text: str) -> None:
    values: list[Any] = [220.0] * len(times)
    values[free] = {"uniform": [180, 260]}
    host = {"kind": "logarithmic_halo", "v0": {"times": times, "values": values}}
    spec = sk.load(document(host, (8.0, 0.0, 6.0), (20.0, 200.0, 30.0)))
    assert knot_warnings(spec, spec.bind_all(spec.centre())) == ([text] if text else [])
