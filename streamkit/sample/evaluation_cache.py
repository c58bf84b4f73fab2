"""All calls of the posterior that a run has made, on the disk: a sampler that is run again gets them for nothing."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from time import monotonic

import numpy as np

from streamkit.errors import ChainError, brief, printable
from streamkit.sample.journal import Journal
from streamkit.sample.posterior import Evaluation
from streamkit.sample.step import check_array
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
            if str(record.get("digest")) != digest:
                raise ChainError(f"{path}: holds the calls of another run. Nothing was changed.")
            try:
                self._known |= _evaluations_of(record)
            except (KeyError, ValueError, TypeError) as error:
                raise ChainError(f"{path}: holds a record that is none of calls ({brief(error)})") from None
        if self._journal is not None and self._journal.torn:
            logging.getLogger("streamkit").warning(
                "%s: ends with a part of a record (%d bytes), which was being written when the run ended. The part is "
                "dropped, and the run continues after %d calls.", path, self._journal.torn, len(self._known),
            )  # fmt: skip

    def __len__(self) -> int:
        """The number of points."""
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


def _evaluations_of(record: Mapping[str, Array]) -> dict[bytes, Evaluation]:
    """Return the evaluations of a record by the bytes of their points; ValueError, TypeError or KeyError if none."""
    points, ln, mean, variance, reason = (record[name] for name in ("points", "ln", "mean", "variance", "reason"))
    n, d = points.shape
    check_array("points", points, (n, d))
    check_array("ln", ln, (n, 2), finite=False)
    check_array("mean", mean, (n, *mean.shape[1:2]), finite=False)
    check_array("variance", variance, mean.shape, finite=False)
    if reason.shape != (n,) or reason.dtype.kind != "U":
        raise ValueError("reason holds no text for each point")
    texts = [printable(text) for text in reason.tolist()]
    return {
        point.tobytes(): Evaluation(float(lnp), float(lnl), *rest)
        for point, (lnp, lnl), *rest in zip(points, ln, mean, variance, texts, strict=True)
    }
