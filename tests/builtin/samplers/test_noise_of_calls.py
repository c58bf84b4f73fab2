"""What the noise of calls leaves uncertain: of coefficients, and of the posterior."""

import numpy as np
import pytest
from emulated import OfToy, called
from posteriors import Curved, Rough

from streamkit.builtin.samplers.emulator.changes import changes_of, with_axes
from streamkit.builtin.samplers.emulator.learn import from_calls
from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.learn.points import Points
from streamkit.builtin.samplers.emulator.learn.polynomial import Polynomial, regress
from streamkit.builtin.samplers.emulator.learn.space import Space
from streamkit.builtin.samplers.emulator.walk.density import Emulated
from streamkit.builtin.samplers.monomials import count, monomials


def test_what_noise_changes_is_the_scatter_of_fits_whose_points_have_uneven_weights():
    """All points have the same noise, whatever they count: the closed form of fits to other noise, place by place."""
    rng = np.random.default_rng(3)
    x, places = rng.normal(size=(60, 2)), rng.normal(size=(5, 2))
    weight = 1 / (1 + np.sum(x**2, axis=1)) ** 2
    terms, there, penalty = monomials(x, 2), monomials(places, 2), np.full(count(2, 2), 1e-9)
    fit = regress(terms, rng.normal(size=(60, 20000)), weight, penalty)
    stated = np.sum((there @ fit.by_noise(terms, weight)) ** 2, axis=1)
    np.testing.assert_allclose(np.var(there @ fit.coefficients, axis=1), stated, rtol=0.05)
    assert (np.sum((there @ fit.root) ** 2, axis=1) > 1.5 * stated).all()  # of noise that grows as the weights fall


def test_small_terms_of_third_degree_are_learned_without_the_noise_of_all_of_them():
    """56 terms have noise, and two are not zero: what is learned is nearer than any plain polynomial."""
    off, ones = [], np.ones(300)

    def truth(x):
        mixed = 0.12 * x[:, 0] * x[:, 1] * x[:, 2] + 0.05 * x[:, 3] ** 3
        return np.tile((x[:, 0] + 0.5 * x[:, 1] ** 2 + mixed)[:, None], 3)

    for seed in range(5):
        rng = np.random.default_rng(seed)
        x, new = rng.normal(size=(300, 6)), rng.normal(size=(500, 6))
        target, noise = truth(x) + 0.5 * rng.normal(size=(300, 3)), np.full((300, 3), 0.25)
        points = Points(np.zeros(6), np.eye(6), x, target, noise, ones, ones > 0, np.empty((0, 2), dtype=int))
        basis, fit = from_calls._best_regression(points)
        found = [basis.terms(new) @ fit.coefficients]
        for degree in (2, 3):
            plain = regress(monomials(x, degree), target, ones, 1e-8)
            found.append(monomials(new, degree) @ plain.coefficients)
        off.append([np.mean((each - truth(new)) ** 2) for each in found])
    mine, quadratic, cubic = np.mean(off, axis=0)
    assert mine < 0.9 * min(quadratic, cubic)


def test_a_quadratic_with_noise_is_learned_as_one():
    """Of some noisy fits one of third degree is better by chance; each walk on it would take several times as long."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        x, ones, noise = rng.normal(size=(300, 6)), np.ones(300), np.full((300, 3), 0.25)
        target = np.tile((x[:, 0] + 0.5 * x[:, 1] ** 2)[:, None], 3) + 0.5 * rng.normal(size=(300, 3))
        points = Points(np.zeros(6), np.eye(6), x, target, noise, ones, ones > 0, np.empty((0, 2), dtype=int))
        basis, _ = from_calls._best_regression(points)
        assert basis == Polynomial(2)


class Shared(OfToy):
    """Half of the variance of a call's noise is the same for all data."""

    def evaluate(self, points):
        own, rng = super().evaluate(points), np.random.default_rng([self.seed, 7])
        true = self.toy.mean(points.T).T
        mean = true + ((own.mean - true) + self.noise * self.errors * rng.standard_normal((len(points), 1))) / 2**0.5
        return own._replace(mean=mean, ln_likelihood=self.compare(points, mean, 0 * mean, None))


@pytest.mark.parametrize("kind", [OfToy, Shared])
def test_the_uncertainty_is_the_scatter_of_posteriors_from_other_calls(kind):
    """Emulators of a Gaussian posterior that have learned from calls with other noise move its means and widths."""
    rng = np.random.default_rng(5)
    samples = rng.normal(Rough.values, Rough.errors, size=(2000, 4))
    true, summed = Rough().smooth(samples.T), np.sum(samples / Rough.errors, axis=1, keepdims=True)
    changes, stated = [], []
    for seed in range(20):
        problem = kind(Rough(), seed, noise=1.0)
        calls = Calls.of(problem, Space(problem), samples[:200])
        emulated, z = Emulated(calls.space, calls.learn(), noise=False), calls.space.normal(samples)
        here, moving = emulated.ln_likelihood(z), with_axes(samples) if kind is OfToy else summed
        changes.append(changes_of(moving, here - true))
        others = [changes_of(moving, emulated.redrawn(rng).ln_likelihood(z) - here) for _ in range(16)]
        stated.append(np.sqrt(np.mean(np.square(others), axis=0)).max())
    scatter = np.std(changes, axis=0).max()
    assert np.mean(stated) == pytest.approx(scatter, rel=0.3)
    assert 0.05 < scatter < 0.5


def test_likelihoods_of_other_noise_are_those_of_redrawn_emulators():
    problem = OfToy(Curved(), noise=0.5)
    calls = called(problem, 300)
    emulated = Emulated(calls.space, calls.learn(), noise=False)
    together = emulated.of_other_noise(calls.z, np.random.default_rng(1), 3)
    rng = np.random.default_rng(1)
    for each in together:
        np.testing.assert_allclose(each, emulated.redrawn(rng).ln_likelihood(calls.z), rtol=1e-9, atol=1e-9)
    assert np.ptp(together, axis=0).min() > 1e-3
