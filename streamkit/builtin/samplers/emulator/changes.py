"""What a change of the emulator changes of the posterior: means and widths, in standard deviations."""

from __future__ import annotations

import numpy as np

from streamkit import Array

# Bounds of ln weight of a sample, from its median.
BOUNDS = (-20.0, 5.0)
# How often weights are put in another order, and the most of what they change then that is taken for chance: where it
# is more, the samples are too few to say.
ORDERS, MOST_BY_CHANCE = 8, 0.15


def change_of(samples: Array, ln_weight: Array, bounds: tuple[float, float] = BOUNDS) -> float:
    """Return the most that weights (n,) change of samples (n, d): a mean, or a width, in standard deviations."""
    return float(np.abs(changes_of(samples, ln_weight, bounds)).max())


def real_change_of(samples: Array, ln_weight: Array, rng: np.random.Generator) -> float:
    """Return the same without what the weights would change if they had nothing to do with the samples.

    In many dimensions a few samples have most of the weight, and of these one coordinate or another is off by chance.
    """
    others = [change_of(samples, rng.permutation(ln_weight)) for _ in range(ORDERS)]
    return beyond_chance(change_of(samples, ln_weight), float(np.sqrt(np.mean(np.square(others)))))


def beyond_chance(measured: float, by_chance: float) -> float:
    """Return what is left of a change without that by chance, which adds to it in squares."""
    return float(np.sqrt(max(measured**2 - min(by_chance, MOST_BY_CHANCE) ** 2, 0.0)))


def changes_of(samples: Array, ln_weight: Array, bounds: tuple[float, float] = BOUNDS) -> Array:
    """(2, d) Return what weights (n,) change of samples (n, d): means, and widths, in standard deviations."""
    weight = np.exp(np.clip(ln_weight - np.median(ln_weight), *bounds))
    weight /= weight.sum()
    mean, width = weight @ samples, np.maximum(samples.std(axis=0), 1e-300)
    moved = (mean - samples.mean(axis=0)) / width
    wider = np.sqrt(weight @ (samples - mean) ** 2) / width - 1
    return np.array([moved, wider])


def difference(first: Array, second: Array) -> float:
    """Return the largest difference of two posteriors by samples (n, d) and (m, d) of them.

    It is that of a mean, in the smaller of their standard deviations, or of a width, as a fraction of the smaller one:
    of all coordinates and of the principal axes of either.
    """
    return max(_beside(first, second), _beside(second, first))


def _beside(first: Array, second: Array) -> float:
    both = with_axes(np.concatenate([first, second]), len(first))
    mine, other = both[: len(first)], both[len(first) :]
    widths = np.stack([mine.std(axis=0), other.std(axis=0)])
    moved = np.abs(mine.mean(axis=0) - other.mean(axis=0)) / np.maximum(widths.min(axis=0), 1e-300)
    return float(max(moved.max(), (widths.max(axis=0) / np.maximum(widths.min(axis=0), 1e-300) - 1).max()))


def with_axes(samples: Array, first: int | None = None) -> Array:
    """(n, 2 d) Append the principal axes of samples (n, d), of the first of them, each in its standard deviation.

    What data know best, such as a mass, is a combination of parameters: it may move where none of these does.
    """
    some = samples[:first]
    scale = np.maximum(some.std(axis=0), 1e-300)
    _, axes = np.linalg.eigh(np.atleast_2d(np.cov((some / scale).T)))
    return np.concatenate([samples, (samples - some.mean(axis=0)) / scale @ axes], axis=1)


def every_so_often(samples: Array, n: int) -> Array:
    """Return about n of the samples, at equal distances."""
    return samples[:: max(len(samples) // n, 1)]
