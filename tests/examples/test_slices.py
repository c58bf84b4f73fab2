"""The manual's chain sampler in a run: resumed, with workers, and with all that chains get from streamkit."""

import copy
import json
from pathlib import Path

import numpy as np
import pytest
from commands import call
from runfiles import FIT

import streamkit as sk
from streamkit.runfile import to_toml

FILE = Path(__file__).with_name("slices.py")


@pytest.fixture(scope="module")
def run_file(tmp_path_factory):
    folder = tmp_path_factory.mktemp("slices")
    document = copy.deepcopy(FIT) | {"plugins": [str(FILE)]}
    document["sampler"] = {"kind": "slices", "walkers": 4, "steps": 3}
    (folder / "run.toml").write_text(to_toml(sk.load(document).document))
    return folder / "run.toml"


@pytest.fixture(scope="module")
def whole(run_file):
    out = run_file.parent / "whole"
    return sk.run(run_file, out=out, progress=False)


def test_it_has_the_products_and_verdicts_of_a_chain(whole):
    assert whole.chain.shape == (3, 4, 2)
    assert whole.status == "steps"
    assert "3 steps" in whole.note()
    assert not whole.failed
    assert {"traces.png", "corner.png", "report.html", "chain.h5"} <= {path.name for path in whole.directory.iterdir()}
    subjects = [verdict.subject for verdict in whole.draws.verdicts()]
    assert "R-hat" in subjects
    status = json.loads(call("status", str(whole.directory), "--json", "--trust").output)
    assert (status["steps"], status["walkers"]) == (3, 4)


@pytest.mark.slow
def test_a_resumed_run_with_workers_has_the_same_chain(whole, run_file):
    out = run_file.parent / "parts"
    sk.run(run_file, out=out, steps=1, workers=2, progress=False, products=False)
    parts = sk.run(run_file, out=out, resume=True, workers=2, progress=False, products=False)
    np.testing.assert_array_equal(parts.chain, whole.chain)
    np.testing.assert_array_equal(parts.log_prob, whole.log_prob)
    np.testing.assert_array_equal(parts.blobs, whole.blobs)
