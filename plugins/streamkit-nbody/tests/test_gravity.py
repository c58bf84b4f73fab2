"""The particles' own gravity: kernel, direct sum, tree; and who is bound."""

import numpy as np
import pytest
from streamkit_nbody import gravity
from streamkit_nbody.binding import remnant
from streamkit_nbody.gravity import DIRECT, PAIRS, Gravity, NotFinite
from streamkit_nbody.plan import Options
from streamkit_nbody.plummer import sample
from streamkit_nbody.simulation import Simulation

from streamkit import G, load

MASS, RADIUS = 6.4e8, 0.85


def direct(q, mass):
    """Accelerations (3, n) and potentials (n,) by Newton's law, every pair."""
    away = q[:, None, :] - q[:, :, None]
    r = np.sqrt((away**2).sum(axis=0))
    np.fill_diagonal(r, np.inf)
    return G * mass * (away / r**3).sum(axis=2), -G * mass * (1 / r).sum(axis=1)


def test_a_pair_beyond_the_softening_follows_newton():
    q = np.array([[0.0, 3.0], [0.0, 0.0], [0.0, 0.0]])
    a, potential = Gravity(1e6, 1.0, 0.7).forces_and_potential(q)  # 3 kpc are more than 2.8 softening lengths
    assert a[0] == pytest.approx([G * 1e6 / 9, -G * 1e6 / 9])
    assert potential == pytest.approx([-G * 1e6 / 3] * 2)


def test_the_softening_is_plummer_equivalent():
    """At no distance the potential is that of a Plummer sphere of the softening length: -G m / softening."""
    q = np.array([[0.0, 1e-9], [0.0, 0.0], [0.0, 0.0]])
    a, potential = Gravity(1e6, 0.5, 0.7).forces_and_potential(q)
    assert potential == pytest.approx([-G * 1e6 / 0.5] * 2)
    assert np.abs(a).max() < 1e-3


# Every process compiles the tree anew, which takes up to a minute whatever the number of particles.
TREE = pytest.mark.slow


@pytest.fixture
def with_tree(monkeypatch):
    """The tree for few particles, too."""
    monkeypatch.setattr(gravity, "PAIRS", DIRECT)


def errors(n, offset=0.0):
    """Errors of accelerations and potentials of n particles, and whether they have a net force."""
    q, _ = sample(n, MASS, RADIUS, np.random.default_rng(2))
    exact, potential = direct(q, MASS / n)
    found, own = Gravity(MASS / n, 1e-7, 0.7).forces_and_potential(q + offset)
    size = np.sqrt((exact**2).sum(axis=0))
    error = np.sqrt(((found - exact) ** 2).sum(axis=0)) / size
    assert np.abs(found.sum(axis=1)).max() < 1e-9 * size.sum()
    return np.sqrt((error**2).mean()), np.abs(own / potential - 1).max()


def test_against_a_direct_sum():
    assert max(errors(DIRECT)) < 1e-10


@pytest.mark.parametrize("offset", [0.0, 100.0])
def test_single_precision_against_a_direct_sum(offset):
    """Wherever the satellite is: 100 kpc have a spacing of 8e-6 kpc in single precision."""
    assert max(errors(DIRECT + 1, offset)) < 1e-5


@TREE
@pytest.mark.usefixtures("with_tree")
def test_the_tree_against_a_direct_sum():
    a, potential = errors(DIRECT + 1)
    assert a < 2e-3
    assert potential < 5e-3


def test_the_softened_force_is_that_of_few_particles():
    """Two codes of the same spline: with a long softening most pairs are inside its support."""
    q, _ = sample(DIRECT, MASS, RADIUS, np.random.default_rng(2))
    own = Gravity(MASS / DIRECT, 0.5, 0.7)
    exact, potential = own.forces_and_potential(q)
    single = own._over_pairs(q, accel=True, potential=True)
    away = np.sqrt(((single["accel"].T - exact) ** 2).sum(axis=0) / (exact**2).sum(axis=0))
    assert np.sqrt((away**2).mean()) < 1e-5
    assert single["potential"] == pytest.approx(potential, rel=1e-5)


@TREE
@pytest.mark.usefixtures("with_tree")
def test_energy_with_the_tree():
    """Of a satellite in a host."""
    document = {
        "seed": 3,
        "potential": {"kind": "tf", "v0": 210.0, "rs": 12.0, "alpha": 0.45},
        "progenitor": {
            "kind": "plummer", "mass": MASS, "radius": RADIUS, "lookback": 0.1,
            "x": 20.0, "y": 0.0, "z": 5.0, "vx": 30.0, "vy": 200.0, "vz": 0.0,
        },
        "stripping": {"kind": "mlcs", "sigma": 10.0},
    }  # fmt: skip
    run = Simulation.of(load(document), Options(particles=DIRECT + 1))
    state = run.start()
    while state.record < run.plan.records:
        state = run.advance(state)
    assert state.energy_error < 1e-3


@pytest.mark.parametrize("most", [PAIRS, pytest.param(DIRECT, marks=TREE)])
def test_threads_do_not_change_a_bit(most, monkeypatch):
    monkeypatch.setattr(gravity, "PAIRS", most)
    q, _ = sample(2 * DIRECT, MASS, RADIUS, np.random.default_rng(3))
    one, two = (Gravity(1e4, 0.05, 0.7, workers).forces_and_potential(q) for workers in (1, 2))
    assert np.array_equal(one[0], two[0])
    assert np.array_equal(one[1], two[1])


def test_positions_that_are_not_finite_are_named():
    q = np.zeros((3, 5))
    q[1, 3] = np.nan
    with pytest.raises(NotFinite, match="1 of 5 particles"):
        Gravity(1.0, 0.1, 0.7).forces(q)


def test_the_bound_part_is_the_satellite_without_what_flies_through_or_is_far():
    n = 600
    q, v = sample(n, MASS, RADIUS, np.random.default_rng(4))
    rng = np.random.default_rng(5)
    fast_q, fast_v = 0.3 * rng.standard_normal((3, 60)), 100 * np.ones((3, 60))  # escape speed: 80 km/s
    far_q = np.array([[60.0], [0.0], [0.0]]) + rng.standard_normal((3, 60))
    far_v = np.array([[0.0], [30.0], [0.0]]) * np.ones((3, 60))  # 10 would do to escape
    place, motion = np.array([40.0, -20.0, 10.0]), np.array([100.0, 50.0, -200.0])
    q = np.concatenate([q, fast_q, far_q], axis=1) + place[:, None]
    v = np.concatenate([v, fast_v, far_v], axis=1) + motion[:, None]
    found = remnant(Gravity(MASS / n, 0.1, 0.7), q, v, np.ones(n + 120, dtype=bool))
    assert not found.bound[n:].any()
    assert found.bound[:n].mean() > 0.99
    assert found.q == pytest.approx(place, abs=0.15)  # 300 particles of 0.85 kpc and 23 km/s
    assert found.v == pytest.approx(motion, abs=4.0)


def test_nothing_is_left_of_particles_that_are_too_hot():
    q, v = sample(300, MASS, RADIUS, np.random.default_rng(6))
    assert remnant(Gravity(MASS / 300, 0.1, 0.7), q, 10 * v, np.ones(300, dtype=bool)) is None
