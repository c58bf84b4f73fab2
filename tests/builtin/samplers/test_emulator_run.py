"""The sampler `emulator` in a run: certified, resumed without a call, and the same for any number of workers."""

import numpy as np
import pytest
from runfiles import FIT

import streamkit as sk
from streamkit.fit import describe_status, read_status

EMULATED = FIT | {"sampler": {"kind": "emulator", "start_particles": 50, "starts": 1, "max_calls": 1200}}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "out"
    return out, sk.run(EMULATED, out=out, progress=False, products=False)


def test_it_is_certified(run):
    assert "emulator has ended by its own rule" in run[1].note()


def test_its_page_says_so(run):
    (verdict,) = run[1].weighted.verdicts
    assert (verdict.subject, verdict.level) == ("fresh calls beside the emulator", "fine")
    subjects = [each.subject for each in run[1].verdicts]
    assert verdict.subject in subjects
    assert "own noise" not in subjects  # that of a single call, which the emulator averages


def test_its_status_counts_samples(run):
    text = describe_status(run[0], read_status(run[0]))
    assert f"samples            {len(run[1].samples)}" in text
    assert "steps" not in text
    assert "acceptance" not in text


def test_a_run_without_a_certificate_is_not_to_be_used():
    few = EMULATED | {"sampler": EMULATED["sampler"] | {"max_calls": 50}}
    results = sk.run(few, progress=False, products=False)
    (verdict,) = results.weighted.verdicts
    assert verdict.level == "do not use"
    assert "Raise sampler.max_calls" in verdict.sentence


def test_a_finished_run_is_resumed_without_a_call(run):
    out, first = run
    again = sk.run(EMULATED, out=out, progress=False, products=False, resume=True)
    assert again.calls == first.calls
    np.testing.assert_array_equal(again.samples, first.samples)


@pytest.mark.slow
def test_two_workers_find_the_same_samples(run, tmp_path):
    other = sk.run(EMULATED, out=tmp_path / "out", progress=False, products=False, workers=2)
    np.testing.assert_array_equal(other.samples, run[1].samples)
