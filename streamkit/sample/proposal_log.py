"""What the ensemble tried while its moves were learning: refused proposals too, which emcee forgets."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from streamkit.sample.workers import Row, Workers
from streamkit.stream import Array


class ProposalLog:
    """Evaluates an ensemble's proposals, as emcee's ``pool``, and keeps what the first steps found.

    A refused proposal says as much of the model as an accepted one, and most are refused. To be stored with each
    step, so that a resumed run learns what an unbroken one would.

    Parameters
    ----------
    pool
        Evaluates the posterior "full".
    walkers, d, m
        Sizes of the ensemble, of a point and of a prediction.
    """

    def __init__(self, pool: Workers, walkers: int, d: int, m: int) -> None:
        self._pool = pool
        self._d, self._m = d, m
        self._nothing = np.full((walkers, d + 2 * m + 1), np.nan)
        self._steps: list[Array] = []
        self._rows: list[Array] = []

    def map(self, _function: Callable[..., Any], points: Iterable[Array]) -> list[Row]:
        """Evaluate the full posterior: what emcee calls. Its function is not sent: the workers hold it."""
        points = np.array(list(points))
        results = self._pool.evaluate(points)
        for point, r in zip(points, results, strict=True):
            self._rows.append(np.concatenate([point, r.mean, r.variance, [r.ln_likelihood]]))
        return [result.row() for result in results]

    def keep(self, step: int, learning: bool) -> Array | None:
        """Keep what was tried since the last call as that of a step, and return it; None where nothing is learned."""
        rows, self._rows = self._rows, []
        if not learning:
            return None
        self._steps += [self._nothing] * (step - len(self._steps))
        self._steps.append(np.array(rows))
        return self._steps[-1]

    def load(self, rows: Array) -> None:
        """Take up what a run kept that is now resumed: (steps, walkers, d + 2 m + 1); older ones lack ln likelihood."""
        missing = self._nothing.shape[1] - rows.shape[2]
        self._steps = list(np.pad(rows, [(0, 0), (0, 0), (0, missing)], constant_values=np.nan))

    def until(self, step: int) -> tuple[Array, Array, Array, Array]:
        """Return the points (n, d) tried before a step; means (n, m), variances (n, m), ln likelihood (n,) found there.

        Outside the prior, and where there is no stream or no observable, these are NaN, and the last is -inf.
        """
        rows, d, m = np.concatenate([self._nothing, *self._steps[:step]]), self._d, self._m
        rows = rows[np.isfinite(rows[:, :d]).all(axis=1)]
        return rows[:, :d], rows[:, d : d + m], rows[:, d + m : -1], rows[:, -1]
