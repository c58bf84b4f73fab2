"""A run of several streams by the emulator: calls of each stream alone, stored for each, and resumed."""

import multiprocessing
import shutil
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest
from runfiles import several
from shortened import take_few_steps

import streamkit as sk
from streamkit.fit.show.status import describe_status, read_status
from streamkit.sample import EvaluationCache, Storage, calls_in, factor_posteriors, part_of_joint, take_earlier

CURVE = {"curve": {"kind": "circular_velocity", "radius": 8.0, "v_c": [229, 7]}}


def spec_of(*names: str, max_calls: int = 500):
    document = several(*names, data=CURVE) | {"sampler": {"kind": "emulator", "starts": 1, "max_calls": max_calls}}
    for name in names:
        document["stream"][name]["stripping"]["particles"] = 60
    return sk.load(document)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory):
    """Its directory and its results; all walks of this file are short."""
    out = tmp_path_factory.mktemp("factors") / "run"
    with pytest.MonkeyPatch.context() as patch:
        take_few_steps(patch)
        yield out, sk.run(spec_of("a", "b", max_calls=170), out=out, workers=1, progress=False, products=False)


def test_calls_are_stored_for_each_stream(run) -> None:
    out, results = run
    made = {name: calls_in(out / f"calls.{name}.journal") for name in ("a", "b", "%5Bdata%5D")}
    assert min(made.values()) >= 100
    assert results.calls == sum(made.values()) == read_status(out)["calls"]
    assert calls_in(out / "calls.journal") == 0
    assert set(results.facts) == {"stream a", "stream b", "data of the host"}


def test_the_status_has_a_row_for_each_stream_before_and_after_the_first_samples(run, tmp_path: Path) -> None:
    out, results = run
    streams = read_status(out)["streams"]
    assert {name: row["calls"] for name, row in streams.items()} == {
        name: calls_in(out / f"calls.{quoted}.journal")
        for name, quoted in (("a", "a"), ("b", "b"), ("[data]", "%5Bdata%5D"))
    }
    assert streams["b"]["said"] == results.facts["stream b"]
    assert streams["[data]"]["said"] == results.facts["data of the host"]
    copy = tmp_path / "running"
    shutil.copytree(out, copy)
    (copy / "samples.h5").unlink()
    status = read_status(copy)
    assert {name: row | {"said": ""} for name, row in streams.items()} == status["streams"]
    text = " ".join(describe_status(copy, status).split())
    assert f"a {streams['a']['calls']} calls" in text
    assert text.count("no samples yet") == 3


def test_the_samples_have_the_predictions_of_all_data_in_their_order(run) -> None:
    _, results = run
    posterior, blobs = sk.Posterior(results.spec), results.draws.blobs.reshape(-1)
    for i in range(0, len(results.samples), 400):
        found = posterior.evaluate(results.samples[i])
        away = np.abs(blobs["mean"][i] - found.mean) / np.sqrt(found.variance + (0.1 * posterior.data.errors) ** 2)
        assert np.nanmedian(away) < 2


def test_a_resumed_run_makes_no_call_again_and_gives_the_same_samples(run, tmp_path: Path) -> None:
    out, results = run
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    (copy / "samples.h5").unlink()
    before = {path.name: path.read_bytes() for path in copy.glob("*.journal")}
    again = sk.run(results.spec, out=copy, workers=1, progress=False, products=False, resume=True)
    assert {path.name: path.read_bytes() for path in copy.glob("*.journal")} == before
    np.testing.assert_array_equal(again.samples, results.samples)


def test_a_run_of_two_workers_that_is_killed_is_the_run_of_one_that_was_not(run, tmp_path: Path) -> None:
    """SIGKILL at its start and while the journals of three factors grow, one of them cut within a record after it.

    The workers make the streams from one queue, and walk: each evaluates some of the emulators.
    """
    out, results = run
    copy, rng = tmp_path / "killed", np.random.default_rng(1)
    options = {"out": copy, "workers": 2, "progress": False, "products": False}

    def stored() -> int:
        return sum(calls_in(path) for path in copy.glob("*calls.*.journal"))

    for wanted in (0, 1, 60, 150, 300):
        process = multiprocessing.get_context("fork").Process(
            target=sk.run, args=(results.spec,), kwargs=options | {"resume": copy.exists()}
        )
        process.start()
        end = monotonic() + 120
        while stored() < wanted and process.is_alive() and monotonic() < end:
            sleep(0.05)
        sleep(rng.uniform(0, 0.5))
        process.kill()
        process.join()
        assert stored() >= wanted
    whole = (copy / "calls.a.journal").read_bytes()
    (copy / "calls.a.journal").write_bytes(whole[:-7])
    again = sk.run(results.spec, **options, resume=True)
    np.testing.assert_array_equal(again.samples, results.samples)
    for path in out.glob("calls.*.journal"):
        assert calls_in(copy / path.name) == calls_in(path)


def test_calls_of_another_stream_in_its_file_are_refused(run, tmp_path: Path) -> None:
    out, results = run
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    shutil.copy(copy / "calls.a.journal", copy / "calls.b.journal")
    with pytest.raises(sk.ChainError, match=r"calls\.b\.journal: holds the calls of another run"):
        sk.run(results.spec, out=copy, workers=1, progress=False, products=False, resume=True)


