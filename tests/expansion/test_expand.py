"""Expansions against the potentials that they stand for, and against what is conserved."""

import numpy as np
import pytest
from pydantic import Field
from scipy.interpolate import CubicSpline

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import NFW, Hernquist, Kepler, MiyamotoNagai, Plummer
from streamkit.builtin.potentials.halos import LogarithmicHalo, NFWTriaxial
from streamkit.engine import build_field
from streamkit.expansion import Grid, NoExpansion, expand, expand_like, expansion_of
from streamkit.expansion.symmetry import symmetry_of

HALO = NFW(mass=3.6e11, rs=16.0)
DISC = MiyamotoNagai(mass=6.8e10, a=3.0, b=0.28)
GALAXY = (HALO, DISC, Hernquist(mass=5e9, a=1.0))
TRIAXIAL = NFWTriaxial(mass=3.6e11, rs=16.0, p=0.8, q=0.9)
NEARLY_ROUND = NFWTriaxial(mass=3.6e11, rs=16.0, p=0.98, q=0.99)
TURNED = NFWTriaxial(mass=3.6e11, rs=16.0, p=0.8, q=0.9, phi=20.0)


def force_of(*potentials):
    return build_field(potentials).acceleration


def positions(n=400, low=0.1, high=500.0, seed=5):
    rng = np.random.default_rng(seed)
    direction = rng.standard_normal((3, n))
    return direction / np.sqrt((direction**2).sum(axis=0)) * np.exp(rng.uniform(np.log(low), np.log(high), n))


def errors(expansion, force, q):
    exact = force(0.0, q)
    result = build_field([expansion]).acceleration(0.0, q)
    return np.sqrt(((result - exact) ** 2).sum(axis=0) / (exact**2).sum(axis=0))


def test_a_sphere_converges_with_the_fourth_power_of_the_nodes():
    force, q = force_of(Hernquist(mass=1e10, a=0.5)), positions()
    worst = []
    for radii in (51, 101, 201):
        grid = Grid(radii)
        worst.append(errors(expansion_of(grid, force(0.0, grid.positions())), force, q).max())
    assert worst[1] < worst[0] / 12 < worst[0] < 3e-5
    assert worst[2] < worst[1] / 12


@pytest.mark.parametrize(
    ("potentials", "form", "tolerance"),
    [
        pytest.param((HALO,), "spherical", 1e-4, id="sphere"),
        pytest.param(GALAXY, "axisymmetric", 1e-4, id="galaxy"),
        pytest.param((LogarithmicHalo(v0=220.0, rc=1.0, q=0.8),), "axisymmetric", 1e-4, id="flattened log"),
        pytest.param((NEARLY_ROUND,), "general", 3e-3, id="nearly round"),  # every order more is compiled for seconds
        pytest.param((TRIAXIAL,), "general", 3e-3, id="triaxial, coarse", marks=pytest.mark.slow),
        pytest.param((TURNED,), "general", 3e-3, id="turned, coarse", marks=pytest.mark.slow),
        pytest.param((TRIAXIAL,), "general", 1e-4, id="triaxial", marks=pytest.mark.slow),  # minutes
        pytest.param((TURNED,), "general", 1e-4, id="turned", marks=pytest.mark.slow),
    ],
)
def test_the_form_is_found_and_the_tolerance_met_where_nobody_looked(potentials, form, tolerance):
    force = force_of(*potentials)
    expanded = expand(force, "auto", tolerance)
    assert expanded.grid.form == form
    assert expanded.error <= tolerance
    assert expanded.grid.nodes <= 20_000
    assert np.percentile(errors(expanded.force, force, positions()), 99) < tolerance


@pytest.mark.slow  # its many orders are compiled for a quarter of a minute
def test_without_any_symmetry():
    def force(t, q):
        return force_of(HALO)(t, q) + force_of(Plummer(mass=2e10, radius=15.0))(t, q - np.array([[8.0], [5.0], [3.0]]))

    expanded = expand(force, "auto", 3e-3)
    assert not expanded.grid.mirror
    assert expanded.grid.sines
    assert expanded.grid.step == 1
    assert errors(expanded.force, force, positions()).max() < 5e-3


def test_symmetries():
    symmetry = symmetry_of(force_of(*GALAXY), 1e-9)
    assert (symmetry.static, symmetry.spherical, symmetry.axisymmetric, symmetry.mirror) == (True, False, True, True)
    symmetry = symmetry_of(force_of(TURNED), 1e-9)
    assert (symmetry.axisymmetric, symmetry.mirror, symmetry.sideways, symmetry.half_turn) == (False, True, False, True)
    assert symmetry_of(force_of(TRIAXIAL), 1e-9).sideways


def test_beyond_its_ends_an_expansion_goes_on_as_a_power():
    point, core = expand(force_of(Kepler(mass=1e11)), "auto", 1e-6), Plummer(mass=1e11, radius=3.0)
    for scale in (1e-3, 1e4):
        assert errors(point.force, force_of(Kepler(mass=1e11)), positions(20, scale, scale)).max() < 1e-3
    soft = expand(force_of(core), "auto", 1e-6)
    assert errors(soft.force, force_of(core), positions(20, 1e-4, 1e-3)).max() < 1e-4
    assert errors(soft.force, force_of(core), positions(20, 3e3, 3e4)).max() < 1e-4
    assert np.array_equal(build_field([soft.force]).acceleration(0.0, np.zeros((3, 1))), np.zeros((3, 1)))


