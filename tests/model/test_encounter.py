"""Bodies that fly past a stream: velocity kicks in closed form, steps that are short enough, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import streamkit as sk
from streamkit.model import Host, blocks, progenitor_track, simulate
from streamkit.model.encounter import flights_past, with_progenitor
from streamkit.model.release import stripped

FRAME = {"pole": [192.85948, 27.12825], "origin": [266.4051, -28.936175]}  # the Galactic plane, to a tenth of a degree
MET = {"phi1": 0, "time": "0.2 Myr", "impact_parameter": "60 pc", "angle": 40, "v_parallel": 12500,
       "v_perpendicular": 15000}  # fmt: skip
CLUMP = {"kind": "plummer", "mass": 1e7, "radius": "40 pc"}


def run_file(clump=None, particles=400, **encounter):
    """A stream of almost no mass on a circular orbit about the Galactic centre, beyond it as seen from the Sun."""
    document = {
        "potential": {"kind": "logarithmic_halo", "v0": 220},
        "progenitor": {"kind": "plummer", "mass": 1e-3, "radius": "1 pc", "x": 10, "y": 0, "z": 0, "vx": 0, "vy": 220,
                       "vz": 0, "lookback": 10},
        "stripping": {"kind": "mlcs", "particles": particles, "sigma": 0.005, "progenitor_gravity": False},
    }  # fmt: skip
    if clump is not None:
        document["body"] = {"clump": clump | {"encounter": {"frame": FRAME} | MET | encounter}}
    return document


def stream_of(document):
    return sk.Model(document).stream()


def kicked(mass, radius, s, impact_parameter, psi, parallel, perpendicular):
    """Erkal & Belokurov 2015, MNRAS 450, 1136, section 2: change of velocity at a distance s ahead along the stream.

    Components outward, along the stream and along its angular momentum, by a Plummer sphere on a straight line.
    """
    speed2 = parallel**2 + perpendicular**2
    below = np.sqrt(speed2) * ((impact_parameter**2 + radius**2) * speed2 + perpendicular**2 * s**2)
    strength = 2 * sk.G * mass / below
    along = -strength * perpendicular**2 * s
    aside = strength * impact_parameter * speed2
    turn = strength * parallel * perpendicular * s
    cos, sin = np.cos(psi), np.sin(psi)
    return np.array([cos * aside - sin * turn, along, sin * aside + cos * turn])


@pytest.mark.parametrize(
    ("angle", "parallel", "perpendicular"),
    [(0, 0, 20000), (40, 12500, 15000), (210, -12500, 15000), (90, 7500, -18000)],
)
def test_the_kick_is_that_of_erkal_and_belokurov(angle, parallel, perpendicular):
    settings = {"angle": angle, "v_parallel": parallel, "v_perpendicular": perpendicular}
    before = stream_of(run_file())
    after = stream_of(run_file(CLUMP, **settings))
    q, v = before.orbit.q[:, -1], before.orbit.v[:, -1]
    outward, along = q / np.linalg.norm(q), v / np.linalg.norm(v)
    axes = np.array([outward, along, np.cross(outward, along)])
    s = axes[1] @ (before.q - q[:, None])
    assert np.ptp(s) > 0.15
    expected = kicked(1e7, 0.04, s, 0.06, np.radians(angle), parallel, perpendicular)
    found = axes @ (after.v - before.v)
    near = np.abs(s) < 0.15  # on a straight line
    assert near.sum() > 100
    assert np.abs(found - expected)[:, near].max() < 0.03 * np.abs(expected).max()


def test_steps_resolve_a_slow_and_close_encounter(monkeypatch):
    """Blocks and steps of a quarter of the length change nothing of what the encounter does to the stream."""
    slow = {"time": "300 Myr", "impact_parameter": "10 pc", "angle": 60, "v_parallel": 40, "v_perpendicular": 90}
    without, met = run_file(), run_file(CLUMP | {"mass": 1e6, "radius": "10 pc"}, **slow)
    for each in (without, met):
        each["progenitor"]["lookback"], each["stripping"]["sigma"] = 1, 0.05
    found = stream_of(met).q - stream_of(without).q
    monkeypatch.setattr(blocks, "NEAR", blocks.NEAR / 4)
    fine = {"integrator": {"kind": "adaptive", "eta": 0.1, "eta_progenitor": 0.1}}
    exact = stream_of(met | fine).q - stream_of(without | fine).q
    effect, error = (np.linalg.norm(each, axis=0) for each in (exact, found - exact))
    assert effect.max() > 0.5
    assert error.max() < 0.003 * effect.max()


def test_the_stream_may_lie_beside_the_orbit_of_its_progenitor():
    """The body passes the mean of the particles that it would find, at every angle."""
    heavy = run_file() | {"progenitor": run_file()["progenitor"] | {"mass": 1e5, "lookback": 3}}
    inputs = sk.load(heavy | {"body": run_file(CLUMP, time="0.4 Gyr", phi1=10)["body"]}).bind()
    host = Host(inputs.potentials)
    track = progenitor_track(host, inputs)
    orbit = stripped(inputs, track)
    field = with_progenitor(host.until(float(track.t[0])), inputs, orbit)
    flights = [
        flights_past(replace(inputs, flybys={"clump": replace(flyby, encounter=at)}), host, track, orbit, field)[0]
        for flyby in inputs.flybys.values()
        for at in (flyby.encounter.model_copy(update={"angle": angle}) for angle in (0, 90, 180, 270))
    ]
    then = -0.4 * sk.GYR
    places = np.array([flight.orbit.at(np.array([then])).q[:, 0] for flight in flights])
    point = places.mean(axis=0)
    assert np.linalg.norm(places - point, axis=1) == pytest.approx(0.06, rel=1e-6)
    assert [flight.time for flight in flights] == [then] * 4
    beside = track.at(np.linspace(then - 0.3, then + 0.3, 20001)).q
    away = np.linalg.norm(beside - point[:, None], axis=0).min()
    assert away > 0.02  # a third of the impact parameter, although the orbit is a circle
    few = inputs.stripping.model_copy(update={"particles": 4000, "sigma": 0.0})
    stream = simulate(replace(inputs, flybys={}, stripping=few), np.zeros((3, 4000)))
    near = np.abs(stream.seen(FRAME).lon - 10) < 0.2
    back = np.array(
        [
            host.alone.orbit(q, v, 0.0, then, 0.002).q[:, 0]
            for q, v in zip(stream.q[:, near].T, stream.v[:, near].T, strict=True)
        ]
    )
    assert np.linalg.norm(back.mean(axis=0) - point) < 0.3 * away


def test_the_gap_and_the_spur_of_gd1_are_those_of_bonaca_2019():
    """A top-hat through the ratio of the densities with and without the body; GD-1's: 8.5 deg about -40.5 deg."""
    spec = sk.load(Path(__file__).parents[2] / "examples" / "gd1_gap" / "truth_gap.toml")
    seen, alone = (
        sk.Model(each).stream().seen("GD1Koposov10") for each in (spec, spec.with_values({"body.clump.mass": 1e-3}))
    )
    there = (alone.lon > -60) & (alone.lon < 0)
    track = np.polyfit(alone.lon[there], alone.lat[there], 4)
    edges = np.arange(-56.0, -28.0, 0.5)
    middle = 0.5 * (edges[1:] + edges[:-1])
    above, above_alone = seen.lat - np.polyval(track, seen.lon), alone.lat - np.polyval(track, alone.lon)
    now, before = (
        np.histogram(each.lon[np.abs(off) < 0.5], edges)[0] for each, off in ((seen, above), (alone, above_alone))
    )
    ratio, hats = now / before, {}
    for begin in np.arange(-50, -36, 0.25):
        for end in np.arange(begin + 2, -30, 0.25):
            inside = (middle > begin) & (middle < end)
            hat = np.where(inside, ratio[inside].mean(), ratio[~inside].mean())
            hats[begin, end] = ((ratio - hat) ** 2).sum()
    begin, end = min(hats, key=hats.get)
    assert 0.5 * (begin + end) == pytest.approx(-40.5, abs=1)
    assert end - begin == pytest.approx(8.5, abs=1.5)
    spur, spur_alone = (
        (off > 0.8) & (each.lon > -35) & (each.lon < -28) for each, off in ((seen, above), (alone, above_alone))
    )
    assert spur.sum() > 100 > 10 > spur_alone.sum()


