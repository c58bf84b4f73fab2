"""Directories of runs as streamkit 0.1.0 left them: they are read, and their runs are resumed."""

from __future__ import annotations

import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

import streamkit as sk
from streamkit.sample import CALLS, SAMPLES

ARCHIVE = Path(__file__).parents[2] / "data" / "runs_0.1.0.zip"


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    with zipfile.ZipFile(ARCHIVE) as archive:
        archive.extractall(tmp_path)
    return tmp_path


def stored_samples(runs: Path) -> np.ndarray:
    """Return the samples of the chain file alone, read without streamkit."""
    with h5py.File(runs / "chain" / "chain.h5") as file:
        return np.array(file["mcmc/chain"])


def test_the_results_are_read(runs: Path) -> None:
    chain = sk.load_results(runs / "chain", trust=True)
    assert chain.chain.shape == (11, 6, 2)
    np.testing.assert_array_equal(chain.chain[:8], stored_samples(runs))
    weighted = sk.load_results(runs / "weighted", trust=True).weighted
    assert weighted is not None
    with h5py.File(runs / "weighted" / SAMPLES) as file:
        np.testing.assert_array_equal(weighted.points, file["points"])
        np.testing.assert_array_equal(weighted.ln_weights, file["ln_weights"])


@pytest.mark.skipif(sk.__version__ != "0.1.0", reason="only the same version resumes a run")
def test_the_runs_are_resumed(runs: Path) -> None:
    before = sk.load_results(runs / "chain", trust=True).chain
    options = {"resume": True, "progress": False, "products": False}
    after = sk.run(runs / "chain" / "run.toml", runs / "chain", steps=26, **options)  # learns at step 25
    assert after.chain.shape == (26, 6, 2)
    np.testing.assert_array_equal(after.chain[:11], before)
    calls = (runs / "weighted" / CALLS).read_bytes()
    weighted = sk.run(runs / "weighted" / "run.toml", runs / "weighted", **options)
    assert weighted.calls == 40
    assert (runs / "weighted" / CALLS).read_bytes() == calls  # no point was evaluated again