@pytest.mark.parametrize("potential", [DISC, TURNED], ids=["disc", "triaxial"])
def test_the_force_has_no_curl(potential):
    """Its own, not that of the potential: a coarse expansion conserves energy as well as a fine one."""
    force, grid = force_of(potential), Grid(40, 12, 1)
    if potential is TURNED:
        grid = Grid(40, 9, 4, step=2, sines=True)
    field = build_field([expansion_of(grid, force(0.0, grid.positions()))])
    q = positions(60, 1.0, 100.0)
    h = 1e-3 * np.sqrt((q**2).sum(axis=0))
    jacobian = np.empty((3, 3, q.shape[1]))
    for k in range(3):
        step = h * np.eye(3)[:, k : k + 1]
        jacobian[:, k] = (field.acceleration(0.0, q + step) - field.acceleration(0.0, q - step)) / (2 * h)
    curl = jacobian - jacobian.transpose(1, 0, 2)
    scale = np.sqrt((field.acceleration(0.0, q) ** 2).sum(axis=0) / (q**2).sum(axis=0))
    assert np.median(np.abs(curl).max(axis=(0, 1)) / scale) < 1e-5


def test_energy_is_conserved_on_an_orbit():
    expanded = expand(force_of(*GALAXY), "auto", 1e-4)
    orbit = build_field([expanded.force]).orbit(
        np.array([20.0, 5.0, 10.0]), np.array([30.0, 120.0, 90.0]), 0.0, -5.0, 0.001
    )
    energy = 0.5 * (orbit.v**2).sum(axis=0)
    for p in GALAXY:
        energy = energy + type(p).potential(*orbit.q, 0.0, *p.in_engine_units())
    assert np.ptp(energy) < 2e-4 * np.abs(energy).mean()


def test_the_nodes_stay_so_that_ln_p_has_no_steps():
    first = expand(force_of(HALO), "auto", 1e-4)
    rs = 16.0 + 1e-3 * np.arange(9)
    q = np.array([[7.0], [11.0], [3.0]])
    values = []
    for value in rs:
        result = expand_like(first, force_of(NFW(mass=3.6e11, rs=value)), 1e-4, "missed")
        assert result.grid == first.grid
        values.append(build_field([result.force]).acceleration(0.0, q)[0, 0])
    smooth = CubicSpline(rs[::2], values[::2])(rs[1::2])
    assert np.allclose(smooth, values[1::2], rtol=1e-10)
    with pytest.raises(sk.OutOfDomain, match="missed"):
        expand_like(first, force_of(DISC), 1e-4, "missed")


def test_what_cannot_be_expanded_says_why():
    halo = force_of(HALO)
    with pytest.raises(NoExpansion, match="changes in time"):
        expand(lambda t, q: (1 + 0.01 * t) * halo(t, q), "auto", 1e-4)
    with pytest.raises(NoExpansion, match="not finite"):
        expand(lambda t, q: np.where(np.abs(q) > 400, np.nan, halo(t, q)), "auto", 1e-4)
    with pytest.raises(NoExpansion, match=r"spherical expansion misses the tolerance 0.0001: .* take expansion"):
        expand(force_of(DISC), "spherical", 1e-4)


class Slow(sk.Potential):
    """A galaxy that numba is not asked to compile."""

    kind = "slow"
    compiled = False
    evaluation = "expansion"
    example = {"mass": 6.8e10}
    mass: sk.Mass = Field(description="Mass of the disc.")

    @staticmethod
    def acceleration(x, y, z, t, mass):
        parts = [HALO, MiyamotoNagai(mass=mass, a=3.0, b=0.28)]
        forces = [type(p).acceleration(x, y, z, t, *p.in_engine_units()) for p in parts]
        return tuple(sum(force[k] for force in forces) for k in range(3))


def test_an_uncompiled_potential_has_the_fields_and_a_compiled_one_has_not():
    assert not {"expansion", "tolerance"} & set(NFW.model_fields)
    slow = Slow(mass=6.8e10)
    assert (slow.expansion, slow.tolerance) == ("auto", 1e-4)
    assert set(slow.parameters()) == {"mass"}
    q = positions()
    exact = build_field([slow], exact=True).acceleration(0.0, q)
    result = build_field([slow]).acceleration(0.0, q)
    assert 0 < np.abs(result - exact).max() < 1e-3 * np.abs(exact).max()
    asked = Slow(mass=6.8e10, expansion="none")
    assert np.array_equal(build_field([asked]).acceleration(0.0, q), exact)


def test_a_component_may_not_take_their_names():
    with pytest.raises(sk.PluginError, match="no field of a potential may be called 'tolerance'"):

        class Named(sk.Potential):
            kind = "named"
            compiled = False
            tolerance: sk.Number

            @staticmethod
            def acceleration(x, y, z, t, tolerance):
                return x, y, z