def refused(document):
    with pytest.raises(sk.SpecError) as error:
        sk.load(document)
    return str(error.value)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"stream": "gd2"}, "body.clump.encounter.stream: found 'gd2', and no stream is called so"),
        ({"time": "12 Gyr"}, "time: found 12 Gyr, expected less than the look-back time: the stream begins 10 Gyr ago"),
        ({"impact_parameter": "-1 pc"}, "body.clump.encounter.impact_parameter: found"),
        ({"frame": None}, "body.clump.encounter: 'frame' is missing"),
        ({"impact": "1 pc"}, "the encounter has no field 'impact'"),
        ({"time": {"uniform": ["-1 Gyr", "1 Gyr"]}}, "reaches outside the field's range"),
    ],
)  # fmt: skip
def test_an_encounter_that_cannot_be_is_refused(changed, sentence):
    assert sentence in refused(run_file(CLUMP, **changed))


def test_a_body_has_one_place():
    document = run_file(CLUMP)
    document["body"]["clump"]["friction"] = "none"
    assert "found friction beside an encounter" in refused(document)
    document["body"]["clump"] = CLUMP | {"encounter": "yes"}
    assert "body.clump.encounter: found 'yes', expected a table with phi1, time" in refused(document)


def test_a_stream_that_does_not_reach_phi1_has_no_encounter():
    with pytest.raises(sk.OutOfDomain, match=r"has no particles at phi1 = 90 deg today; .* reach from -"):
        stream_of(run_file(CLUMP, phi1=90))


