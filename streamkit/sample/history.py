"""What the ensemble tried while its moves were learning: refused proposals too, which emcee forgets."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from emcee.backends import Backend

from streamkit.sample.chain import ChainFile
from streamkit.sample.workers import Row, Workers
from streamkit.stream import Array

NAME, LN_LIKELIHOOD = "trials", "trials_ln_likelihood"


class Trials:
    """Evaluates an ensemble's proposals, as emcee's ``pool``, and keeps what the first steps found.

    A refused proposal says as much of the model as an accepted one, and most are refused. Stored beside the
    chain step by step, so that a resumed run learns what an unbroken one would.

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
        self._table = np.full((steps, walkers, d + 2 * m), np.nan)
        self._lnl = np.full((steps, walkers), np.nan)
        self._rows: list[Array] = []
        self._values: list[float] = []

    def map(self, _function: Callable[..., Any], points: Iterable[Array]) -> list[Row]:
        """Evaluate the full posterior: what emcee calls. Its function is not sent: the workers hold it."""
        points = np.array(list(points))
        results = self._pool.evaluate(points)
        self._rows += [np.concatenate([p, r.mean, r.variance]) for p, r in zip(points, results, strict=True)]
        self._values += [r.ln_likelihood for r in results]
        return [result.row() for result in results]

    def keep(self, step: int, backend: Backend) -> None:
        """Keep what was tried since the last call as that of a step, beside a chain in a file too."""
        (rows, self._rows), (values, self._values) = (self._rows, []), (self._values, [])
        if step >= len(self._table):
            return
        self._table[step], self._lnl[step] = rows, values
        if isinstance(backend, ChainFile):
            for name, table in self._tables.items():
                backend.put(name, table.shape, step, table[step])

    def load(self, backend: ChainFile) -> None:
        """Take up what a run kept that is now resumed."""
        for name, table in self._tables.items():
            kept = backend.get(name)
            if kept is not None and kept.shape == table.shape:
                table[:] = kept

    @property
    def _tables(self) -> dict[str, Array]:
        return {NAME: self._table, LN_LIKELIHOOD: self._lnl}

    def until(self, step: int) -> tuple[Array, Array, Array, Array]:
        """Return the points (n, d) tried before a step; means (n, m), variances (n, m), ln likelihood (n,) found there.

        Outside the prior, and where there is no stream or no observable, these are NaN, and the last is -inf.
        """
        rows, lnl = self._table[:step].reshape(-1, self._table.shape[2]), self._lnl[:step].ravel()
        known = np.isfinite(rows[:, : self._d]).all(axis=1)
        rows, d, m = rows[known], self._d, self._m
        return rows[:, :d], rows[:, d : d + m], rows[:, d + m :], lnl[known]
