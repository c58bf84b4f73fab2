"""The file of weighted samples: what is read must fit together."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from forging import forging

import streamkit as sk
from streamkit.components import Evaluations, Samples
from streamkit.sample import SAMPLES, Weighted, blob_dtype, read_weighted
from streamkit.sample.sampling import _weighted

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
        ("points", lambda x: x[:2], "ln_weights is no array of floats of shape"),
        ("points", lambda x: x.astype(int), "points is no array of floats of shape"),
        ("points", lambda x: x * np.nan, "points holds NaN"),
        ("ln_weights", lambda x: x[:, None], "ln_weights is no array of floats of shape"),
        ("ln_weights", lambda x: x * np.nan, "ln_weights holds NaN"),
        ("log_prob", lambda x: x[:2], "log_prob is no array of floats of shape"),
        ("log_prob", lambda x: x * np.nan, "log_prob holds no numbers"),
        ("log_prob", lambda x: np.full(3, np.inf), "log_prob holds no numbers"),
        ("blobs", lambda x: x[:2], "blobs holds no record of a prediction"),
        ("blobs", lambda x: x["mean"], "blobs holds no record of a prediction"),
        ("blobs", lambda x: x[["ln_likelihood", "mean"]], "blobs holds no record of a prediction"),
        ("blobs", lambda x: np.full(3, -1.0, dtype=x.dtype), "blobs holds a negative variance"),
    ],
)
def test_arrays_that_do_not_fit_together_are_an_error(
    tmp_path: Path, name: str, change: Callable[[Any], Any], reason: str
) -> None:
    path, array = tmp_path / SAMPLES, change(getattr(GOOD, name))
    GOOD.write(path)
    with forging(path) as file:
        del file[name]
        file[name] = array
    with pytest.raises(sk.ChainError, match=f"^{path}: was damaged or changed after it was written: .*{reason}"):
        read_weighted(path)


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("missing", 3, "missing: Input should be a valid string, found 3"),
        ("status", "fine", "status: Input should be"),
        ("quick", "no", "quick: Input should be a valid boolean"),
        ("ln_evidence", "large", "ln_evidence: Input should be a valid number"),
        ("counts", '{"calls": -1}', "counts.calls: Input should be greater than or equal to 0"),
        ("counts", '{"calls": 1e400}', "counts.calls: Input should be a valid integer"),
        ("counts", '{"reasons": {"too few": "many"}}', "counts.reasons.too few: Input should be a valid integer"),
        ("counts", '{"facts": {"n": 3}}', "counts.facts.n: Input should be a valid string"),
        ("counts", "[", "Expecting value"),
        ("verdicts", "[3]", "verdicts.0: Input should be"),
        ("verdicts", '[{"subject": "s", "level": "good", "value": "", "sentence": "", "rule": ""}]', "0.level: Input"),
        ("verdicts", '[{"subject": "s", "level": "fine", "value": "", "sentence": ""}]', "0.rule: is missing"),
    ],
)
def test_a_note_of_another_kind_is_an_error(tmp_path: Path, name: str, value: Any, reason: str) -> None:
    path = tmp_path / SAMPLES
    GOOD.write(path)
    with forging(path) as file:
        file.attrs[name] = value
    with pytest.raises(sk.ChainError, match=r"^[^\n]*was damaged or changed after it was written: [^\n]*$") as caught:
        read_weighted(path)
    assert reason in str(caught.value)


def test_texts_of_a_file_have_no_control_characters(tmp_path: Path) -> None:
    path, evil = tmp_path / SAMPLES, "so\n\x1b[2J\x9b31m"
    verdict = {"subject": evil, "level": "fine", "value": evil, "sentence": evil, "rule": evil}
    GOOD.write(path)
    with forging(path) as file:
        file.attrs["missing"] = evil
        file.attrs["counts"] = json.dumps({"reasons": {evil: 2}, "facts": {evil: evil}})
        file.attrs["verdicts"] = json.dumps([verdict])
    samples, clean = read_weighted(path), "so ?[2J?31m"
    assert samples.missing == clean
    assert samples.attributes["counts"] == {"reasons": {clean: 2}, "facts": {clean: clean}}
    assert samples.verdicts == (sk.Verdict(clean, "fine", clean, clean, clean),)


def test_what_a_sampler_gives_is_checked_before_it_is_written(tmp_path: Path) -> None:
    """Numbers of another type become floats; what cannot be read again is an error of the component."""
    path = tmp_path / SAMPLES
    replace(GOOD, points=GOOD.points.astype("f4"), log_prob=np.array([-3, -4, -5]), missing="a\nb").write(path)
    samples = read_weighted(path)
    np.testing.assert_array_equal(samples.points, GOOD.points)
    np.testing.assert_array_equal(samples.log_prob, [-3.0, -4.0, -5.0])
    assert samples.missing == "a b"
    before = path.read_bytes()
    odd: dict[str, Any] = {"missing": None, "points": GOOD.points * 1j, "ln_weights": GOOD.ln_weights * np.nan,
                           "ln_evidence": "x", "attributes": {"counts": {"facts": {"n": 3}}},
                           "verdicts": (sk.Verdict("s", "good", "", "", ""),)}  # fmt: skip
    for name, value in odd.items():
        with pytest.raises(sk.ComponentError, match=r"^samples cannot be stored: "):
            replace(GOOD, **{name: value}).write(path)
    assert path.read_bytes() == before


def test_evaluations_of_an_emulator_add_up() -> None:
    """ln p is the sum of prior and likelihood, which the reader of a directory asks for."""
    storage = SimpleNamespace(evaluations=None, calls=1, small_calls=0, reasons={})
    target: Any = SimpleNamespace(
        size=1, data=SimpleNamespace(values=np.zeros(1)), ln_prior=lambda points: np.full(len(points), -1.0),
        storage=storage,
    )  # fmt: skip

    def samples(ln_probability: list[float]) -> Samples:
        lnl, nothing = np.array([-2.0, -np.inf]), np.zeros((2, 1))
        evaluations = Evaluations(np.array(ln_probability), lnl, nothing, nothing, ("", "no stream"))
        return Samples(np.zeros((2, 1)), np.zeros(2), evaluations=evaluations)

    np.testing.assert_array_equal(_weighted(target, samples([-3.0, -np.inf])).log_prob, [-3.0, -np.inf])
    with pytest.raises(sk.ComponentError, match=r"ln_probability is not ln prior \+ ln_likelihood"):
        _weighted(target, samples([-2.0, -np.inf]))
