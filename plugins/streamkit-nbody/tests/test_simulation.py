"""The physics of a run: equilibrium, conservation, the host's orbit, the records."""

import numpy as np
import pytest
from scipy.stats import kstest
from streamkit_nbody.plan import Options
from streamkit_nbody.simulation import Simulation, _crossings

from streamkit import GYR, OutOfDomain, SpecError, load
from streamkit.engine import build_field
from streamkit.model import NODE, Satellite

FLAT = {"kind": "tf", "v0": 210.0, "rs": 12.0, "alpha": 0.45}
EMPTY = {"kind": "kepler", "mass": 1e-6}
ORBIT = {"x": 20.0, "y": 0.0, "z": 5.0, "vx": 30.0, "vy": 200.0, "vz": 0.0}
REST = {"x": 50.0, "y": 0.0, "z": 0.0, "vx": 0.0, "vy": 1.0, "vz": 0.0}


def simulation(host, place, mass=6.4e8, lookback=0.15, body=None, **options):
    document = {
        "body": body or {},
        "seed": 3,
        "potential": host,
        "progenitor": {"kind": "plummer", "mass": mass, "radius": 0.85, "lookback": lookback, **place},
        "stripping": {"kind": "mlcs", "sigma": 10.0},
    }
    return Simulation.of(load(document), Options(**{"particles": 1000, **options}))


def states(run):
    result = [run.start()]
    while result[-1].record < run.plan.records:
        result.append(run.advance(result[-1]))
    return result


def test_a_body_that_flies_past_the_stream_is_refused():
    """It has no place today, and without it the simulation would be another one than that of the run file."""
    met = {"frame": "GD1Koposov10", "phi1": 0, "time": 0.1, "impact_parameter": 0.02, "angle": 0, "v_parallel": 0,
           "v_perpendicular": 100}  # fmt: skip
    with pytest.raises(SpecError, match=r"body\.clump\.encounter: .* give the body its place today"):
        simulation(FLAT, ORBIT, body={"clump": {"kind": "plummer", "mass": 1e7, "radius": 0.02, "encounter": met}})


@pytest.fixture(scope="module")
def isolated():
    run = simulation(EMPTY, REST)
    return run, states(run)


@pytest.fixture(scope="module")
def disrupted():
    run = simulation(FLAT, ORBIT, mass=5e7)
    return run, states(run)


def test_an_isolated_satellite_stays_in_equilibrium(isolated):
    """0.15 Gyr are ten dynamical times. Noise of 1000 particles: 3 % in the energies, 3 % in the radius."""
    run, result = isolated
    for state in result[::5]:
        q, v = state.q - state.q.mean(axis=1, keepdims=True), state.v - state.v.mean(axis=1, keepdims=True)
        outcome, _ = run.gravity.forces_and_potential(q)
        kinetic, virial = 0.5 * (v**2).sum(), (q * outcome).sum()
        assert -2 * kinetic / virial == pytest.approx(1.0, abs=0.1)
        half = np.median(np.sqrt((q**2).sum(axis=0)))
        assert half == pytest.approx(0.85 / np.sqrt(2 ** (2 / 3) - 1), rel=0.1)
        assert state.bound.mean() > 0.98


def test_energy_and_momenta_of_an_isolated_satellite(isolated):
    _, result = isolated
    first, last = result[0], result[-1]
    assert last.energy_error < 1e-3
    assert last.v.sum(axis=1) == pytest.approx(first.v.sum(axis=1), rel=1e-7)
    before, after = (np.cross(s.q.T, s.v.T).sum(axis=0) for s in (first, last))
    assert after == pytest.approx(before, rel=1e-9, abs=1e-9 * np.abs(before).max())


def test_energy_and_angular_momentum_in_a_spherical_host(disrupted):
    _, result = disrupted
    energy = result[-1].track.energy
    assert np.abs(energy / energy[0] - 1).max() < 1e-4
    before, after = (np.cross(s.q.T, s.v.T).sum(axis=0) for s in (result[0], result[-1]))
    assert after == pytest.approx(before, rel=1e-9)


