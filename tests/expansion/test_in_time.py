"""Expansions of forces that change in time: against closed forms, between the times, in every lane."""

import time

import numpy as np
import pytest
from runfiles import FIT
from scipy.integrate import solve_ivp

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import MiyamotoNagai, Plummer
from streamkit.builtin.potentials.multipole import Multipole
from streamkit.engine import build_field
from streamkit.expansion import Grid, NoExpansion, expand, expansion_in_time, expansion_of

RADII = np.geomspace(0.01, 1000, 200)  # kpc
SPHERE, FLAT, ROUND = Grid(60), Grid(60, 13), Grid(40, 7, 5, sines=True)


def growing(t):
    """A Plummer sphere that doubles its mass and spreads."""
    return Plummer(mass=1e11 * (2 + np.sin(0.8 * t)), radius=8 - 0.5 * t)


def disc(t):
    return MiyamotoNagai(mass=5e10 * (2 + np.sin(0.8 * t)), a=4 - 0.2 * t, b=2.0)


def force_of(shape):
    def force(t, q):
        return np.concatenate([
            build_field([shape(float(now))]).acceleration(0.0, point[:, None])
            for now, point in zip(np.broadcast_to(t, q.shape[1]), q.T, strict=True)
        ], axis=1) if np.ndim(t) else build_field([shape(t)]).acceleration(0.0, q)  # fmt: skip

    return force


def positions(n=100, low=1.0, high=100.0):
    rng = np.random.default_rng(6)
    direction = rng.standard_normal((3, n))
    return direction / np.sqrt((direction**2).sum(axis=0)) * np.exp(rng.uniform(np.log(low), np.log(high), n))


def made(shape, grid, times):
    force, q = force_of(shape), grid.positions()
    return build_field([expansion_in_time(grid, times, [force(t, q) for t in times])])


def largest(a, b):
    return (np.sqrt(((a - b) ** 2).sum(axis=0)) / np.sqrt((b**2).sum(axis=0))).max()


@pytest.mark.parametrize(("shape", "grid"), [(growing, SPHERE), (disc, FLAT)], ids=["sphere", "disc"])
def test_between_its_times_it_converges_with_the_fourth_power_of_their_number(shape, grid):
    q, nodes, worst = positions(), grid.positions(), []
    for count in (9, 17, 33):
        field, times = made(shape, grid, np.linspace(-6, 0, count)), np.linspace(-6, 0, 49)
        still = [build_field([expansion_of(grid, force_of(shape)(t, nodes))]).acceleration(0.0, q) for t in times]
        worst.append(max(largest(field.acceleration(t, q), a) for t, a in zip(times, still, strict=True)))
    assert worst[0] < 3e-3
    assert worst[0] / worst[1] > 10
    assert worst[1] / worst[2] > 10


@pytest.mark.parametrize(("count", "power"), [(2, 1), (3, 2), (4, 3), (7, 3)])
def test_uneven_times_hold_a_polynomial_as_high_as_they_allow(count, power):
    """A force with a factor that is a polynomial of time; constant outside the times."""
    times = np.array([-5.0, -4.7, -2.0, -1.9, -1.0, -0.3, 0.0])[-count:]
    force, q = force_of(growing), positions()
    base = force(0.0, SPHERE.positions())
    field = build_field([expansion_in_time(SPHERE, times, [(2 + 0.1 * t**power) * base for t in times])])
    today = build_field([expansion_of(SPHERE, base)]).acceleration(0.0, q)
    for t in (times[0] - 1, times[0], *np.linspace(times[0], 0, 11)[1:], 2.0):
        inside = min(max(t, times[0]), 0.0)
        np.testing.assert_allclose(field.acceleration(t, q), (2 + 0.1 * inside**power) * today, rtol=1e-11)


