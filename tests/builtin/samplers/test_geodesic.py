"""Trajectories along a bent sheet: they go back, stay on the sheet, and sample it as the density says."""

import numpy as np
from scipy.stats import ks_1samp, norm

from streamkit.builtin.samplers.emulator.walk import geodesic
from streamkit.builtin.samplers.emulator.walk.agreement import autocorrelation_times
from streamkit.builtin.samplers.emulator.walk.arrow import Arrow
from streamkit.builtin.samplers.emulator.walk.density import Layout, Tangent
from streamkit.builtin.samplers.emulator.walk.geodesic import Surface, trajectory

ERROR = 0.01


def bent(z):
    """A datum b - a^2 +- 0.01 with standard normal priors on a and b, and on a third parameter that it does not see."""
    along = np.zeros((*z.shape, 1))
    along[:, 0, 0], along[:, 1, 0] = -2 * z[:, 0] / ERROR, 1 / ERROR
    return [Tangent.of((z[:, 1] - z[:, 0] ** 2)[:, None] / ERROR, along, np.arange(3))]


def ln_density(z):
    return -0.5 * np.sum(z**2, axis=1) - 0.5 * np.sum(bent(z)[0].residuals ** 2, axis=1)


def on_the_sheet(n, rng):
    a = rng.normal(scale=0.7, size=n)
    return np.stack([a, a**2 + ERROR * rng.standard_normal(n), rng.standard_normal(n)], axis=1)


def surface():
    return Surface(bent, Layout.of_one(3), 1.0, np.eye(3))


def factors(sheet, place):
    return Arrow.of(sheet.metric(place, place), sheet.layout)


def test_a_step_back_arrives_where_the_step_began():
    rng = np.random.default_rng(1)
    z = on_the_sheet(500, rng)
    sheet, length = surface(), np.full((500, 1), 0.5)
    here = sheet.at(z)
    velocity = 0.5 * rng.standard_normal(z.shape) * [1, 0, 1] + [0, 1, 0] * z[:, :1]
    there, arrived = sheet.step(here, velocity, length)
    new = sheet.velocity(here, there, factors(sheet, there), length)
    back, returned = sheet.step(there, -new, length)
    old = sheet.velocity(there, back, factors(sheet, back), length)
    both = arrived & returned
    assert both.mean() > 0.9
    assert np.abs(there.z - z)[both].max() > 0.3
    near = both & (np.abs(back.z - z).max(axis=1) < 0.1)  # others come to another part of the sheet, and are refused
    assert near.sum() > 0.95 * both.sum()
    np.testing.assert_allclose(back.z[near], z[near], atol=1e-6)
    np.testing.assert_allclose(-old[near] * [1, 0, 1], velocity[near] * [1, 0, 1], atol=1e-3)


def test_a_short_trajectory_in_a_flat_space_keeps_its_energy(monkeypatch):
    """Of residuals that are linear, by the leapfrog: the error of as many steps falls with the cube of their length."""
    rng = np.random.default_rng(2)
    slopes = rng.standard_normal((3, 4)) * 30.0

    def linear(z):
        return [Tangent.of(z @ slopes, np.tile(slopes, (len(z), 1, 1)), np.arange(3))]

    spread = np.linalg.inv(np.eye(3) + slopes @ slopes.T)
    z = rng.multivariate_normal(np.zeros(3), spread, 400)
    errors = []
    for length in (0.2, 0.1):
        monkeypatch.setattr(geodesic, "SHORTEST", length)
        monkeypatch.setattr(geodesic, "LONGEST", length)
        new, added = trajectory(Surface(linear, Layout.of_one(3), 1.0, np.eye(3)), z, np.random.default_rng(3))
        gained = [-0.5 * np.einsum("ni,ij,nj->n", each, np.linalg.inv(spread), each) for each in (new, z)]
        errors.append(np.std(gained[0] - gained[1] + added))
    assert errors[0] < 0.02
    assert 6 < errors[0] / errors[1] < 10


def test_a_sheet_of_a_hundredth_is_sampled_in_some_ten_trajectories():
    """The marginal of a is p(a) = exp(-a^2 / 2 - a^4 / 2), but for the error of the datum."""
    rng = np.random.default_rng(4)
    z, walked = on_the_sheet(200, rng), []
    for _ in range(225):
        new, correction = trajectory(surface(), z, rng)
        accepted = np.log(rng.random(len(z))) < ln_density(new) - ln_density(z) + correction
        z = np.where(accepted[:, None], new, z)
        walked.append(z)
    walked = np.array(walked[50:])
    assert autocorrelation_times(walked).max() < 15
    grid = np.linspace(-4, 4, 4001)
    density = np.exp(-0.5 * grid**2 - 0.5 * grid**4)
    cumulated = np.cumsum(density) / density.sum()
    some = walked[::35].reshape(-1, 3)
    assert ks_1samp(some[:, 0], lambda a: np.interp(a, grid, cumulated)).pvalue > 1e-3
    assert ks_1samp((some[:, 1] - some[:, 0] ** 2) / ERROR, norm.cdf).pvalue > 1e-3
    assert ks_1samp(some[:, 2], norm.cdf).pvalue > 1e-3
