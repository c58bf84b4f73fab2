"""The sampled satellite against the closed forms of a Plummer sphere."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import kstest
from streamkit_nbody.plummer import TRUNCATION, sample

from streamkit import G

N, MASS, RADIUS = 40000, 6.4e8, 0.85


@pytest.fixture(scope="module")
def sphere():
    return sample(N, MASS, RADIUS, np.random.default_rng(1))


def test_mass_profile(sphere):
    """M(<r) / M = r^3 / (r^2 + a^2)^(3/2), so that fraction of each particle is uniform up to the truncation."""
    r = np.sqrt((sphere[0] ** 2).sum(axis=0))
    inside = (r / np.hypot(r, RADIUS)) ** 3
    assert kstest(inside, "uniform", args=(0, (1 + TRUNCATION**-2) ** -1.5)).pvalue > 0.01
    assert r.max() < TRUNCATION * RADIUS * 1.05  # the mean is taken off


def test_dispersion_profile_and_isotropy(sphere):
    """sigma^2 = G M / (6 sqrt(r^2 + a^2)) along the radius and across it."""
    q, v = sphere
    r = np.sqrt((q**2).sum(axis=0))
    radial = (q * v).sum(axis=0) / r
    across = np.cross(q.T, v.T).T / r
    edges = np.quantile(r, np.linspace(0, 1, 9))
    for low, high in pairwise(edges):
        shell = (r >= low) & (r < high)
        expected = (G * MASS / (6 * np.hypot(r[shell], RADIUS))).mean()
        assert (radial[shell] ** 2).mean() == pytest.approx(expected, rel=0.08)  # 5000 of them: 4 sigma
        assert 0.5 * (across[:, shell] ** 2).sum(axis=0).mean() == pytest.approx(expected, rel=0.06)


def test_energy_distribution(sphere):
    """All are bound, and the kinetic energy is 3 pi / 64 G M^2 / a."""
    q, v = sphere
    kinetic = 0.5 * (v**2).sum(axis=0)
    potential = -G * MASS / np.hypot(np.sqrt((q**2).sum(axis=0)), RADIUS)
    assert (kinetic + potential < 0).mean() > 0.999  # the mean velocity that is taken off may free a few
    assert kinetic.mean() == pytest.approx(3 * np.pi / 64 * G * MASS / RADIUS, rel=0.02)


def test_at_rest_at_the_origin(sphere):
    assert np.abs(np.concatenate([sphere[0].mean(axis=1), sphere[1].mean(axis=1)])).max() < 1e-12