def test_numbers_of_an_encounter_may_have_priors_and_survive_the_resolved_run_file(tmp_path):
    document = run_file(CLUMP, time={"uniform": ["0.1 Gyr", "1 Gyr"]}, impact_parameter={"uniform": [0, "50 pc"]})
    spec = sk.load(document)
    assert spec.names == ("body.clump.encounter.time", "body.clump.encounter.impact_parameter")
    assert spec.units == ("Gyr", "kpc")
    (tmp_path / "run.toml").write_text(spec.toml())
    assert sk.load(tmp_path / "run.toml").document == spec.document
    flyby = spec.bind([0.3, 0.01]).flybys["clump"]
    assert (flyby.encounter.time, flyby.encounter.impact_parameter) == (0.3, 0.01)
    assert spec.with_values({"body.clump.encounter.time": "0.2 Gyr"}).names == spec.names[1:]


def test_a_body_acts_on_the_stream_that_it_met_alone():
    one = run_file(CLUMP, particles=20, stream="a", time={"uniform": ["0.1 Gyr", "1 Gyr"]})
    stream = {key: one.pop(key) for key in ("progenitor", "stripping")}
    both = sk.load(one | {"stream": {"a": stream, "b": stream}})
    names = [factor.name for factor in both.factors if len(factor.own)]
    assert names == ["a"]
    assert both.only("b").names == ()
    assert both.only("a").names == both.names
    inputs = both.bind_all()
    assert set(inputs.streams["a"].flybys) == {"clump"}
    assert not inputs.streams["b"].flybys


def test_encounters_add_up_and_go_with_moving_bodies_and_equal_steps():
    """Two halves of a body are one; galaxies and progenitors without weight that pull the host change nothing."""
    met = {"time": "0.3 Gyr", "v_parallel": 100, "v_perpendicular": 200}
    document = run_file(CLUMP, **met)
    document["progenitor"]["lookback"] = 1
    document["stripping"] |= {"sigma": 0.05, "progenitor_gravity": True, "mass_loss": 0.5}
    one = stream_of(document)
    half = run_file(CLUMP | {"mass": 5e6}, **met)["body"]["clump"]
    far = {"kind": "plummer", "mass": 1e-3, "radius": 1, "x": 50, "y": 0, "z": 0, "vx": 0, "vy": 100, "vz": 0}
    two = stream_of(document | {"body": {"one": half, "two": half}})
    beside = stream_of(document | {"body": document["body"] | {"far": far}})
    pulled = stream_of(document | {"progenitor": document["progenitor"] | {"reflex": True}})
    fixed = stream_of(document | {"integrator": {"kind": "pefrl", "step": "1 Myr"}})
    effect = np.abs(one.q - stream_of({k: v for k, v in document.items() if k != "body"}).q).max()
    assert effect > 0.5
    for other, tolerance in ((two, 5e-3), (beside, 1e-3), (pulled, 1e-3), (fixed, 1e-2)):  # halves have longer steps
        assert np.abs(other.q - one.q).max() < tolerance * effect


