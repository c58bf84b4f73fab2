"""How well walks of many walkers agree, and how long they are: R-hat, autocorrelation times, kurtosis."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri
from scipy.stats import rankdata

from streamkit import Array
from streamkit.builtin.samplers.emulator.walk.density import Layout

# A sum of autocorrelations ends at so many times (Sokal 1997).
WINDOW = 5.0
# Quantities whose autocorrelations are computed at a time.
AT_A_TIME = 16
# Part of the autocorrelation times of a stream's own coordinates that counts, where there are several streams. What is
# asked for is what they share. One walker that stays in the long end of one of some hundred own coordinates would make
# the walk of all of them ten times as long.
OF_OWN = 0.4
# Numbers of a walk that are judged at most: of longer ones every second, third sweep.
MOST = 5_000_000


def autocorrelation_times(chain: Array) -> Array:
    """(q,) Integrated autocorrelation times in sweeps of walks (sweeps, w, q) of many walkers: of values and squares.

    Deviations are those from the mean of all walkers. A short walk then shows a long time: each walker about its own
    mean would hide what is slower than the walk. It is infinite for a quantity that no walker has changed, and 0 where
    all have one value.
    """
    q = chain.shape[2]
    return np.concatenate([_times(chain[:, :, i : i + AT_A_TIME]) for i in range(0, q, AT_A_TIME)])


def _times(chain: Array) -> Array:
    sweeps, _, q = chain.shape
    away = chain - chain.mean(axis=(0, 1))
    squares = away**2
    away = np.concatenate([away, squares - squares.mean(axis=(0, 1))], axis=2)
    spectrum = np.fft.rfft(away, 2 * sweeps, axis=0)
    together = np.fft.irfft(np.mean(np.abs(spectrum) ** 2, axis=1), axis=0)[:sweeps]
    together /= np.arange(sweeps, 0, -1)[:, None]  # each lag has its own number of pairs
    with np.errstate(invalid="ignore", divide="ignore"):
        sums = 2 * np.cumsum(together / together[0], axis=0) - 1
    inside = np.arange(sweeps)[:, None] < WINDOW * sums  # a sum ends at the first lag outside, or with the walk
    ends = np.where(inside.all(axis=0), sweeps - 1, np.argmin(inside, axis=0))
    times = np.nan_to_num(sums[ends, np.arange(2 * q)], nan=np.inf).reshape(2, q).max(axis=0)
    return np.where(np.ptp(chain, axis=(0, 1)) > 0, np.maximum(times, 1.0), 0.0)


def agreement(watched: Array) -> float:
    """Return the largest rank-normalised R-hat of walks (2, sweeps, w, q) of two populations, each a chain.

    It is split in halves of the walks, and the larger of that of the values and of their distances from the median.
    """
    from arviz_stats.base.array import array_stats  # a second or more to load

    chains = watched.reshape(2, -1, watched.shape[3])  # sweep after sweep: halves are early and late
    moved = np.ptp(chains.reshape(-1, chains.shape[2]), axis=0) > 0
    r_hat = array_stats.rhat(chains[..., moved], chain_axis=0, draw_axis=1, method="rank")  # type: ignore[no-untyped-call]
    return float(np.max(r_hat)) if moved.any() else 1.0


def kurtosis(watched: Array) -> Array:
    """(q,) Kurtosis of walks (sweeps, w, q): 3 for a Gaussian, and 1 where all values are one."""
    squares = (watched - watched.mean(axis=(0, 1))) ** 2
    variances = squares.mean(axis=(0, 1))
    return np.where(variances > 0, np.mean(squares**2, axis=(0, 1)) / np.maximum(variances, 1e-300) ** 2, 1.0)


class Walked(NamedTuple):
    """How well walks agree, and how long they are.

    Attributes
    ----------
    r_hat
        The largest one.
    time
        The longest autocorrelation time, in sweeps; of the own coordinates of several streams `OF_OWN` of it.
    spread
        The largest (kurtosis - 1) times autocorrelation time: what makes the standard error of a width.
    """

    r_hat: float
    time: float
    spread: float


def judge(layout: Layout, walked: Array) -> Walked:
    """Judge walks (sweeps, w, d) of two populations, each a half of the walkers.

    What counts are all coordinates, the principal axes of the shared ones, and of those that each factor depends on. Of
    several factors the times are those of normal scores by rank (Vehtari et al. 2021, their bulk): of a hundred own
    coordinates some have a long end, in which one walker of a hundred makes the time of its square. No interval depends
    on that.
    """
    found, every = [], walked.size // MOST + 1
    for counts, watched in _watched(layout, walked[::every]):
        times = every * autocorrelation_times(_normal_scores(watched) if layout.several else watched)
        r_hat = agreement(np.stack(np.split(watched, 2, axis=1)))
        found.append(Walked(r_hat, counts * float(times.max()), float(np.max((kurtosis(watched) - 1) * times))))
    return Walked(*(max(column) for column in zip(*found, strict=True)))


def _watched(layout: Layout, walked: Array) -> Iterator[tuple[float, Array]]:
    """Yield the coordinates of each block with its axes (sweeps, w, q), and how much of its times counts.

    All blocks at a time would need gigabytes.
    """
    if len(layout.shared):
        yield 1.0, np.concatenate([walked[:, :, layout.shared], _axes(walked[:, :, layout.shared])], axis=2)
    for k, own in enumerate(layout.own):
        if len(own):
            block = np.concatenate([walked[:, :, own], _axes(walked[:, :, layout.of(k)])], axis=2)
            yield OF_OWN if layout.several else 1.0, block


def _normal_scores(watched: Array) -> Array:
    """(sweeps, w, q) Return the ranks of walks as quantiles of a standard normal (Blom 1958)."""
    ranks = rankdata(watched.reshape(-1, watched.shape[2]), axis=0)
    return np.asarray(ndtri((ranks - 0.375) / (len(ranks) + 0.25))).reshape(watched.shape)


def _axes(block: Array) -> Array:
    """(sweeps, w, q) Return walks (sweeps, w, q) along their principal axes; nothing for a single coordinate."""
    if block.shape[2] < 2:
        return block[:, :, :0]
    scaled = (block - block.mean(axis=(0, 1))) / np.maximum(block.std(axis=(0, 1)), 1e-300)
    return np.asarray(scaled @ np.linalg.eigh(np.cov(scaled.reshape(-1, block.shape[2]).T))[1])