def test_the_energy_at_the_start_is_that_of_a_plummer_sphere_on_its_orbit(disrupted):
    """Binding energy 3 pi / 64 G M^2 / a, less by the softening; the rest is that of a point mass, and the tide."""
    run, result = disrupted
    inputs, place, motion = run.inputs, run.orbit.q[:, 0], run.orbit.v[:, 0]
    assert result[0].binding == pytest.approx(3 * np.pi / 64 * 4.300917270e-6 * 5e7**2 / 0.85, rel=0.1)
    host = inputs.potentials["potential"]
    point = inputs.mass * (0.5 * motion @ motion + host.potential(*place, 0.0, *host.in_engine_units()))
    assert result[0].track.energy[0] == pytest.approx(point, rel=2e-3)


def test_massless_particles_follow_the_engine():
    """Positions, and the winding from the engine's finely sampled orbit; a leapfrog of 1 Myr is good to 1e-3 kpc."""
    run = simulation(FLAT, ORBIT, mass=1e-3, particles=100, lookback=0.8, step=0.001)
    first, *_, last = states(run)
    host = build_field(list(run.inputs.potentials.values()))
    winding = last.winding(run.plane)
    progenitor = host.orbit(run.orbit.q[:, 0].copy(), run.orbit.v[:, 0].copy(), 0.0, run.plan.span, NODE)
    for i in range(5):
        orbit = host.orbit(first.q[:, i].copy(), first.v[:, i].copy(), 0.0, run.plan.span, NODE)
        assert last.q[:, i] == pytest.approx(orbit.q[:, -1], abs=2e-3)
        swept = [np.unwrap(np.arctan2(*(run.plane @ o.q)[::-1])) for o in (orbit, progenitor)]
        assert winding[i] == pytest.approx(swept[0][-1] - swept[1][-1], abs=1e-3)


def test_massless_particles_feel_the_bodies_that_pull_the_host():
    """As the model's own field has them: a cloud that passes, and the Milky Way pulled by it."""
    cloud = {"kind": "plummer", "mass": 1e11, "radius": 5.0, "x": 40.0, "y": 0.0, "z": 30.0}
    bodies = {"cloud": cloud | {"vx": 0.0, "vy": 200.0, "vz": 100.0}}
    run = simulation(FLAT, ORBIT, body=bodies, mass=1e-3, particles=100, lookback=0.3, step=0.001)
    first, *_, last = states(run)
    assert np.isnan(last.track.energy).all()
    field = run.host.until(-run.plan.span)
    still = build_field(list(run.inputs.potentials.values()))
    for i in range(5):
        start = first.q[:, i].copy(), first.v[:, i].copy(), -run.plan.span, 0.0, NODE
        assert last.q[:, i] == pytest.approx(field.orbit(*start).q[:, -1], abs=2e-3)
        assert np.abs(last.q[:, i] - still.orbit(*start).q[:, -1]).max() > 0.5


def test_the_satellite_without_mass_is_followed_as_a_point():
    """Unbound from the start: its place is the host's orbit, which ends at the run file's place."""
    run = simulation(FLAT, ORBIT, mass=1e-3, particles=100, lookback=0.3)
    last = states(run)[-1]
    assert last.track.mass[-1] == last.track.r_tidal[-1] == 0.0
    assert last.track.q[:, -1] == pytest.approx(run.inputs.q, abs=0.5)  # from the mean of the 100, not the orbit itself


def test_a_particle_is_stripped_between_the_last_record_inside_and_the_next(disrupted):
    _, result = disrupted
    gap, times = np.array([s.gap for s in result]), result[-1].track.t
    last = len(result) - 1 - np.argmax(gap[::-1] <= 0, axis=0)
    ever = (gap <= 0).any(axis=0)
    stripped = ever & (last < len(result) - 1)
    assert stripped.sum() > 50
    t = result[-1].t_strip
    assert (t[stripped] >= times[last[stripped]]).all()
    assert (t[stripped] < times[last[stripped] + 1]).all()
    assert (t[ever & ~stripped] == times[-1]).all()


def test_bound_mass_falls_and_the_tidal_radius_follows_it(disrupted):
    """At an apse Omega = v / r, and d2Phi/dr2 = -(v_c^2 / r^2) [1 + alpha r^2 / (rs^2 + r^2)]."""
    _, result = disrupted
    track = result[-1].track
    assert track.mass[-1] < track.mass[0]
    k = np.argmin(np.abs((track.q * track.v).sum(axis=0)))  # an apse
    r, v = (np.sqrt((x[:, k] ** 2).sum()) for x in (track.q, track.v))
    circular2 = 210.0**2 * 12**0.45 * (144 + r**2) ** -0.225
    second = -circular2 / r**2 * (1 + 0.45 * r**2 / (144 + r**2))
    expected = np.cbrt(4.300917270e-6 * track.mass[k] / (v**2 / r**2 - second))
    assert track.r_tidal[k] == pytest.approx(expected, rel=0.01)


