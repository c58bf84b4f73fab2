"""The journal of calls: what is in it must be what calls give."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import streamkit as sk
from streamkit.sample import Evaluation
from streamkit.sample.store.evaluation_cache import EvaluationCache
from streamkit.sample.store.journal import Journal

DATA = np.array([1.0, np.nan, 3.0])  # the second datum is not compared
POINTS = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
NOTHING = np.full(3, np.nan)
EVALUATIONS = [
    Evaluation(-3.0, -2.0, np.array([1.5, np.nan, 2.5]), np.array([0.1, np.nan, 0.0]), details=np.array([7.0, 8.0])),
    Evaluation(-np.inf, -np.inf, NOTHING, NOTHING, "no stream"),
    Evaluation(-4.0, -3.0, np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.1, 0.1]), details=np.array([7.0, 9.0])),
]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    cache = EvaluationCache(tmp_path / "calls.journal", "run", 2, DATA)
    for point, evaluation in zip(POINTS, EVALUATIONS, strict=True):
        cache.add(point, evaluation)
    cache.write()
    return tmp_path / "calls.journal"


def test_what_was_written_is_read(path: Path) -> None:
    cache = EvaluationCache(path, "run", 2, DATA)
    for found, wanted in zip(cache.get(POINTS), EVALUATIONS, strict=True):
        assert (found.lnp, found.ln_likelihood, found.reason) == (wanted.lnp, wanted.ln_likelihood, wanted.reason)
        for name in ("mean", "variance", "details"):
            np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))


def changed(values: Any, place: Any, value: float) -> Any:
    values = values.copy()
    values[place] = value
    return values


@pytest.mark.parametrize(
    ("name", "change", "reason"),
    [
        ("points", lambda x: x[:, :1], "points is no array of floats of shape (3, 2)"),
        ("points", lambda x: x * np.nan, "points holds NaN"),
        ("mean", lambda x: x[:, :2], "mean is no array of floats of shape (3, 3)"),
        ("variance", lambda x: x[:, :2], "variance is no array of floats of shape (3, 3)"),
        ("mean", lambda x: changed(x, (0, 0), np.nan), "mean holds NaN"),
        ("variance", lambda x: changed(x, (2, 2), -1e-9), "variance holds NaN, infinite or negative"),
        ("variance", lambda x: changed(x, (2, 2), np.inf), "variance holds NaN, infinite or negative"),
        ("ln", lambda x: changed(x, (0, 0), np.nan), "ln holds NaN"),
        ("ln", lambda x: changed(x, (0, 1), -np.inf), "ln holds NaN, infinite"),
        ("ln", lambda x: changed(x, (1, 0), -3.0), "ln holds numbers of points that have none"),
        ("reason", lambda x: np.array(["", "", ""]), "ln holds NaN, infinite"),
        ("reason", lambda x: np.array(["", "no stream", "outside"]), "ln holds numbers of points that have none"),
        ("reason", lambda x: x[:1], "reason holds no text"),
    ],
)
def test_forged_calls_are_an_error(path: Path, name: str, change: Any, reason: str) -> None:
    (record,) = Journal(path).read()
    journal = Journal(path)
    journal.clear()
    journal.append(record | {name: change(record[name])})
    with pytest.raises(sk.ChainError, match=f"^{path}: holds a record that is none of calls") as caught:
        EvaluationCache(path, "run", 2, DATA)
    assert reason in str(caught.value)


def test_details_of_two_widths_are_an_error(path: Path) -> None:
    (record,) = Journal(path).read()
    Journal(path).append(record | {"details": record["details"][:, :1]})
    with pytest.raises(sk.ChainError, match="details has 2 columns, and 1 elsewhere"):
        EvaluationCache(path, "run", 2, DATA)


def test_a_record_that_claims_to_be_larger_than_it_is_is_an_error(path: Path) -> None:
    """A compressed record: a thousand times its bytes may come out of it."""
    journal = Journal(path)
    journal.read()
    file = path.with_name("packed.npz")
    np.savez_compressed(file, points=np.zeros(10**6))
    journal_body = file.read_bytes()
    with pytest.raises(sk.ChainError, match="claim to be larger than it is"):
        forged(path, journal_body).read()


def forged(path: Path, body: bytes) -> Journal:
    """Return a journal with a body of another making."""
    from streamkit.sample.store.journal import LENGTH, MAGIC, _checksum

    path.write_bytes(MAGIC + len(body).to_bytes(LENGTH, "little") + _checksum(body) + body)
    return Journal(path)
