"""All calls of the posterior that a run has made, on the disk: a sampler that is run again gets them for nothing."""

from __future__ import annotations

import logging
from collections import Counter
from pathlib import Path
from time import monotonic

import numpy as np

from streamkit.errors import ChainError
from streamkit.sample.journal import Journal
from streamkit.sample.posterior import Evaluation
from streamkit.sample.workers import Stopped, Workers
from streamkit.stream import Array

CALLS = "calls.journal"
# Seconds between two writes to the disk: as much work is lost if the process is killed, and nothing at other ends.
PERIOD = 1.0
PART = 256  # points that the workers are given at a time: what they have done by then is kept if the run is stopped


class EvaluationCache:
    """Evaluates points with the workers, each once: what is known of a point is not computed again.

    Parameters
    ----------
    pool
        Evaluates the posterior "full".
    path
        Where the calls are kept; None keeps them in memory.
    digest
        That of the run they belong to.

    Raises ChainError if the file is damaged, or that of another run.
    """

    def __init__(self, pool: Workers, path: Path | None = None, digest: str = "") -> None:
        self._pool, self._digest = pool, digest
        self._known: dict[bytes, Evaluation] = {}
        self._new: list[tuple[Array, Evaluation]] = []
        self._written = monotonic()
        self._journal = None if path is None else Journal(path)
        for record in self._journal.read() if self._journal is not None else ():
            if str(record["digest"]) != digest:
                raise ChainError(f"{path}: holds the calls of another run. Nothing was changed.")
            rows = zip(*(record[name] for name in ("points", "ln", "mean", "variance", "reason")), strict=True)
            for point, (lnp, lnl), mean, variance, reason in rows:
                self._known[point.tobytes()] = Evaluation(float(lnp), float(lnl), mean, variance, str(reason))
        if self._journal is not None and self._journal.torn:
            logging.getLogger("streamkit").warning(
                "%s: ends with a part of a record (%d bytes), which was being written when the run ended. The part is "
                "dropped, and the run continues after %d calls.", path, self._journal.torn, len(self._known),
            )  # fmt: skip

    def __len__(self) -> int:
        return len(self._known)

    @property
    def reasons(self) -> dict[str, int]:
        """Calls without an answer, by reason."""
        return dict(Counter(found.reason for found in self._known.values() if found.reason))

    def evaluate(self, points: Array) -> list[Evaluation]:
        """Evaluate at points (n, d), in order; what is raised on the way leaves what was found before kept."""
        points = np.ascontiguousarray(points, dtype=float)
        keys = [point.tobytes() for point in points]
        todo = {key: point for key, point in zip(keys, points, strict=True) if key not in self._known}
        missing = list(todo.values())
        if not missing and self._pool.stop:
            raise Stopped(self._pool.stop)
        for begin in range(0, len(missing), PART):
            part = missing[begin : begin + PART]
            for point, found in zip(part, self._pool.evaluate(np.array(part)), strict=True):
                self._known[point.tobytes()] = found
                self._new.append((point, found))
            if monotonic() - self._written > PERIOD:
                self.write()
        return [self._known[key] for key in keys]

    def write(self) -> None:
        """Put what is new on the disk. ChainError if that is full: the calls before are readable."""
        if self._new and self._journal is not None:
            points, found = zip(*self._new, strict=True)
            self._journal.append(
                {
                    "digest": np.array(self._digest),
                    "points": np.array(points),
                    "ln": np.array([(each.lnp, each.ln_likelihood) for each in found]),
                    "mean": np.array([each.mean for each in found]),
                    "variance": np.array([each.variance for each in found]),
                    "reason": np.array([each.reason for each in found]),
                }
            )
        self._new, self._written = [], monotonic()
