"""Manifests, journals and files of a strange kind that somebody put into a run's directory: one sentence for each."""

from __future__ import annotations

import json
import os
import random
import shutil
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import call, refused
from forging import forging

import streamkit as sk
from streamkit.fit import describe_status, read_status
from streamkit.fit.directory.manifest import manifest
from streamkit.sample import CALLS, SAMPLES, blob_dtype, read_chain_file
from streamkit.sample.store.evaluation_cache import EvaluationCache
from streamkit.sample.store.journal import Journal

ARCHIVE = Path(__file__).parents[2] / "data" / "runs_0.1.0.zip"
VALUES: list[Any] = [
    None, True, -1, 0, 10**400, 1e308, float("nan"), float("inf"), "", "x" * 5000, "\x1b[2J\x07", "\ud800", [], [None],
    {}, {"a": {}}, [[[]]],
]  # fmt: skip


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    with zipfile.ZipFile(ARCHIVE) as archive:
        archive.extractall(tmp_path)
    return tmp_path


def variants(document: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield copies of a document with one entry, at any depth, missing or replaced by each of `VALUES`."""
    for key, value in document.items():
        yield {name: other for name, other in document.items() if name != key}
        yield from (document | {key: each} for each in VALUES)
        if isinstance(value, dict):
            yield from (document | {key: inner} for inner in variants(value))


def test_a_forged_manifest_is_one_sentence_or_readable(runs: Path) -> None:
    path = runs / "chain" / "manifest.json"
    whole = json.loads(path.read_text())
    (runs / "chain" / "run.toml").unlink()  # so that the status is of the manifest alone
    (runs / "chain" / "chain.h5").unlink()
    (runs / "chain" / "chain.journal").unlink()
    number = 0
    for document in [*variants(whole), *VALUES]:
        path.write_text(json.dumps(document))
        number += 1
        try:
            text = describe_status(runs / "chain", read_status(runs / "chain"))
        except sk.ChainError as error:
            text = str(error)
            assert "manifest" in text
        assert "\x1b" not in text
        assert "\x07" not in text
    assert number > 300
    path.write_text("[" * 100_000)
    assert "is not readable" in refused("status", runs / "chain")


def test_control_characters_of_a_manifest_are_not_printed(runs: Path) -> None:
    path = runs / "chain" / "manifest.json"
    document = json.loads(path.read_text())
    document["options"]["arguments"] = ["--engine", "\x1b]0;mine\x07\x9b31m"]
    path.write_text(json.dumps(document))
    result = call("status", runs / "chain", "--trust")
    assert result.exit_code == 0
    assert "?]0;mine??31m" in result.output
    assert not any(ord(letter) < 32 and letter != "\n" for letter in result.output)
    assert manifest(runs / "chain")["options"]["arguments"][1] == "?]0;mine??31m"


def forged(record: dict[str, Any], rng: random.Random) -> Iterator[dict[str, Any]]:
    """Yield records with one array missing, of another type, shape or content."""
    for name, array in record.items():
        array = np.asarray(array)
        yield {key: value for key, value in record.items() if key != name}
        for other in (
            array[..., None], array[:0] if array.ndim else array, array.ravel()[: rng.randrange(9)], np.zeros(()),
            np.array("text"), np.array(["text"] * len(array) if array.ndim else "x"), np.zeros(array.shape, complex),
            np.full(array.shape, np.nan), np.full(array.shape, 2**62), np.zeros((2, 3, 4)), np.zeros(array.shape, bool),
        ):  # fmt: skip
            yield record | {name: other}


@pytest.mark.slow
def test_forged_steps_are_one_sentence(runs: Path) -> None:
    chain = runs / "chain" / "chain.h5"
    whole = Journal(chain.with_suffix(".journal")).read()
    rng, number = random.Random(1), 0
    about = json.loads(whole[0]["about"].tobytes())
    texts = [json.dumps(each).encode() for each in [*variants(about), *VALUES]] + [b"", b"{", b"\xff" * 9, b"[" * 10**5]
    records = [*forged(whole[0], rng), *(whole[0] | {"about": np.frombuffer(t, dtype=np.uint8)} for t in texts)]
    for record in records:
        journal = Journal(chain.with_suffix(".journal"))
        journal.clear()
        for each in (record, *whole[1:]):
            journal.append(each)
        number += 1
        with suppress(sk.ChainError):
            assert len(read_chain_file(chain).chain) == 11  # what was forged is not a part of the samples
    assert number > 250


class Nothing:
    """No worker: nothing is evaluated."""

    stop = 0

    def evaluate(self, points: Any) -> Any:
        raise AssertionError("no point is new")


def test_forged_calls_are_one_sentence(runs: Path) -> None:
    path = runs / "weighted" / CALLS
    digest = manifest(runs / "weighted")["digest"]
    (first, *rest), number = Journal(path).read(), 0
    whole = first["points"]
    for record in forged(first, random.Random(2)):
        journal = Journal(path)
        journal.clear()
        for each in (record, *rest):
            journal.append(each)
        number += 1
        with suppress(sk.ChainError):
            cache = EvaluationCache(path, digest, whole.shape[1], np.zeros(2))
            known = [point for point in whole if not cache.missing(point[None])]
            assert np.isfinite([each.lnp for each in cache.get(np.array(known))]).all()
    assert number > 50


def test_samples_that_no_call_gave_are_refused(runs: Path) -> None:
    """ln p is the sum of prior and likelihood; a point outside of the prior has none."""
    path, told = runs / "weighted" / SAMPLES, "was damaged or changed after it was written: ln p of"
    whole = path.read_bytes()
    for name, shift in (("points", 1e3), ("log_prob", 1.0)):
        path.write_bytes(whole)
        with forging(path) as file:
            file[name][...] += shift
        with pytest.raises(sk.ChainError, match=told):
            sk.load_results(runs / "weighted", trust=True)
    path.write_bytes(whole)
    with forging(path) as file:
        wider = np.zeros(len(file["points"]), dtype=blob_dtype(3))
        del file["blobs"]
        file["blobs"] = wider
    with pytest.raises(sk.ChainError, match=r"its samples have 2 parameters and 3 data, those of run\.toml are"):
        sk.load_results(runs / "weighted", trust=True)


def test_calls_of_another_shape_are_not_counted(runs: Path) -> None:
    path = runs / "weighted" / CALLS
    (first, *_) = Journal(path).read()
    Journal(path).append(first | {"points": np.zeros(())})
    assert "points have another shape" in refused("status", runs / "weighted", "--trust")


@pytest.mark.timeout(300)
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in folders")
@pytest.mark.parametrize("name", ["chain.h5", "chain.journal", "manifest.json", "run.toml", "plugins/distance.py",
                                  "data/table.npy", "literature.ecsv"])  # fmt: skip
def test_a_pipe_in_place_of_a_file_is_not_waited_for(runs: Path, name: str) -> None:
    shutil.copytree(runs / "chain", runs / "original")
    path = runs / "chain" / name
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    resume = ["run", runs / "original" / "run.toml", "-o", runs / "chain", "--resume", "-q", "--steps", "30"]
    commands = [["report", runs / "chain", "--trust"], ["status", runs / "chain", "--trust"], resume]
    for command in commands if name != "literature.ecsv" else commands[:1]:
        assert path.name in refused(*command)
    assert path.is_fifo()
