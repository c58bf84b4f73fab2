"""The file of weighted samples: what is read must fit together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import streamkit as sk
from streamkit.sample import SAMPLES, Weighted, blob_dtype, read_weighted

GOOD = Weighted(
    np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]),
    np.array([0.0, -1.0, -2.0]),
    np.array([-3.0, -np.inf, -5.0]),
    np.zeros(3, dtype=blob_dtype(2)),
    ln_evidence=-10.0,
    ln_evidence_error=0.1,
    missing="",
    attributes={"digest": "0" * 64},
)


def test_what_was_written_is_read(tmp_path: Path) -> None:
    GOOD.write(tmp_path / SAMPLES)
    samples = read_weighted(tmp_path / SAMPLES)
    for name in ("points", "ln_weights", "log_prob", "blobs"):
        np.testing.assert_array_equal(getattr(samples, name), getattr(GOOD, name))
    assert samples.ln_evidence == -10.0


@pytest.mark.parametrize(
    ("name", "change", "reason"),
    [
        ("points", lambda x: x[:, 0], "not enough values"),
        ("points", lambda x: x[:2], "ln_weights is no array of numbers of shape"),
        ("points", lambda x: x.astype(int), "points is no array of numbers of shape"),
        ("points", lambda x: x * np.nan, "points is no array of numbers of shape"),
        ("ln_weights", lambda x: x[:, None], "ln_weights is no array of numbers of shape"),
        ("ln_weights", lambda x: x * np.nan, "ln_weights is no array of numbers of shape"),
        ("log_prob", lambda x: x[:2], "log_prob is no array of numbers of shape"),
        ("log_prob", lambda x: x * np.nan, "log_prob holds no numbers"),
        ("blobs", lambda x: x[:2], "blobs holds no record for each sample"),
        ("blobs", lambda x: x["mean"], "blobs holds no record for each sample"),
    ],
)
def test_arrays_that_do_not_fit_together_are_an_error(
    tmp_path: Path, name: str, change: Callable[[Any], Any], reason: str
) -> None:
    path = tmp_path / SAMPLES
    replace(GOOD, **{name: change(getattr(GOOD, name))}).write(path)
    with pytest.raises(sk.ChainError, match=f"^{path}: was damaged or changed after it was written: .*{reason}"):
        read_weighted(path)
