"""The density of field stars at each phi1, fitted once to the stars of a catalogue: a mixture of Gaussians.

Columns that the catalogue was cut in are first mapped to a normal score of their place in the window, in which an even
density is a standard normal. So a mixture of a few Gaussians is smooth inside the window, and none of it is outside.
The Gaussians are joint in phi1 and the columns; the density at a phi1 is conditional on it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.special import ndtri

import streamkit as sk
from streamkit.builtin.observables.stars.catalogue import Catalogue, ends_of
from streamkit.builtin.observables.stars.rough_track import rough_track_of

STEPS, SETTLED = 200, 1e-4  # of expectation and maximisation; the gain in mean ln density that ends them
# Least standard deviation of a Gaussian, of that of all stars, in the rounds in which field and rough track are fitted
# in turn. Narrower ones could be the stream, which is among the stars of the first field.
LEAST = (0.4, 0.2, 0.15)
EDGE = 1e-4  # of the window at its ends, where the normal score is cut
FEW = 30.0  # stars of the field for each Gaussian
OF_MISSING = 2  # Gaussians of a column that some stars lack


class Gaussians(sk.GaussianMixture):
    """A Gaussian mixture with its whole density."""

    def ln_terms(self, y: sk.Array) -> sk.Array:
        """(N, G) ln of the weighted densities at y (N, D)."""
        return np.asarray(super().ln_terms(y) - 0.5 * y.shape[1] * np.log(2 * np.pi))

    def first(self) -> Gaussians:
        """Return their marginal density in the first dimension."""
        return Gaussians(self.weights, self.means[:, :1], self.roots[:, :1, :1], self.inverses[:, :1, :1])


@lru_cache(maxsize=8)  # a free parameter makes the observable anew at each call, with the same stars
def with_field(stars: Catalogue, window: sk.Table, count: int, kernel: float) -> Catalogue:
    """Return the stars with the density of the field by so many Gaussians; ValueError if there are too few stars.

    The first field is smooth, and through all stars. A rough track is found where they exceed it; the stars count for
    the next field by their chance not to be of the track.
    """
    if len(stars) < FEW * count:
        raise ValueError(
            f"background_gaussians = {count} for {len(stars)} stars: expected at least {FEW:g} stars for each; take "
            "fewer Gaussians"
        )
    field, ends = np.ones(len(stars)), ends_of(window)
    for least in LEAST:
        stars = replace(stars, ln_background=_ln_density(stars, ends, field, count, least))
        field = np.maximum(1 - rough_track_of(stars, kernel).chance, 1e-9)
    return replace(stars, ln_background=_ln_density(stars, ends, field, count, LEAST[-1]))


def _ln_density(
    stars: Catalogue, window: Mapping[str, tuple[float, float]], weight: sk.Array, count: int, least: float
) -> sk.Array:
    """(N,) ln density of the columns that each star has at its phi1, by stars that count with weights (N,)."""
    scores = {"phi1": _score(stars.phi1, window["phi1"])}
    scores |= {name: _score(column, window.get(name)) for name, column in stars.values.items()}
    complete = [name for name in stars.columns if np.isfinite(stars.values[name]).all()]
    total = np.zeros(len(stars))
    if complete:
        x = np.stack([scores[name][0] for name in ("phi1", *complete)], axis=1)
        joint = fitted(x, weight, count, least)
        total = joint.ln_density(x) - joint.first().ln_density(x[:, :1])
        total += sum(scores[name][1] for name in complete)
    for name in stars.columns:
        if name in complete:
            continue
        there = np.flatnonzero(np.isfinite(stars.values[name]))
        x = scores[name][0][there, None]
        alone = fitted(x, weight[there], OF_MISSING if len(there) > OF_MISSING * FEW else 1, least)
        total[there] += alone.ln_density(x) + scores[name][1][there]
    return total


def _score(column: sk.Array, ends: tuple[float, float] | None) -> tuple[sk.Array, sk.Array]:
    """(N,) each: the coordinate in which the field is fitted, and ln of its slope along the column."""
    if ends is None:
        width = float(np.nanstd(column)) or 1.0
        return (column - np.nanmean(column)) / width, np.full(len(column), -np.log(width))
    low, high = ends
    score = ndtri(np.clip((column - low) / (high - low), EDGE, 1 - EDGE))
    return score, np.asarray(0.5 * (score**2 + np.log(2 * np.pi)) - np.log(high - low))


def fitted(x: sk.Array, weight: sk.Array, count: int, least: float) -> Gaussians:
    """Fit Gaussians to points (N, D) with weights (N,) by expectation and maximisation (Dempster, Laird & Rubin 1977).

    They begin as slices along the direction in which the points are widest. The least standard deviation, of that
    of all points, is added in squares.
    """
    share = weight / weight.sum()
    middle = share @ x
    whole = (share[:, None] * (x - middle)).T @ (x - middle)
    floor = least**2 * np.diag(np.diag(whole))
    axis = np.linalg.eigh(whole)[1][:, -1]
    ranks = np.empty(len(x))
    order = np.argsort(x @ axis)
    ranks[order] = np.cumsum(share[order])
    chance = np.zeros((len(x), count))
    chance[np.arange(len(x)), np.minimum((ranks * count).astype(int), count - 1)] = 1.0
    found, before = _maximised(x, share, chance, floor), -np.inf
    for _ in range(STEPS):
        terms = found.ln_terms(x)
        ln_density = np.logaddexp.reduce(terms, axis=1)
        reached = float(share @ ln_density)
        if reached - before < SETTLED:
            break
        found, before = _maximised(x, share, np.exp(terms - ln_density[:, None]), floor), reached
    return found


def _maximised(x: sk.Array, share: sk.Array, chance: sk.Array, floor: sk.Array) -> Gaussians:
    """Return the Gaussians of points that belong to them by chance (N, G)."""
    return Gaussians.of_shares(x, share[:, None] * chance + 1e-300, floor)