@pytest.fixture(scope="module")
def added(run, tmp_path_factory: pytest.TempPathFactory):
    """A run of a third stream beside those two, with their calls; its directory and its results."""
    out = tmp_path_factory.mktemp("factors") / "more"
    more = spec_of("a", "b", "c", max_calls=170)
    return out, sk.run(more, out=out, workers=1, progress=False, products=False, reuse=run[0])


def test_a_stream_is_added_without_a_call_of_the_others(run, added) -> None:
    (out, before), (more, results) = run, added
    made = {path.name: calls_in(path) for path in more.glob("*.journal")}
    status = read_status(more)
    assert status["streams"]["a"]["earlier_calls"] == made["earlier_calls.a.journal"]
    assert status["calls"] == results.calls  # without those of the earlier run
    assert made["earlier_calls.a.journal"] == calls_in(out / "calls.a.journal")
    assert made["calls.c.journal"] >= 100
    assert made.get("calls.a.journal", 0) + made.get("calls.b.journal", 0) <= 2 * 128 * 3  # fresh ones that test them
    moved = (results["potential.v0"].mean() - before["potential.v0"].mean()) / before["potential.v0"].std()
    assert abs(moved) < 1  # the third stream has the same data again


@pytest.mark.slow
def test_a_run_with_earlier_calls_is_resumed(added, tmp_path: Path) -> None:
    again = tmp_path / "again"
    shutil.copytree(added[0], again)
    (again / "samples.h5").unlink()
    resumed = sk.run(added[1].spec, out=again, workers=1, progress=False, products=False, resume=True)
    np.testing.assert_array_equal(resumed.samples, added[1].samples)


def test_calls_are_compared_with_changed_data_anew(run, tmp_path: Path) -> None:
    out, before = run
    changed = before.spec.with_values({"data.curve.v_c": ["232 km/s", "7 km/s"]})
    factors = factor_posteriors(changed, changed)
    storages = {each.name: Storage() for each in factors}
    taken = take_earlier(factors, storages, out, before.spec)
    assert taken == {name: calls_in(out / f"calls.{quoted}.journal")
                     for name, quoted in (("a", "a"), ("b", "b"), ("[data]", "%5Bdata%5D"))}  # fmt: skip
    host = factors[-1]
    for key, each in list(storages["[data]"].earlier.all().items())[:5]:
        assert each.ln_likelihood == pytest.approx(host.full.evaluate(np.frombuffer(key)).ln_likelihood, rel=1e-9)


def test_calls_serve_where_data_are_left_out_and_not_where_others_are_added(run) -> None:
    out, before = run

    def spec_with(distance):
        document = several("a", "b", data=CURVE) | {"sampler": {"kind": "emulator"}}
        for name in ("a", "b"):
            document["stream"][name]["stripping"]["particles"] = 60
        document["stream"]["b"]["observable"]["distance"] = distance
        return sk.load(document)

    left = spec_with({"phi1": [5], "distance": [24.5], "error": [1]})
    factors = factor_posteriors(left, left)
    storages = {each.name: Storage() for each in factors}
    assert take_earlier(factors, storages, out, before.spec)["b"] == calls_in(out / "calls.b.journal")
    stream = factors[1]
    calls = storages["b"].earlier.all().items()
    for key, each in list(calls)[::20]:
        again = stream.full.evaluate(np.frombuffer(key))
        np.testing.assert_allclose(each.mean, again.mean, rtol=1e-9)
        assert len(each.mean) == len(each.variance) == 3  # a distance and two velocities
        assert each.reason == again.reason
        if not each.reason:
            assert each.details.shape == again.details.shape
            assert each.ln_likelihood == pytest.approx(again.ln_likelihood, abs=0.05)  # the pooled scatter differs

    moved = spec_with({"phi1": [4], "distance": [24.5], "error": [1]})
    factors = factor_posteriors(moved, moved)
    assert take_earlier(factors, {each.name: Storage() for each in factors}, out, before.spec)["b"] == 0


def test_calls_of_another_model_do_not_serve(run, caplog: pytest.LogCaptureFixture) -> None:
    out, before = run
    changed = before.spec.with_values({"stream.b.stripping.sigma": 3.0})
    factors = factor_posteriors(changed, changed)
    storages = {each.name: Storage() for each in factors}
    taken = take_earlier(factors, storages, out, before.spec)
    assert taken["b"] == 0 < taken["a"]
    assert "the calls of b are of another model" in caplog.text


def test_calls_of_all_streams_together_serve_each(tmp_path: Path) -> None:
    spec = spec_of("a", "b")
    posterior, joint = sk.Posterior(spec, emulated=True), EvaluationCache()
    rng = np.random.default_rng(1)
    for u in rng.random((6, len(spec.names))):
        theta = np.array([prior.ppf(x) for prior, x in zip(spec.priors, u, strict=True)])
        joint.add(theta, posterior.evaluate(theta))
    factors = factor_posteriors(spec, spec)
    parts = [part_of_joint(joint, factors, each) for each in factors]
    good = {key: each for key, each in joint.all().items() if not each.reason}
    assert len(good) >= 3
    for key, whole in good.items():
        theta = np.frombuffer(key)
        mine = [part[np.ascontiguousarray(theta[each.parameters.parameters]).tobytes()]
                for part, each in zip(parts, factors, strict=True)]  # fmt: skip
        np.testing.assert_array_equal(np.concatenate([each.mean for each in mine]), whole.mean)
        assert sum(each.ln_likelihood for each in mine) == pytest.approx(whole.ln_likelihood, rel=1e-9)
