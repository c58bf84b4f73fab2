"""Spherical harmonics with radial splines, against potentials in closed form."""

import numpy as np
import pytest

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import Hernquist, MiyamotoNagai
from streamkit.builtin.potentials.halos import LogarithmicHalo, NFWEllipsoidal, NFWTriaxial
from streamkit.expansion.harmonics import at_directions, names, quadrature

TRIAXIAL = NFWTriaxial(mass=3.6e11, rs=16.0, p=0.8, q=0.9, phi=25.0)


def positions(n=300, low=0.1, high=300.0):
    rng = np.random.default_rng(8)
    direction = rng.standard_normal((3, n))
    return direction / np.sqrt((direction**2).sum(axis=0)) * np.exp(rng.uniform(np.log(low), np.log(high), n))


def series(**options):
    table = sk.multipole_table(**options)
    return sk.Multipoles(table["l"], table["m"], table["r"], table["phi"])


def of(potential):
    values = potential.in_engine_units()
    return lambda x, y, z: type(potential).potential(x, y, z, 0.0, *values)


def errors(found, potential, q):
    exact = np.stack(type(potential).acceleration(*q, 0.0, *potential.in_engine_units()))
    ours = np.stack(found.acceleration(*q))
    return np.sqrt(((ours - exact) ** 2).sum(axis=0) / (exact**2).sum(axis=0))


def test_the_harmonics_are_orthonormal():
    harmonics = names(7, 7)
    directions, weights = quadrature(7, 7)
    values = at_directions(harmonics, directions)
    assert np.allclose((values * weights) @ values.T, np.eye(64), atol=1e-12)


def test_a_sphere_and_its_convergence_with_the_nodes():
    sphere = Hernquist(mass=1e11, a=4.0)
    worst = [
        errors(series(potential=of(sphere), l_max=0, radii=np.geomspace(0.01, 1000, k)), sphere, positions()).max()
        for k in (41, 81, 161)
    ]
    assert worst[2] < worst[1] / 6 < worst[0] / 36 < 1e-3
    assert np.allclose(
        series(potential=of(sphere), l_max=2).potential(*positions()), of(sphere)(*positions()), rtol=1e-4
    )


@pytest.mark.parametrize(
    ("potential", "options"),
    [(LogarithmicHalo(v0=220.0, rc=1.0, q=0.85), {"m_max": 0}), (TRIAXIAL, {})],
    ids=["flattened log", "turned triaxial"],
)
def test_convergence_with_the_degree(potential, options):
    q = positions()
    worst = [errors(series(potential=of(potential), l_max=n, **options), potential, q).max() for n in (2, 4, 8)]
    assert worst[2] < worst[1] / 8 < worst[0] / 64
    assert worst[2] < 1e-4


def test_a_density_gives_the_potential_of_its_mass():
    ellipsoid = NFWEllipsoidal(mass=3.6e11, rs=16.0, p=0.9, q=0.8)

    def density(x, y, z):
        r = np.sqrt(x * x + (y / 0.9) ** 2 + (z / 0.8) ** 2)
        return 3.6e11 / (4 * np.pi * r * (r + 16.0) ** 2)

    result = series(density=density, l_max=8, even=True, radii=np.geomspace(0.01, 1e4, 141))
    assert errors(result, ellipsoid, positions(high=100.0)).max() < 1e-3


def test_a_disc_thick_enough_for_its_degree():
    disc = MiyamotoNagai(mass=6.8e10, a=3.0, b=3.0)
    result = series(potential=of(disc), l_max=24, m_max=0, even=True)
    assert errors(result, disc, positions(low=3.0, high=30.0)).max() < 2e-3


def test_the_acceleration_is_minus_the_gradient_beyond_the_ends_too():
    result = series(potential=of(TRIAXIAL), l_max=4, radii=np.geomspace(1.0, 100.0, 40))
    for q in (positions(50, 0.1, 1.0), positions(50, 1.0, 100.0), positions(50, 100.0, 1e4)):
        h = 1e-5 * np.sqrt((q**2).sum(axis=0))
        exact = np.stack(result.acceleration(*q))
        for k in range(3):
            step = h * np.eye(3)[:, k : k + 1]
            slope = (result.potential(*(q + step)) - result.potential(*(q - step))) / (2 * h)
            assert np.allclose(-slope, exact[k], atol=1e-6 * np.sqrt((exact**2).sum(axis=0)))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t[t["l"] > 0], "no rows with l = 0"),
        (lambda t: t[:-1], "expected each of the 6 pairs"),
        (lambda t: t[t["r"] < 0.013], "expected four or more"),
        (lambda t: (t.replace_column("m", t["m"] + 1), t)[1], r"\|m\| <= l"),
    ],
)
def test_what_is_no_table_of_multipoles(change, said):
    table = change(sk.multipole_table(potential=of(TRIAXIAL), l_max=4, even=True))
    with pytest.raises(ValueError, match=said):
        sk.Multipoles(table["l"], table["m"], table["r"], table["phi"])


def test_a_table_is_of_one_or_the_other():
    with pytest.raises(ValueError, match="either a potential or a density"):
        sk.multipole_table()
