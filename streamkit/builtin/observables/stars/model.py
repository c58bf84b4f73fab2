"""What is predicted of a stream at knots along phi1, and what the run file says of its stars, at n points at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from streamkit import Array

# A number, or (1, n) at n points.
Numbers = float | Array


class Model(NamedTuple):
    """What is predicted at K knots for n points, C columns.

    Attributes
    ----------
    mean, spread
        (C, K, n) of the debris, in the units of the columns.
    mean_variance, spread_variance
        (C, K, n) of these estimates; None where they count as exact.
    ln_coverage, ln_odds
        (K, n) ln of the chance of any debris; ln of the odds of a star to be of the stream, over those of the fraction.
    """

    mean: Array
    spread: Array
    mean_variance: Array | None
    spread_variance: Array | None
    ln_coverage: Array
    ln_odds: Array

    def take(self, points: slice) -> Model:
        """Return those of some points."""
        return Model(*(None if part is None else part[..., points] for part in self))  # type: ignore[arg-type]


class Part(NamedTuple):
    """One part of the stream: all of it, the thin stream, or a cocoon about it.

    Attributes
    ----------
    share
        The part's fraction of the stream's stars.
    dispersions
        By column, added in squares to the spread of the debris.
    """

    share: Numbers
    dispersions: Mapping[str, Numbers]


class Settings(NamedTuple):
    """What the run file says: the fraction of the stars that are of the stream, and the parts of the stream."""

    fraction: Numbers
    parts: Sequence[Part]

    def take(self, points: slice) -> Settings:
        """Return those of some points."""
        parts = [Part(_some(part.share, points), {k: _some(v, points) for k, v in part.dispersions.items()})
                 for part in self.parts]  # fmt: skip
        return Settings(_some(self.fraction, points), parts)


def _some(numbers: Numbers, points: slice) -> Numbers:
    return numbers if np.ndim(numbers) == 0 else np.asarray(numbers)[:, points]
