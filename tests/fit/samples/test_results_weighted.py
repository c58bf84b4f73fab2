"""Runs of samplers that give weighted samples: products, resuming, errors. The sampler is a plugin file of the run."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from commands import call, refused
from forging import forging
from runfiles import FIT

import streamkit as sk
from streamkit.components import LOOK
from streamkit.fit import describe_results, write_samples
from streamkit.fit.judge.verdicts import overall
from streamkit.fit.samples.results import Results, load_results
from streamkit.fit.show.status import describe_status, read_status
from streamkit.sample import CALLS, CHAIN, SAMPLES, EvaluationCache, Posterior, Workers, read_weighted
from streamkit.sample.store.journal import MAGIC

FILE = Path(__file__).parents[2] / "support" / "importance.py"
PLUGIN = {"plugins": [str(FILE)]}
# Few draws have most of the weight.
PRECISE = {"distance": {"phi1": [-5, 5], "distance": [24.6, 24.5], "error": [0.2, 0.2]}}
RUN = FIT | PLUGIN | {
    "observable": FIT["observable"] | PRECISE,
    "sampler": {"kind": "importance", "draws": 160, "each": 40},
}


def fit(out=None, resume=False, **sampler):
    document = RUN | {"sampler": RUN["sampler"] | sampler}
    return sk.run(document, out=out, progress=False, products=False, resume=resume)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("weighted") / "run"
    return sk.run(RUN, out=out, progress=False)


def same(one, other):
    for name in ("points", "ln_weights", "log_prob"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.ln_evidence == other.ln_evidence


def test_its_samples_are_those_of_their_weights(done):
    found = done.weighted
    assert done.calls == 160
    assert sum(done.reasons.values()) + len(found.points) == 160
    assert done.converged is False
    assert "effective samples, and 400 are wanted" in done.note()
    weights = np.exp(found.ln_weights - found.ln_weights.max())
    assert found.ess == pytest.approx(weights.sum() ** 2 / (weights**2).sum())
    assert done.chain.shape == (round(found.ess), 1, 2)
    drawn = {point.tobytes() for point in done.samples}
    assert drawn <= {point.tobytes() for point in found.points}
    assert np.isnan(done.r_hat).all()
    mean, sd = np.average(found.points, axis=0, weights=weights), found.points.std(axis=0)
    np.testing.assert_allclose(done.samples.mean(axis=0), mean, atol=3 * sd.max() / np.sqrt(found.ess), rtol=0.02)
    assert done.best() == dict(zip(done.names, found.points[np.argmax(found.log_prob)].tolist(), strict=True))


def test_ln_p_and_predictions_are_those_of_the_posterior(done):
    posterior, k = sk.Posterior(done.spec), 3
    wanted = posterior.evaluate(done.weighted.points[k])
    assert wanted.lnp == done.weighted.log_prob[k]
    np.testing.assert_array_equal(wanted.mean, done.weighted.blobs["mean"][k])


def test_every_product_is_written_and_says_what_it_is(done, tmp_path):
    files = {path.name for path in done.directory.iterdir()}
    assert {SAMPLES, CALLS, "corner.png", "traces.png", "best_stream.png", "report.html", "summary.ecsv"} <= files
    assert CHAIN not in files
    assert not done.failed
    page = (done.directory / "report.html").read_text()
    assert "rule of the sampler" in page
    assert "importance" in page
    assert "ln evidence" in describe_results(done)
    level, _ = overall(done.verdicts)
    subjects = {verdict.subject for verdict in done.verdicts}
    assert level == "do not use"
    assert "R-hat" not in subjects
    assert {"rule of the sampler", "effective samples", "largest weight", "own noise"} <= subjects
    for name in ("samples.csv", "samples.ecsv", "samples.txt"):
        for path in write_samples(done, tmp_path / name):
            assert path.stat().st_size
    assert len(done.to_pandas()) == len(done.samples)
    status = describe_status(done.directory, read_status(done.directory))
    assert "effective samples" in status


def test_a_best_sample_whose_stream_cannot_be_measured_is_said(done):
    """Emulated samples may lie where no stream can be measured: here nothing has left the progenitor yet."""
    lost = Results(done.spec.with_values({"progenitor.lookback": 0.001}), done.draws)
    assert lost.fit is None
    assert len(lost.goodness()) == 0
    judged = next(each for each in lost.verdicts if each.subject == "goodness of fit")
    assert judged.level == LOOK
    assert "too few particles" in judged.value
    assert "fit to the data" not in describe_results(lost)


@pytest.mark.slow
def test_a_run_in_memory_has_the_same_samples(done):
    same(fit().weighted, done.weighted)


def test_samples_that_a_resumed_run_does_not_reach_again_are_kept(done, tmp_path, caplog):
    """Fewer draws than before are fewer effective samples."""
    shutil.copytree(done.directory, tmp_path / "run")
    less = fit(tmp_path / "run", resume=True, draws=80)
    same(less.weighted, done.weighted)
    before, after = done.weighted.ess, fit(draws=80).weighted.ess
    assert after < before
    assert f"the previous samples are kept: {before:.0f} effective samples, and 400 are wanted" in caplog.text
    assert f"The samples of the resumed run: {after:.0f} effective samples" in caplog.text


def test_lost_calls_are_mentioned(done, tmp_path, caplog):
    shutil.copytree(done.directory, tmp_path / "run")
    load_results(tmp_path / "run")
    read_status(tmp_path / "run")
    assert not caplog.text
    (tmp_path / "run" / CALLS).unlink()
    load_results(tmp_path / "run")
    assert "calls.journal, hold 0 of the 160 calls" in caplog.text
    cut = EvaluationCache(tmp_path / "run" / CALLS, done.spec.digest(), 2, np.zeros(4))
    whole = EvaluationCache(done.directory / CALLS, done.spec.digest(), 2, Posterior(done.spec).data.values)
    points = done.weighted.points[:30]
    for point, evaluation in zip(points, whole.get(points), strict=True):
        cut.add(point, evaluation)
    cut.write()
    for reader in (read_status, lambda directory: fit(directory, resume=True)):
        caplog.clear()
        reader(tmp_path / "run")
        assert "calls.journal, hold 30 of the 160 calls" in caplog.text


@pytest.mark.parametrize("name", [SAMPLES, CALLS])
def test_status_tells_of_a_damaged_file(done, tmp_path, name):
    shutil.copytree(done.directory, tmp_path / "run")
    content = (tmp_path / "run" / name).read_bytes()
    content += content[len(MAGIC) :] if name == CALLS else b""  # two records: the last one may be incomplete
    at = 1000
    (tmp_path / "run" / name).write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
    for args in ([], ["--json"]):
        assert name in refused("status", tmp_path / "run", "--trust", *args)


def test_a_text_in_a_file_of_samples_is_no_command(done, tmp_path):
    """Neither for a terminal nor for LaTeX."""
    shutil.copytree(done.directory, tmp_path / "run")
    with forging(tmp_path / "run" / SAMPLES) as file:
        file.attrs["missing"] = "one\n\\input{mine}\x1b]0;mine\x07"
        file.attrs["counts"] = json.dumps({"calls": 160, "reasons": {"\x1b[2J": 99}, "facts": {"\x1b[2J": "\x1b[2J"}})
    write_samples(load_results(tmp_path / "run"), tmp_path / "x.tex")
    lines = (tmp_path / "x.tex").read_text(encoding="utf-8").splitlines()
    assert all(line.startswith("%") for line in lines if "mine" in line)
    for args in (["status"], ["export", "--force", "-o", tmp_path / "x.tex"], ["report"]):
        output = call(args[0], tmp_path / "run", "--trust", *args[1:]).output
        assert not any(ord(letter) < 32 and letter != "\n" for letter in output)
        assert "mine" in output


def test_damaged_samples_are_made_again_from_the_calls(done, tmp_path, monkeypatch, caplog):
    shutil.copytree(done.directory, tmp_path / "run")
    (tmp_path / "run" / SAMPLES).write_bytes(b"")
    counted = count_calls(monkeypatch)
    same(fit(tmp_path / "run", resume=True).weighted, done.weighted)
    assert sum(counted) == 0
    assert "samples.h5: was damaged or changed after it was written" in caplog.text


def count_calls(monkeypatch):
    counted, own = [], Workers.each

    def each(self, points, which="full"):
        counted.append(len(points))
        return own(self, points, which)

    monkeypatch.setattr(Workers, "each", each)
    return counted


def test_a_stopped_run_keeps_its_calls_and_resumes(done, tmp_path, monkeypatch):
    own, out = sk.Posterior.evaluate, tmp_path / "run"
    left = iter(range(100))

    def evaluate(self, theta):
        if next(left, None) is None:
            raise sk.ComponentError("the toy fails")
        return own(self, theta)

    with monkeypatch.context() as patch:
        patch.setattr(sk.Posterior, "evaluate", evaluate)
        with pytest.raises(sk.ComponentError, match=r"the toy fails\. The run stopped after 99 calls, all of them in"):
            fit(out)
    assert read_weighted(out / SAMPLES).missing == "80 draws, and 160 are wanted"
    assert read_status(out)["state"] == "unfinished"
    counted = count_calls(monkeypatch)
    again = fit(out, resume=True)
    assert sum(counted) == 61
    same(again.weighted, done.weighted)


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ("shape", r"points of shape \(40, 1\) and weights of shape \(40,\), expected \(n, 2\)"),
        ("weights", "weights that are no numbers"),
        ("unknown", "samples that it never evaluated"),
        ("nothing", "gave no samples"),
    ],
)
def test_a_sampler_that_breaks_the_contract_is_told(fault, told):
    with pytest.raises(sk.ComponentError, match=told):
        fit(fault=fault)


def test_another_sampler_cannot_go_on(done, tmp_path):
    shutil.copytree(done.directory, tmp_path / "run")
    wanted = r"What differs \(there -> here\): the sampler: importance there, emcee here"
    with pytest.raises(sk.ChainError, match=wanted):
        sk.run(FIT, out=tmp_path / "run", resume=True, progress=False)
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    (tmp_path / "run" / "manifest.json").write_text(json.dumps(manifest | {"digest": "0" * 64}))
    with pytest.raises(sk.ChainError, match="of another run"):
        load_results(tmp_path / "run")


def test_a_damaged_file_is_told(done, tmp_path):
    shutil.copytree(done.directory, tmp_path / "run")
    file = tmp_path / "run" / SAMPLES
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(sk.ChainError, match="was damaged or changed after it was written"):
        load_results(tmp_path / "run")
    found = read_weighted(done.directory / SAMPLES)
    found.points[0, 0] += 1
    found.write(file)
    file.unlink()
    with pytest.raises(sk.ChainError, match="there is no file of samples"):
        load_results(tmp_path / "run")


@pytest.mark.parametrize(
    ("sampler", "parts"),
    [
        ({"kind": "nautilsu"}, ["sampler.kind: no sampler is called 'nautilsu'", "Installed: "]),
        ({"kind": "emce"}, ["Did you mean 'emcee'?"]),
        ({"draws": 3}, ["sampler.draws", "has no field 'draws'"]),
        (
            {"kind": "importance", "walkers": 3},
            ["has no field 'walkers'", "'walkers' is a field of the sampler 'emcee'"],
        ),
        ({"kind": "importance", "draws": {"uniform": [1, 2]}}, ["sampler.draws: takes no prior"]),
    ],
)
def test_errors_in_the_section(sampler, parts):
    with pytest.raises(sk.SpecError) as caught:
        sk.load(FIT | PLUGIN | {"sampler": sampler})
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.parametrize("steps", [0, 2.5, "10", True])
def test_steps_are_whole_numbers(steps):
    """With 2.5 a chain had no end."""
    with pytest.raises(sk.SpecError, match=r"steps: found .*, expected a whole number, 1 or more"):
        sk.run(FIT, steps=steps, progress=False)


def test_steps_belong_to_the_sampler_that_has_them():
    with pytest.raises(sk.SpecError, match="steps: the sampler 'importance' has no steps"):
        sk.run(RUN, steps=3, progress=False)


def test_the_default_is_emcee_and_no_part_of_the_digest(tmp_path):
    plain, named = sk.load(FIT), sk.load(FIT | {"sampler": {"kind": "emcee", **FIT["sampler"]}})
    assert plain.document == named.document
    assert plain.document["sampler"]["kind"] == "emcee"
    assert plain.digest() == named.digest()
    other = sk.load(RUN)
    assert other.document["sampler"]["kind"] == "importance"
    assert other.digest() != plain.digest()
    assert other.with_values({"sampler.draws": 9}).digest() == other.digest()
    assert other.with_values({"sampler.each": 9}).digest() != other.digest()
    assert ("sampler", "importance") in [(path, cls.kind) for path, cls, _ in other.components()]


def test_the_check_and_the_listing_know_of_samplers():
    assert "emcee" in call("plugins", "sampler").stdout
    assert "walkers" in call("reference", "sampler", "emcee").stdout
    spec = sk.load(RUN)
    assert spec.sampler.calls(2) == (0, "unknown")
