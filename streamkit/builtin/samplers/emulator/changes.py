"""What a change of the emulator changes of the posterior: means and widths, in standard deviations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamkit import Array
from streamkit.builtin.samplers.emulator.emulated import Emulated

# Emulators that the noise of the calls could have given as well.
REDRAWN = 24


def change_of(samples: Array, ln_weight: Array) -> float:
    """Return the most that weights (n,) change of samples (n, d): a mean, or a width, in standard deviations."""
    return float(np.abs(changes_of(samples, ln_weight)).max())


def changes_of(samples: Array, ln_weight: Array) -> Array:
    """(2, d) Return what weights (n,) change of samples (n, d): means, and widths, in standard deviations."""
    weight = np.exp(np.clip(ln_weight - np.median(ln_weight), -20.0, 5.0))
    weight /= weight.sum()
    mean, width = weight @ samples, np.maximum(samples.std(axis=0), 1e-300)
    moved = (mean - samples.mean(axis=0)) / width
    wider = np.sqrt(weight @ (samples - mean) ** 2) / width - 1
    return np.array([moved, wider])


def moved_by(others: list[Emulated], emulated: Emulated, samples: Array) -> float:
    """Return the most that one of some other emulators changes of a posterior (`change_of`).

    Samples (n, d) are of the posterior of `emulated`. Those of the others would not do: where an emulator gives up a
    tail, the few samples there would weigh the more.
    """
    some = samples[:: max(len(samples) // 2000, 1)]
    here, moving = emulated.ln_density(some), with_axes(some)
    return max(change_of(moving, each.ln_density(some) - here) for each in others)


def with_axes(samples: Array) -> Array:
    """(n, 2 d) Append the principal axes of samples (n, d), each in units of its standard deviation.

    What data know best, such as a mass, is a combination of parameters: it may move where none of these does.
    """
    scaled = (samples - samples.mean(axis=0)) / np.maximum(samples.std(axis=0), 1e-300)
    _, axes = np.linalg.eigh(np.atleast_2d(np.cov(scaled.T)))
    return np.concatenate([samples, scaled @ axes], axis=1)


def uncertainty(emulated: Emulated, samples: Array, rng: np.random.Generator) -> float:
    """Return how uncertain the noise of the calls leaves a mean or a width: the largest standard error.

    It is that of emulators with other noise at the same calls. Samples (n, d) are of the emulated posterior.
    """
    some = samples[:: max(len(samples) // 1000, 1)]
    here, moving = emulated.ln_density(some), with_axes(some)
    others = (replace(emulated, emulator=emulated.emulator.redrawn(rng)) for _ in range(REDRAWN))
    changes = [changes_of(moving, each.ln_density(some) - here) for each in others]
    return float(np.sqrt(np.mean(np.square(changes), axis=0)).max())
