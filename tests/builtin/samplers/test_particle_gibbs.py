"""Moves of shared coordinates with the own ones summed over draws, on a density known by quadrature."""

import numpy as np
import pytest
from scipy.special import logsumexp

from streamkit.builtin.samplers.emulator.walk.density import Layout, Terms
from streamkit.builtin.samplers.emulator.walk.following import Following
from streamkit.builtin.samplers.emulator.walk.mixture import Mixture
from streamkit.builtin.samplers.emulator.walk.particle_gibbs import move_shared

DATA, ERRORS = (1.4, -0.9, 0.3), (0.3, 0.5, 0.2)
STEPS = 500


class Bent:
    """Three streams: a datum of each is h + s + s^2 / 2, with normal priors of h and all s."""

    layout = Layout(np.array([0]), [np.array([1]), np.array([2]), np.array([3])])

    @staticmethod
    def ln_likelihood(h, s, k):
        return -0.5 * ((h + s + 0.5 * s**2 - DATA[k]) / ERRORS[k]) ** 2

    def terms(self, z):
        own = [self.ln_likelihood(z[:, 0], z[:, 1 + k], k) for k in range(3)]
        return Terms(-0.5 * z**2, np.stack(own, axis=1))


def moments_by_quadrature(beta):
    """Return the means and standard deviations of h and all s."""
    grid = np.linspace(-6, 6, 1201)
    parts = [beta * Bent.ln_likelihood(grid[:, None], grid, k) - 0.5 * grid**2 for k in range(3)]  # (h, s)
    each = [logsumexp(part, axis=1) for part in parts]
    ln_h = sum(each) - 0.5 * grid**2
    weights = [np.exp(ln_h - logsumexp(ln_h))]
    weights += [np.exp(parts[k] - each[k][:, None]).T @ weights[0] for k in range(3)]
    means = np.array([weight @ grid for weight in weights])
    return means, np.sqrt([weight @ grid**2 for weight in weights] - means**2)


def walked(count, beta, rng, steps=STEPS):
    """(steps, walkers, 4) Walk by these moves alone; they learned from places that are not those of the density."""
    density, rough = Bent(), rng.normal([0.3, 0.2, -0.4, 0], [1.0, 1.2, 1.2, 1.2], (4000, 4))
    rough[:, 1] *= np.exp(0.3 * rough[:, 0])
    rough[:, 2] -= 0.5 * rough[:, 0]
    follow = [Following.of(rough[:, :1], rough[:, own]) for own in density.layout.own]
    lefts = [each.left(rough[:, :1], rough[:, own]) for each, own in zip(follow, density.layout.own, strict=True)]
    mixtures = [Mixture.of(left, rng) for left in lefts]

    def wide(h):
        return h + 0.8 * rng.standard_normal(h.shape), np.zeros(len(h))

    def narrow(h):
        return h + 0.2 * rng.standard_normal(h.shape), np.zeros(len(h))

    z, found, moved = rng.normal(0, 0.5, (300, 4)), [], []
    terms = density.terms(z)
    for _ in range(steps):
        z, terms, rates = move_shared(density, z, terms, beta, rng, follow, mixtures, count, [wide, narrow])
        found.append(z)
        moved.append(rates)
    whole = density.terms(z)
    np.testing.assert_allclose(terms.prior, whole.prior, atol=1e-12)
    np.testing.assert_allclose(terms.ln_likelihood, whole.ln_likelihood, atol=1e-12)
    return np.array(found[steps // 8 :]), np.mean(moved, axis=0)


@pytest.mark.parametrize(("count", "beta"), [(3, 1.0), (8, 0.3)])
def test_density_is_left_alone(count, beta):
    chain, rates = walked(count, beta, np.random.default_rng([count, 5]))
    mean, sd = moments_by_quadrature(beta)
    flat = chain.reshape(-1, 4)
    np.testing.assert_allclose(flat.mean(axis=0), mean, atol=0.04 * sd.max())
    np.testing.assert_allclose(flat.std(axis=0), sd, rtol=0.04)
    assert 0.1 < rates[0] < rates[1] <= 1


def test_more_draws_let_more_steps_pass():
    few, many = (walked(count, 1.0, np.random.default_rng(7), 60)[1] for count in (1, 16))
    assert many[0] > 1.3 * few[0]
