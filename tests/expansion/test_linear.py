"""Expansions of forces that are proportional to a field, and of perturbations whose force vanishes at some places."""

import numpy as np
import pytest
from runfiles import FIT

import streamkit as sk
from streamkit import expansion
from streamkit.builtin.potentials.multipole import Multipole
from streamkit.components.potential import Potential
from streamkit.expansion import expand

RADII = np.geomspace(0.03, 900.0, 60)
MASS, SCALE = 1e11, 8.0


def positions(n=300):
    rng = np.random.default_rng(5)
    direction = rng.standard_normal((3, n))
    return direction / np.sqrt((direction**2).sum(axis=0)) * np.geomspace(0.2, 300.0, n)


def plummer(times=(0.0,), higher=()):
    """A Plummer sphere that grows in time, with a tenth of its potential in higher degrees."""
    deep = -sk.G * MASS / np.sqrt(RADII**2 + SCALE**2)
    rows = [
        (n, m, t, (1.0 if n == 0 else 0.1 * (RADII / (RADII + SCALE)) ** n) * (1 + 0.1 * t) * deep)
        for t in times
        for n, m in ((0, 0), *higher)
    ]
    table = {name: np.repeat([row[k] for row in rows], len(RADII)) for k, name in enumerate("lmt")}
    table |= {"r": np.tile(RADII, len(rows)), "phi": np.concatenate([row[3] for row in rows])}
    if len(times) == 1:
        del table["t"]
    return {name: column.tolist() for name, column in table.items()}


def forces(potentials, q):
    """The force in the compiled loop, today and before."""
    return np.array([sk.Host(potentials).alone.acceleration(t, q) for t in (0.0, -3.3)])


def run_file(table, factor):
    potential = {"kind": "multipole", "table": table, "factor": factor, "tolerance": 1e-2}
    return sk.load({**FIT, "potential": potential})


@pytest.mark.parametrize(
    ("times", "higher"),
    [((0.0,), ()), ((0.0,), ((2, 0),)), ((0.0,), ((1, 1), (2, -2))), ((-6.0, -4.0, -3.0, 0.0), ()),
     ((-6.0, -4.0, -3.0, 0.0), ((2, 0), (1, -1)))],
    ids=["sphere", "axisymmetric", "general", "sphere in time", "general in time"],
)  # fmt: skip
def test_another_factor_scales_the_expansion(times, higher, monkeypatch):
    """As exactly as an expansion made anew, and without one."""
    table, q = plummer(times, higher), positions()
    spec = run_file(table, {"uniform": [0.5, 2.5]})  # its centre is 1.5
    anew = [forces(run_file(table, factor).host(), q) for factor in (0.6, 2.2)]
    forces(spec.host(), q)

    def refuse(*_, **__):
        raise AssertionError("it is expanded again")

    monkeypatch.setattr(expansion, "expand_like", refuse)
    for factor, exact in zip((0.6, 2.2), anew, strict=True):
        scaled = forces(spec.host({"potential.factor": factor}), q)
        np.testing.assert_allclose(scaled, exact, rtol=1e-9, atol=1e-9 * np.abs(exact).max())


def test_where_another_field_changes_too_it_is_expanded_again():
    table, q = plummer((0.0,), ((1, 1), (2, -2))), positions()
    potential = {"kind": "multipole", "table": table, "tolerance": 1e-2}
    free = potential | {"factor": {"uniform": [0.5, 2.5]}, "angle": {"uniform": ["0 deg", "90 deg"]}}
    spec = sk.load({**FIT, "potential": free})
    turned = forces(spec.host({"potential.factor": 2.0, "potential.angle": 30.0}), q)
    exact = sk.Host(sk.load({**FIT, "potential": potential | {"factor": 2.0, "angle": "30 deg"}}).host()).acceleration(
        q
    )
    assert np.sqrt(((turned - exact) ** 2).sum(axis=0) / (exact**2).sum(axis=0)).max() < 2e-2


def turning(t, q):
    """A radial force that points outwards inside 20 kpc and inwards outside: it vanishes there."""
    r = np.sqrt((q**2).sum(axis=0))
    return q / r * 1e3 * np.log(20.0 / r) / (1 + (r / 20.0) ** 2)


def test_the_error_of_a_perturbation_is_relative_to_its_force_at_about_the_radius():
    """Where it vanishes a relative error is large, and costs nodes; that it is small elsewhere is checked here."""
    made, strict = (expand(turning, "auto", 1e-3, vanishes=vanishes) for vanishes in (True, False))
    assert made.error < 1e-3
    assert made.grid.nodes < 0.7 * strict.grid.nodes
    q = positions(2000)
    r, exact = np.sqrt((q**2).sum(axis=0)), turning(0.0, q)
    off = np.sqrt(((sk.engine.build_field([made.force]).acceleration(0.0, q) - exact) ** 2).sum(axis=0))
    for low, high in ((1, 5), (5, 10), (10, 40), (40, 200)):
        there = (r > low) & (r < high)
        assert off[there].max() < 2e-3 * np.sqrt((exact[:, there] ** 2).sum(axis=0).mean())


def test_a_known_order_leaves_out_harmonics():
    """A dipole in the plane has m = 1 alone: the same force with fewer nodes."""
    table = plummer((0.0,), ((1, 1),))
    multipoles = sk.Multipoles(*(np.array(table[name]) for name in ("l", "m", "r", "phi")))

    def force(t, q):
        return np.array(multipoles.acceleration(*q))

    known, unknown = (expand(force, "auto", 1e-2, order=order) for order in (1, None))
    assert known.grid.orders == [0, 1]
    assert known.grid.nodes < 0.7 * unknown.grid.nodes
    q = positions()
    made, exact = sk.engine.build_field([known.force]).acceleration(0.0, q), force(0.0, q)
    assert np.sqrt(((made - exact) ** 2).sum(axis=0) / (exact**2).sum(axis=0)).max() < 2e-2


def test_hosts_are_no_perturbations():
    assert not Potential.vanishes
    assert not Multipole.vanishes
