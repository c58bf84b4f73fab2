"""A run of several streams by the emulator: calls of each stream alone, stored for each, and resumed."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from runfiles import several

import streamkit as sk
from streamkit.fit.show.status import read_status
from streamkit.sample import calls_in

CURVE = {"curve": {"kind": "circular_velocity", "radius": 8.0, "v_c": [229, 7]}}


def spec_of(*names: str, max_calls: int = 500):
    document = several(*names, data=CURVE) | {"sampler": {"kind": "emulator", "starts": 1, "max_calls": max_calls}}
    for name in names:
        document["stream"][name]["stripping"]["particles"] = 60
    return sk.load(document)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory):
    out = tmp_path_factory.mktemp("factors") / "run"
    results = sk.run(spec_of("a", "b", max_calls=300), out=out, workers=1, progress=False, products=False)
    return out, results


def test_calls_are_stored_for_each_stream(run) -> None:
    out, results = run
    made = {name: calls_in(out / f"calls.{name}.journal") for name in ("a", "b", "%5Bdata%5D")}
    assert min(made.values()) >= 100
    assert results.calls == sum(made.values()) == read_status(out)["calls"]
    assert calls_in(out / "calls.journal") == 0
    assert set(results.facts) == {"stream a", "stream b", "data of the host"}


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


def test_calls_of_another_stream_in_its_file_are_refused(run, tmp_path: Path) -> None:
    out, results = run
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    shutil.copy(copy / "calls.a.journal", copy / "calls.b.journal")
    with pytest.raises(sk.ChainError, match=r"calls\.b\.journal: holds the calls of another run"):
        sk.run(results.spec, out=copy, workers=1, progress=False, products=False, resume=True)
