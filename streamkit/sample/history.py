"""What the ensemble tried while its moves were learning: refused proposals too, which emcee forgets."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from streamkit.sample.workers import Row, Workers
from streamkit.stream import Array


class Trials:
    """Evaluates an ensemble's proposals, as emcee's ``pool``, and keeps what the first steps found.

    A refused proposal says as much of the model as an accepted one, and most are refused. To be stored with each
    step, so that a resumed run learns what an unbroken one would.

    Parameters
    ----------
    pool
        Evaluates the posterior "full".
    steps, walkers, d, m
        Steps to keep, and the sizes of the ensemble, of a point and of a prediction.
    """

    def __init__(self, pool: Workers, steps: int, walkers: int, d: int, m: int) -> None:
        self._pool = pool
        self._d, self._m = d, m
        self._table = np.full((steps, walkers, d + 2 * m + 1), np.nan)
        self._rows: list[Array] = []

    def map(self, _function: Callable[..., Any], points: Iterable[Array]) -> list[Row]:
        """Evaluate the full posterior: what emcee calls. Its function is not sent: the workers hold it."""
        points = np.array(list(points))
        results = self._pool.evaluate(points)
        for point, r in zip(points, results, strict=True):
            self._rows.append(np.concatenate([point, r.mean, r.variance, [r.ln_likelihood]]))
        return [result.row() for result in results]

    def keep(self, step: int) -> Array | None:
        """Keep what was tried since the last call as that of a step; return it, None after the last step to keep."""
        rows, self._rows = self._rows, []
        if step >= len(self._table):
            return None
        self._table[step] = rows
        return np.array(self._table[step])

    def load(self, rows: Array) -> None:
        """Take up what a run kept that is now resumed: (steps, walkers, d + 2 m + 1); older ones lack ln likelihood."""
        self._table[: len(rows), :, : rows.shape[2]] = rows

    def until(self, step: int) -> tuple[Array, Array, Array, Array]:
        """Return the points (n, d) tried before a step; means (n, m), variances (n, m), ln likelihood (n,) found there.

        Outside the prior, and where there is no stream or no observable, these are NaN, and the last is -inf.
        """
        rows, d, m = self._table[:step].reshape(-1, self._table.shape[2]), self._d, self._m
        rows = rows[np.isfinite(rows[:, :d]).all(axis=1)]
        return rows[:, :d], rows[:, d : d + m], rows[:, d + m : -1], rows[:, -1]
