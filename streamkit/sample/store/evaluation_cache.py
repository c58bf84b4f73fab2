"""A cache of evaluations by their point, in memory and on the disk: a repeated run does not make them again."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from time import monotonic

import numpy as np

from streamkit.errors import ChainError, brief, printable
from streamkit.sample.evaluation import Evaluation, details_of
from streamkit.sample.store.journal import Journal
from streamkit.sample.store.step import check_array
from streamkit.stream import Array, BoolArray

CALLS, SMALL_CALLS, EARLIER_CALLS = "calls.journal", "small_calls.journal", "earlier_calls.journal"
NO_DATA: Array = np.empty(0)
PERIOD = 1.0  # seconds between two writes: a kill loses at most this much work, any other interruption loses none


class EvaluationCache:
    """The evaluations of a run by point: in a journal, or in memory without a path.

    ``digest`` is that of the run, ``d`` the number of its parameters, and ``values`` (m,) are its data, NaN where one
    is not compared. Raises ChainError if the file is damaged, or that of another run.
    """

    def __init__(self, path: Path | None = None, digest: str = "", d: int = 0, values: Array = NO_DATA) -> None:
        self._digest = digest
        details = 0  # of a prediction: the same number for all
        self._evaluations: dict[bytes, Evaluation] = {}
        self._unwritten: list[tuple[Array, Evaluation]] = []
        self._written = monotonic()
        self._journal = None if path is None else Journal(path)
        for record in self._journal.read() if self._journal is not None else ():
            if str(record.get("digest")) != digest:
                raise ChainError(f"{path}: holds the calls of another run. Nothing was changed.")
            try:
                evaluations = _evaluations_of(record, d, np.isfinite(values))
                widths = {details, *(len(each.details) for each in evaluations.values())} - {0}
                if len(widths) > 1:
                    raise ValueError(f"details has {max(widths)} columns, and {min(widths)} elsewhere")
                details = max(widths, default=0)
                self._evaluations |= evaluations
            except (KeyError, ValueError, TypeError) as error:
                raise ChainError(f"{path}: holds a record that is none of calls ({brief(error)})") from None
        if self._journal is not None and self._journal.torn:
            logging.getLogger("streamkit").warning(
                "%s: ends with a part of a record (%d bytes), which was being written when the run ended. The part is "
                "dropped, and the run continues after %d calls.", path, self._journal.torn, len(self._evaluations),
            )  # fmt: skip

    def __len__(self) -> int:
        """The number of points."""
        return len(self._evaluations)

    @property
    def reasons(self) -> dict[str, int]:
        """Evaluations without a likelihood, by reason."""
        return dict(Counter(each.reason for each in self._evaluations.values() if each.reason))

    def all(self) -> dict[bytes, Evaluation]:
        """Return all evaluations, by the bytes of their points."""
        return dict(self._evaluations)

    def __contains__(self, point: Array) -> bool:
        return point.tobytes() in self._evaluations

    def any_good(self) -> Array | None:
        """Return the first point (d,) with a likelihood; None without one."""
        good = (np.frombuffer(key) for key, each in self._evaluations.items() if not each.reason)
        return next(good, None)

    def missing(self, points: Array) -> list[Array]:
        """Return those of the points (n, d) that are not in the cache, each once."""
        return list({key: p for p in points if (key := p.tobytes()) not in self._evaluations}.values())

    def get(self, points: Array) -> list[Evaluation]:
        """Return the evaluations at points (n, d), in order; KeyError if one is not in the cache."""
        return [self._evaluations[point.tobytes()] for point in points]

    def add(self, point: Array, evaluation: Evaluation) -> None:
        """Store an evaluation at a point (d,) in memory; `write` puts it on the disk."""
        self._evaluations[point.tobytes()] = evaluation
        if self._journal is not None:
            self._unwritten.append((point, evaluation))

    def take(self, evaluations: Mapping[bytes, Evaluation]) -> None:
        """Add evaluations by the bytes of their points, and write them."""
        for key, evaluation in evaluations.items():
            self.add(np.frombuffer(key), evaluation)
        self.write()

    def keep_only(self, points: Array) -> None:
        """Drop all evaluations but those at points (n, d): a chain needs no others."""
        self._evaluations = {key: self._evaluations[key] for point in points if (key := point.tobytes())}

    def write(self, at_once: bool = True) -> None:
        """Write new evaluations to the disk: at once, or if the last write is `PERIOD` ago.

        Raises ChainError if the disk is full; the evaluations written before stay readable.
        """
        if not at_once and monotonic() - self._written < PERIOD:
            return
        if self._unwritten and self._journal is not None:
            points, evaluations = zip(*self._unwritten, strict=True)
            details = details_of(evaluations)
            self._journal.append(
                {
                    "digest": np.array(self._digest),
                    "points": np.array(points),
                    "ln": np.array([(each.lnp, each.ln_likelihood) for each in evaluations]),
                    "mean": np.array([each.mean for each in evaluations]),
                    "variance": np.array([each.variance for each in evaluations]),
                    "reason": np.array([each.reason for each in evaluations]),
                    **({"details": details} if details.size else {}),
                }
            )
        self._unwritten, self._written = [], monotonic()


def calls_in(path: Path) -> int:
    """Return how many evaluations a journal holds; 0 without a file. ChainError for a file that cannot be read."""
    points = [record["points"] for record in Journal(path).read() if "points" in record]
    if any(each.ndim != 2 for each in points):
        raise ChainError(f"{path}: holds a record that is none of calls (points have another shape than (n, d))")
    return sum(map(len, points))


def _evaluations_of(record: Mapping[str, Array], d: int, used: BoolArray) -> dict[bytes, Evaluation]:
    """Return the evaluations of a record by the bytes of their points; ValueError, TypeError or KeyError if none.

    A point has d parameters. A point without a reason has a likelihood, and predictions of the data that are ``used``.
    """
    points, ln, mean, variance, reason = (record[name] for name in ("points", "ln", "mean", "variance", "reason"))
    n = len(points)
    details = record.get("details", np.empty((n, 0)))
    check_array("points", points, (n, d))
    check_array("ln", ln, (n, 2), finite=False)
    check_array("mean", mean, (n, len(used)), finite=False)
    check_array("variance", variance, (n, len(used)), finite=False)
    check_array("details", details, (n, *details.shape[1:2]), finite=False)
    if reason.shape != (n,) or reason.dtype.kind != "U":
        raise ValueError("reason holds no text for each point")
    good = reason == ""
    if not np.isneginf(ln[~good]).all():
        raise ValueError("ln holds numbers of points that have none, for a reason")
    for name, values in (("ln", ln[good]), ("mean", mean[good][:, used]), ("variance", variance[good][:, used])):
        if not np.isfinite(values).all() or (name == "variance" and (values < 0).any()):
            raise ValueError(f"{name} holds NaN, infinite or negative numbers that no call gives")
    texts = [printable(text) for text in reason.tolist()]
    return {
        point.tobytes(): Evaluation(
            float(ln[i, 0]), float(ln[i, 1]), mean[i], variance[i], texts[i], np.empty(0) if texts[i] else details[i]
        )
        for i, point in enumerate(points)
    }
