"""The sampler `emulator` in a run: certified, resumed without a call, with any number of workers; its history."""

import shutil
from unittest.mock import Mock

import numpy as np
import pytest
from runfiles import FIT
from shortened import take_few_steps

import streamkit as sk
from streamkit.fit import describe_status, read_status
from streamkit.fit.show.figures import traces
from streamkit.sample import calls_in

EMULATED = FIT | {"sampler": {"kind": "emulator", "start_particles": 50, "starts": 1, "max_calls": 1200}}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Its directory and its results; all walks of this file are short."""
    out = tmp_path_factory.mktemp("run") / "out"
    with pytest.MonkeyPatch.context() as patch:
        take_few_steps(patch)
        yield out, sk.run(EMULATED, out=out, progress=False, products=False)


def stages(results):
    """How the answer moved with the calls."""
    return results.weighted.attributes["history"]["stages"]


def test_it_is_certified(run):
    assert "emulator has ended by its own rule" in run[1].note()


def test_its_page_says_so(run):
    (verdict,) = run[1].weighted.verdicts
    assert (verdict.subject, verdict.level) == ("fresh calls beside the emulator", "fine")
    assert "1 of 1 start leads to all of the posterior." in verdict.sentence
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


def test_a_run_without_its_samples_is_resumed_without_a_call(run, tmp_path):
    out, first = run
    copy = shutil.copytree(out, tmp_path / "copy")
    (copy / "samples.h5").unlink()
    again = sk.run(EMULATED, out=copy, progress=False, products=False, resume=True)
    assert again.calls == first.calls
    np.testing.assert_array_equal(again.samples, first.samples)
    assert stages(again) == stages(first)


def test_a_run_that_has_ended_by_its_rule_is_not_sampled_again_with_the_same_settings(run, monkeypatch):
    out, first = run
    monkeypatch.setattr("streamkit.fit.runner.sample.run_sampler", Mock(side_effect=RuntimeError("sampled")))
    again = sk.run(EMULATED, out=out, progress=False, products=False, resume=True)
    np.testing.assert_array_equal(again.samples, first.samples)
    other = EMULATED | {"sampler": EMULATED["sampler"] | {"max_calls": 1300}}
    with pytest.raises(RuntimeError, match="sampled"):
        sk.run(other, out=out, progress=False, products=False, resume=True)


@pytest.mark.slow
def test_two_workers_find_the_same_samples(run, tmp_path):
    other = sk.run(EMULATED, out=tmp_path / "out", progress=False, products=False, workers=2)
    np.testing.assert_array_equal(other.samples, run[1].samples)


def test_calls_grow_from_stage_to_stage_and_the_last_stage_is_the_answer(run):
    run = run[1]
    history = run.weighted.attributes["history"]
    assert history["names"][:2] == list(run.names)
    assert (np.diff([stage["calls"] for stage in history["stages"]]) >= 0).all()
    last = history["stages"][-1]
    assert (last["calls"], last["small_calls"]) == (run.calls, run.search_calls)
    for name, interval in zip(run.names, last["intervals"], strict=False):
        np.testing.assert_allclose(interval, np.percentile(run[name], [16, 50, 84]))
    radius = float(history["names"][-1].removeprefix("M(<").split()[0])
    middle = run.mass_profile([radius])["M"][0].to_value("1e11 Msun")
    assert last["intervals"][-1][1] == pytest.approx(middle, rel=0.05)  # of 200 samples


def test_the_traces_of_an_emulated_run_are_its_history(run):
    figure = traces(run[1])
    assert figure._supxlabel.get_text() == "calls with all particles"
    assert figure.axes[2].get_ylabel().startswith("M(<")
    (line,) = {tuple(axes.lines[-1].get_xdata()) for axes in figure.axes[:1]}
    passed = [each["calls"] for each in stages(run[1]) if each["level"] == "fine"]
    assert list(line) == passed


def changed(run, value, tmp_path):
    """The run with another distance, or another model, after its calls."""
    spec = run[1].spec.with_values(value)
    return sk.run(spec, out=tmp_path / "new", progress=False, products=False, reuse=run[0])


def test_calls_are_compared_with_changed_data(run, tmp_path):
    """Only fresh calls are new. A distance larger by an error moves the apocentre, and so what is fitted."""
    results = changed(
        run, {"observable.distance": FIT["observable"]["distance"] | {"distance": [25.6, 25.5]}}, tmp_path
    )
    assert "ended by its own rule" in results.note()
    assert calls_in(tmp_path / "new" / "earlier_calls.journal") == run[1].calls
    assert results.calls < run[1].calls
    some = range(0, len(results.samples), 20)
    given = results.draws.blobs.reshape(-1)["ln_likelihood"][some]
    true, old = (
        np.array([posterior.evaluate(results.samples[i]).ln_likelihood for i in some])
        for posterior in (sk.Posterior(each.spec, emulated=True) for each in (results, run[1]))
    )
    off = np.abs(given - true)
    assert np.median(off) < 0.7  # the noise of one call
    assert np.quantile(off, 0.9) < 2
    change = true - old - np.mean(true - old)  # by the data
    assert 0.5 < np.dot(given - old, change) / np.dot(change, change) < 1.5
    again = sk.run(results.spec, out=tmp_path / "new", progress=False, products=False, resume=True)
    np.testing.assert_array_equal(again.samples, results.samples)


def test_calls_of_another_model_or_for_another_sampler_do_not_serve(run, tmp_path, caplog):
    results = changed(run, {"stripping.sigma": 12.0, "sampler.max_calls": 60}, tmp_path)
    assert results.calls >= 50
    assert "are of another model" in caplog.text
    with pytest.raises(sk.SpecError, match="reuse: serves the sampler emulator only"):
        sk.run(FIT, progress=False, products=False, reuse=run[0])