@pytest.mark.parametrize("n", [1, 3, 33, 4500])
@pytest.mark.parametrize("grid", [SPHERE, ROUND], ids=["sphere", "general"])
def test_every_lane_has_its_own_time(grid, n):
    field, q = made(growing, grid, np.linspace(-6, 0, 9)), positions(n)
    times = np.linspace(-6.5, 0.5, 7)[np.arange(n) // 2 % 7]
    mixed = field.acceleration(times, q)
    for t in np.unique(times):
        assert np.array_equal(mixed[:, times == t], field.acceleration(t, q)[:, times == t])
    one = np.concatenate([field.acceleration(t, q[:, [i]]) for i, t in enumerate(times[:40])], axis=1)
    assert np.array_equal(mixed[:, :40], one)


def test_one_that_does_not_change_is_the_static_one():
    base, q = force_of(growing)(0.0, ROUND.positions()), positions(500, 0.005, 3000.0)
    static = build_field([expansion_of(ROUND, base)]).acceleration(0.0, q)
    changing = build_field([expansion_in_time(ROUND, np.linspace(-6, 0, 5), [base] * 5)])
    np.testing.assert_allclose(changing.acceleration(-1.234, q), static, rtol=1e-10, atol=1e-10 * np.abs(static).max())


def test_it_is_expanded_at_given_times_or_refused():
    times = np.linspace(-6, 0, 25)
    expanded = expand(force_of(growing), "auto", 1e-4, times)
    assert expanded.grid.form == "spherical"
    assert "25 times" in expanded.text()
    with pytest.raises(NoExpansion, match="between its 4 times it misses the tolerance"):
        expand(force_of(growing), "auto", 1e-4, np.linspace(-6, 0, 4))
    with pytest.raises(NoExpansion, match="changes in time, and has no `known_times`"):
        expand(force_of(growing), "auto", 1e-4)


def table(count=33):
    def density(x, y, z, t):
        p = growing(t * sk.GYR)
        return 3 * p.mass / (4 * np.pi * p.radius**3) * (1 + (x**2 + y**2 + z**2) / p.radius**2) ** -2.5

    made_of = sk.multipole_table(density=density, l_max=0, times=np.linspace(-6, 0, count), radii=RADII)
    return {name: np.asarray(made_of[name], dtype=float).tolist() for name in made_of.colnames}


def test_an_orbit_in_a_growing_sphere_is_that_of_scipy():
    host, state = Multipole(table=table()), np.array([15.0, 2.0, 6.0, -30.0, 120.0, 60.0])

    def motion(t, y):
        return [*y[3:], *build_field([growing(t)]).acceleration(0.0, y[:3, None])[:, 0]]

    exact = solve_ivp(motion, (0.0, -5.0), state, rtol=1e-10, atol=1e-10).y[:3, -1]
    orbit = build_field([host]).orbit(state[:3], state[3:], 0.0, -5.0, 0.002)
    still = build_field([growing(0.0)]).orbit(state[:3], state[3:], 0.0, -5.0, 0.002)
    assert np.abs(orbit.q[:, 0] - exact).max() < 0.01
    assert np.abs(still.q[:, 0] - exact).max() > 1.0  # kpc: the growth matters


def test_its_python_object_is_the_sphere_between_the_times():
    columns = table()
    arrays = [np.array(columns[name]) for name in ("l", "m", "r", "phi")]
    sphere, q = sk.Multipoles(*arrays, time=np.array(columns["t"]) * sk.GYR), positions()
    times = np.linspace(-5.9, -0.1, q.shape[1])
    exact = force_of(growing)(times, q)
    assert largest(np.stack(sphere.acceleration(*q, times)), exact) < 1e-3
    h = 1e-4
    slope = [(sphere.potential(*(q + h * e[:, None]), times) - sphere.potential(*(q - h * e[:, None]), times)) / (2 * h)
             for e in np.eye(3)]  # fmt: skip
    assert largest(-np.stack(slope), np.stack(sphere.acceleration(*q, times))) < 1e-5
    with pytest.raises(ValueError, match="once at each of the 200 radii and 33 times"):
        sk.Multipoles(*(a[:-1] for a in arrays), time=np.array(columns["t"][:-1]))


def run(lookback, count=9):
    progenitor = FIT["progenitor"] | {"lookback": lookback}
    return {**FIT, "potential": {"kind": "multipole", "table": table(count)}, "progenitor": progenitor,
            "sampler": {}}  # fmt: skip


def test_a_run_file_must_be_covered_by_the_table():
    assert sk.load(run(5.9))
    with pytest.raises(
        sk.SpecError, match=r"the multipole is known from -6 to 0 Gyr; expected all times from"
    ):
        sk.load(run(6.1))


@pytest.mark.slow
def test_along_a_stream_it_costs_at_most_twice_the_static_expansion():
    """Measured in alternation, for particles along an orbit and with many orders."""
    grid, n = Grid(75, 17, 9, sines=True), 4000
    base = force_of(growing)(0.0, grid.positions())
    static = build_field([expansion_of(grid, base)])
    changing = build_field([expansion_in_time(grid, np.linspace(-6, 0, 33), [base] * 33)])
    angle = np.linspace(0, 1.2, n)
    r = 18 + 4 * np.sin(3 * angle)
    q = np.stack([r * np.cos(angle), 0.8 * r * np.sin(angle), 0.6 * r * np.sin(angle)])
    q += 0.1 * np.random.default_rng(1).standard_normal(q.shape)
    ratios = []
    for _ in range(40):
        spent = []
        for field in (static, changing):
            begin = time.perf_counter()
            for _ in range(10):
                field.acceleration(-2.2, q)
            spent.append(time.perf_counter() - begin)
        ratios.append(spent[1] / spent[0])
    assert np.median(ratios) < 2.0


def test_streams_by_every_integrator_agree_and_are_not_those_of_a_host_at_rest():
    """Release at many times (lanes of their own times), blocks, and the reference integrator."""
    places = {}
    for kind in ({"kind": "adaptive"}, {"kind": "leapfrog", "step": 0.002}, {"kind": "dop853"}):
        places[kind["kind"]] = sk.Model(sk.load(run(2.0, 17) | {"integrator": kind})).stream().q
    scale = np.abs(places["dop853"]).max()
    assert np.abs(places["adaptive"] - places["dop853"]).max() < 1e-3 * scale
    assert np.abs(places["leapfrog"] - places["dop853"]).max() < 1e-2 * scale
    still = run(2.0, 17)
    today = np.array(still["potential"]["table"]["t"]) == 0.0
    still["potential"]["table"] = {
        name: np.array(column)[today].tolist() for name, column in still["potential"]["table"].items() if name != "t"
    }
    assert np.abs(sk.Model(sk.load(still)).stream().q - places["dop853"]).max() > 0.1 * scale
