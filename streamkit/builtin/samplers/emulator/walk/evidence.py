"""The evidence of an emulated posterior, by a bridge between its samples and a mixture of Gaussians.

Meng & Wong 1996, Statistica Sinica 6, 831; the error is that of Fruehwirth-Schnatter 2004, Econometrics Journal 7, 143.
The mixture is fitted to one population, and bridged to the other, which is independent; then the other way round.
"""

from __future__ import annotations

import numpy as np

from streamkit import Array
from streamkit.builtin.samplers.emulator.changes import every_so_often
from streamkit.builtin.samplers.emulator.walk.density import Density, Joint
from streamkit.builtin.samplers.emulator.walk.mixture import Mixture
from streamkit.builtin.samplers.emulator.walk.populations import Populations

DRAWS, SAMPLES = 4000, 4000  # draws of a mixture, and most samples of a population
STEPS, CLOSE = 200, 1e-8  # of the iteration to the evidence, and the change of ln evidence at which it ends
REDRAWN, SOME = 8, 500  # emulators that the noise of the calls could have given as well, and samples for each


def ln_evidence(density: Density, populations: Populations, seed: list[int]) -> tuple[float, float]:
    """Return ln of the integral of prior times likelihood, and its standard error."""
    rng = np.random.default_rng(seed)
    one, other = np.split(populations.samples, 2)
    independent = populations.independent / 2
    one, other = every_so_often(one, SAMPLES), every_so_often(other, SAMPLES)
    found = [_bridge(density, *pair, independent, rng) for pair in ((one, other), (other, one))]
    values, errors = np.array(found).T
    return float(values.mean()), float(max(np.sqrt(np.mean(errors**2) / 2), abs(values[0] - values[1]) / 2))


def noise_of_calls(joint: Joint, samples: Array, seed: list[int]) -> float:
    """Return the standard error that the noise of the calls leaves in ln evidence, from samples (n, d)."""
    rng, some = np.random.default_rng(seed), every_so_often(samples, SOME)
    here = joint.ln_likelihoods(some).sum(axis=1)
    others = sum(
        each.of_other_noise(some[:, factor.columns], rng, REDRAWN)
        for factor, each in zip(joint.factors, joint.emulated, strict=True)
    )
    changes = np.logaddexp.reduce(others - here, axis=1) - np.log(len(some))
    return float(np.sqrt(np.mean(np.square(changes))))


def _bridge(
    density: Density, fitted: Array, samples: Array, independent: float, rng: np.random.Generator
) -> tuple[float, float]:
    """Return ln evidence and its error from samples (n, d), of which so many are independent; others fit a mixture."""
    mixture = Mixture.of(fitted, rng)
    of_draws, of_samples = (_ln_ratio(density, mixture, z) for z in (mixture.draws(DRAWS, rng), samples))
    share = independent / (independent + DRAWS)
    middle = float(np.median(of_samples))  # of a size that exponentials hold
    of_draws, of_samples = np.minimum(of_draws - middle, 700.0), np.minimum(of_samples - middle, 700.0)
    value = 0.0
    for _ in range(STEPS):
        above = np.exp(of_draws - np.logaddexp(np.log(share) + of_draws, np.log1p(-share) + value))
        below = np.exp(-np.logaddexp(np.log(share) + of_samples, np.log1p(-share) + value))
        before, value = value, float(np.log(above.mean()) - np.log(below.mean()))
        if abs(value - before) < CLOSE:
            break
    relative = above.var() / (DRAWS * above.mean() ** 2) + below.var() / (independent * below.mean() ** 2)
    return middle + value, float(np.sqrt(relative))


def _ln_ratio(density: Density, mixture: Mixture, z: Array) -> Array:
    """(n,) ln of prior times likelihood over the density of a mixture; both Gaussians have the same constant."""
    return np.asarray(density.terms(z).total(1.0) - mixture.ln_density(z))