def test_bodies_at_all_distances_act_as_in_steps_that_evaluate_them_at_every_stage():
    """A body kicks as often as its passage asks for. PEFRL with equal steps evaluates it in every stage of a step."""
    met = [
        {"time": "0.3 Gyr", "impact_parameter": "50 pc", "v_parallel": 100, "v_perpendicular": 200},
        {"time": "0.5 Gyr", "impact_parameter": "2 kpc", "v_parallel": -90, "v_perpendicular": 60},
        {"time": "0.7 Gyr", "impact_parameter": "9 kpc", "v_parallel": 30, "v_perpendicular": -250},
    ]
    fixed = {"integrator": {"kind": "pefrl", "step": "0.25 Myr"}}
    for each in met:
        document = run_file(CLUMP, particles=100, **each)
        document["progenitor"]["lookback"], document["stripping"]["sigma"] = 1, 0.05
        alone = {key: value for key, value in document.items() if key != "body"}
        found = stream_of(document).q - stream_of(alone).q
        exact = stream_of(document | fixed).q - stream_of(alone | fixed).q
        effect, error = (np.linalg.norm(one, axis=0) for one in (exact, found - exact))
        assert effect.max() > 0.004
        assert error.max() < 0.02 * effect.max() + 2e-4


def test_many_bodies_act_as_in_steps_that_evaluate_all_of_them():
    """Particles are far from most bodies together, which then kick seldom or not at all; PEFRL leaves nothing out."""
    rng = np.random.default_rng(5)
    document = run_file(particles=600)
    document["progenitor"]["lookback"], document["stripping"]["sigma"] = 1, 0.05
    document["body"] = {
        f"clump_{i}": {"kind": "plummer", "mass": float(mass), "radius": float(1.62 * np.sqrt(mass / 1e8)),
                       "encounter": {"frame": FRAME, "phi1": 0, "time": float(rng.uniform(0.1, 0.7)),
                                     "impact_parameter": float(rng.uniform(0, 3)), "angle": float(rng.uniform(0, 360)),
                                     "v_parallel": float(rng.normal(-200, 150)), "v_perpendicular": 150}}
        for i, mass in enumerate(10 ** rng.uniform(5.5, 8, 12))
    }  # fmt: skip
    alone = {key: value for key, value in document.items() if key != "body"}
    fixed = {"integrator": {"kind": "pefrl", "step": "0.5 Myr"}}
    found = stream_of(document).q - stream_of(alone).q
    exact = stream_of(document | fixed).q - stream_of(alone | fixed).q
    effect, error = (np.linalg.norm(one, axis=0) for one in (exact, found - exact))
    assert effect.max() > 0.1
    assert error.max() < 0.05 * effect.max()


@pytest.mark.parametrize("bodies", [3, 6])  # each looks for passages in another way, and none may be left out
def test_particles_beside_bodies_are_independent_of_each_other(bodies):
    """Two threads divide the particles into other batches: the stream keeps its bits."""
    document = run_file(particles=9000)
    document["progenitor"]["lookback"] = 0.3
    near = {"frame": FRAME, "phi1": 0, "time": 0.1, "angle": 30, "v_parallel": 90, "v_perpendicular": 150}
    document["body"] = {
        f"clump_{i}": CLUMP | {"encounter": near | {"impact_parameter": 0.05 * 3**i, "time": 0.05 + 0.03 * i}}
        for i in range(bodies)
    }
    one, two = (sk.Model(document, threads=threads).stream() for threads in (1, 2))
    assert np.array_equal(one.q, two.q)
    assert np.array_equal(one.v, two.v)