def test_the_tidal_radius_is_that_of_the_stream_model(disrupted):
    """Both say that the satellite is stripped at the same radius: on the same track, by one formula."""
    run, result = disrupted
    satellite = Satellite(run.inputs.satellite, run.inputs.mass)
    start = satellite.tidal_radius(run.host.tidal_bracket(run.orbit))[0]
    assert result[-1].track.r_tidal[0] == pytest.approx(start, rel=1e-12)


def test_a_host_whose_tide_has_no_radius():
    """Deep in the core of a host the force grows with the radius: slower than a circle, Omega^2 < d2Phi/dr2."""
    host = {"kind": "plummer", "mass": 1e13, "radius": 300.0}
    run = simulation(host, {**ORBIT, "vx": 0.0, "vy": 10.0}, lookback=0.05)
    radius = states(run)[-1].track.r_tidal
    assert (radius == np.sqrt((run.orbit.q[:, 0] ** 2).sum())).all()


def test_crossings_of_the_branch_complete_the_angle():
    before, after = np.array([3.1, -3.1, 0.2, -0.1]), np.array([-3.1, 3.1, -0.1, 0.2])
    assert _crossings(before, after).tolist() == [1, -1, 0, 0]


def test_the_step_and_the_softening_follow_the_stated_rules():
    run = simulation(FLAT, ORBIT, particles=20000)
    plan = run.plan
    assert plan.softening**-3 == pytest.approx(3 * 20000 / (4 * np.pi * 0.85**3))
    speed = np.sqrt(3 * np.pi / 32 * 4.300917270e-6 * 6.4e8 / 0.85)
    assert 0.4 * plan.softening < speed * plan.step < 0.5 * plan.softening
    assert plan.step * plan.steps * plan.records == pytest.approx(0.15 * GYR)


def satellite(**progenitor):
    document = {
        "seed": 3,
        "potential": EMPTY,
        "progenitor": {"lookback": 0.15, **progenitor, **REST},
        "stripping": {"kind": "mlcs", "sigma": 10.0},
    }
    return Simulation.of(load(document), Options(particles=2000))


def test_a_cuspy_satellite_is_in_equilibrium():
    """M(r) = M r^2 / (r + a)^2, cut at 20 a; the virial ratio is 1, and stays so for ten dynamical times."""
    run = satellite(kind="hernquist", mass=1e9, a=1.0)
    begin, *_, end = states(run)
    inside = (20 / 21) ** 2
    assert run.gravity.mass * 2000 == pytest.approx(1e9 * inside, rel=1e-3)
    r = np.sqrt(((begin.q - begin.track.q) ** 2).sum(axis=0))
    assert kstest((r / (r + 1)) ** 2 / inside, "uniform").pvalue > 0.01
    for state in (begin, end):
        q, v = (x - x[:, state.bound].mean(axis=1, keepdims=True) for x in (state.q, state.v))
        force = run.gravity.forces(state.q)
        assert (v**2).sum() / -(q * force).sum() == pytest.approx(1.0, abs=0.1)
        assert np.median(np.sqrt((q**2).sum(axis=0))) == pytest.approx(np.median(r), rel=0.1)


@pytest.mark.parametrize(
    ("progenitor", "message"),
    [
        ({"kind": "nfw", "mass": 1e9, "rs": 1.0}, "has an infinite mass"),
        ({"kind": "miyamoto_nagai", "mass": 1e9, "a": 1.0, "b": 0.3}, "no sphere"),
    ],
)
def test_a_progenitor_without_an_equilibrium_is_refused(progenitor, message):
    with pytest.raises(OutOfDomain, match=message):
        satellite(**progenitor)


def test_a_satellite_at_the_centre_of_a_point_mass_is_a_message():
    with pytest.raises(OutOfDomain, match="not finite"):
        simulation({"kind": "kepler", "mass": 1e12}, dict.fromkeys(ORBIT, 0.0))
