"""New data about a stream, column by column."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from streamkit import Array
from streamkit.builtin.observables.track.columns import DEPTH, LIMITS
from streamkit.builtin.observables.track.likelihood import Side


def new_values(
    sides: Mapping[str, Side], pair: Sequence[str], covariance: Array | None, rng: np.random.Generator
) -> dict[str, Array]:
    """Return Gaussian draws (k,) of each column by name, some of them outliers; two columns may have a covariance."""
    noise: dict[str, Array] = {}
    found = {}
    for name, side in sides.items():
        noise[name] = rng.normal(0.0, np.sqrt(side.variance))
        if covariance is not None and pair and name == pair[1]:  # conditional on the other one
            other = sides[pair[0]].variance
            noise[name] *= np.sqrt(1 - covariance**2 / (other * side.variance))
            noise[name] += covariance / other * noise[pair[0]]
        drawn = side.mean + noise[name]
        if name != DEPTH:
            strange = rng.normal(*side.background, len(drawn))
            drawn = np.where(rng.random(len(drawn)) < side.outliers, strange, drawn)
        if side.extra is not None:
            drawn = drawn + side.extra.drawn(rng)
        found[name] = LIMITS.get(name, np.asarray)(drawn)
    return found
