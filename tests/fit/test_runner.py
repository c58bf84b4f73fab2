"""Runs: the right answer, resumed as if never stopped, and no finished step lost whatever happens."""

import copy
import json
import os
import shutil
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from forked import forked
from runfiles import FIT

import streamkit as sk
from streamkit.fit.directory.integrity import RUN_FILE
from streamkit.fit.directory.manifest import MANIFEST
from streamkit.fit.options import cheap_spec
from streamkit.fit.runner import Interrupted
from streamkit.fit.samples.results import draws_of
from streamkit.report import locked
from streamkit.sample import CALLS, CHAIN, Chain, ChainFile, read_chain_file


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Return the directory of a finished small run of 4 steps."""
    out = tmp_path_factory.mktemp("runs") / "finished"
    sk.run(sk.load(FIT), out=out, progress=False, products=False)
    return out


def tree(directory):
    return {p.name: p.read_bytes() for p in directory.iterdir() if p.is_file()}


def test_workers_do_not_change_the_samples(finished):
    two = sk.run(sk.load(FIT), workers=2, progress=False, products=False)
    np.testing.assert_array_equal(two.chain, sk.load_results(finished).chain)
    assert two.directory is None


def test_the_manifest_names_versions_and_no_places(finished):
    text = (finished / MANIFEST).read_text()
    manifest = json.loads(text)
    assert manifest["digest"] == sk.load(FIT).digest()
    assert manifest["versions"]["streamkit"] == sk.__version__
    assert manifest["components"]["stripping"].startswith("mlcs from streamkit")
    for place in (str(finished), str(Path.home()), os.uname().nodename):
        assert place not in text + (finished / RUN_FILE).read_text()
    assert sk.load(finished / RUN_FILE).digest() == manifest["digest"]


def test_resume_goes_on_and_force_starts_again(finished, tmp_path):
    out = tmp_path / "run"
    sk.run(sk.load(FIT), out=out, steps=2, progress=False, products=False)
    more = sk.run(sk.load(FIT), out=out, steps=4, resume=True, progress=False, products=False)
    np.testing.assert_array_equal(more.chain, sk.load_results(finished).chain)
    assert more.calls == 4 * 6
    (out / "notes.txt").write_text("mine")
    again = sk.run(sk.load(FIT), out=out, steps=1, force=True, progress=False, products=False)
    assert len(again.chain) == 1
    assert (out / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("name", [CHAIN, CALLS])
def test_samples_of_another_posterior_are_not_continued(finished, tmp_path, monkeypatch, name):
    """The run file is the same, and a new version of the code has another likelihood."""
    spec, out = sk.load(FIT), tmp_path / "run"
    if name == CHAIN:
        shutil.copytree(finished, out)
    else:  # a sampler without a chain
        plugin = Path(__file__).parents[1] / "support" / "importance.py"
        spec = sk.load(FIT | {"plugins": [str(plugin)], "sampler": {"kind": "importance", "draws": 10}})
        sk.run(spec, out=out, progress=False, products=False)
    samples, before = (out / name).read_bytes(), sk.Model.ln_likelihood
    monkeypatch.setattr(sk.Model, "ln_likelihood", lambda *given: before(*given) - 2.0)
    with pytest.raises(sk.ChainError, match=r"of another posterior: ln p of one of them was .* or --force"):
        sk.run(spec, out=out, resume=True, progress=False, products=False)
    assert (out / name).read_bytes() == samples


@pytest.mark.parametrize("resume", [False, True])
def test_another_run_is_refused_and_untouched(finished, resume):
    before = tree(finished)
    other = copy.deepcopy(FIT)
    other["progenitor"]["mass"] = 5e8
    with pytest.raises(sk.ChainError) as caught:
        sk.run(sk.load(other), out=finished, resume=resume, progress=False)
    words = "progenitor.mass" if resume else "--resume"
    assert words in str(caught.value)
    assert ("640000000.0 Msun" in str(caught.value)) == resume
    assert tree(finished) == before


@pytest.mark.parametrize(("resume", "force"), [(False, False), (True, False), (False, True)])
def test_foreign_files_are_refused_and_untouched(tmp_path, resume, force):
    (tmp_path / "corner.png").write_text("not ours")
    with pytest.raises(sk.ChainError, match=r"corner\.png"):
        sk.run(sk.load(FIT), out=tmp_path, resume=resume, force=force, progress=False)
    assert tree(tmp_path) == {"corner.png": b"not ours"}


def test_a_truncated_chain_is_refused_and_untouched(finished, tmp_path):
    out = tmp_path / "run"
    out.mkdir()
    for name, content in tree(finished).items():
        (out / name).write_bytes(content)
    whole = (out / CHAIN).read_bytes()
    (out / CHAIN).write_bytes(whole[: len(whole) // 2])
    before = tree(out)
    with pytest.raises(sk.ChainError, match="truncated"):
        sk.run(sk.load(FIT), out=out, resume=True, progress=False)
    with pytest.raises(sk.ChainError, match="truncated"):
        sk.load_results(out)
    (out / CHAIN).write_text("no chain at all")
    with pytest.raises(sk.ChainError, match="damaged or changed after it was written"):
        sk.load_results(out)
    (out / CHAIN).write_bytes(before[CHAIN])
    assert tree(out) == before


@pytest.mark.slow
def test_a_run_stopped_before_its_first_step_begins_again(finished, tmp_path):
    out = tmp_path / "run"
    shutil.copytree(finished, out)
    ChainFile(out / CHAIN).reset(6, 2)
    with pytest.raises(sk.ChainError, match="before its first step"):
        sk.load_results(out)
    again = sk.run(sk.load(FIT), out=out, resume=True, progress=False, products=False)
    np.testing.assert_array_equal(again.chain, sk.load_results(finished).chain)


def test_a_run_killed_between_its_first_files_is_resumed(finished, tmp_path):
    (tmp_path / MANIFEST).write_bytes((finished / MANIFEST).read_bytes())
    again = sk.run(sk.load(FIT), out=tmp_path, steps=1, resume=True, progress=False, products=False)
    np.testing.assert_array_equal(again.chain, sk.load_results(finished).chain[:1])


def test_a_file_is_no_output_directory(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(sk.ChainError, match="is a file"):
        sk.run(sk.load(FIT), out=tmp_path / "file", force=True, progress=False)
    assert (tmp_path / "file").read_text() == "mine"


def test_two_runs_in_one_directory_are_refused(finished):
    before = tree(finished)
    with locked(finished), pytest.raises(sk.ChainError, match="another run is writing"):
        sk.run(sk.load(FIT), out=finished, force=True, progress=False)
    assert tree(finished) == before


def long_run(out):
    """Run in a session of its own; what an interruption says goes to a file beside the directory."""
    os.setsid()
    try:
        sk.run(sk.load(FIT), out=out, workers=2, steps=100000, progress=False)
    except Interrupted as stop:
        out.with_suffix(".txt").write_text(str(stop))
        sys.exit(stop.exit_status)


def start(out):
    """Start a long run in a process of its own and wait for its third step."""
    process = forked(long_run, out)
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and process.is_alive():
        with suppress(sk.ChainError):  # nothing there yet
            if len(read_chain_file(out / CHAIN).chain) >= 3:
                return process
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    raise AssertionError("no third step")


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize(
    ("signum", "status"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)]
)
def test_a_stopped_run_keeps_its_samples_and_can_be_resumed(tmp_path, signum, status):
    out = tmp_path / "run"
    process = start(out)
    os.killpg(process.pid, signum)  # as a terminal does: to the workers too
    process.join(60)
    assert process.exitcode == status
    text = out.with_suffix(".txt").read_text()
    steps = len(read_chain_file(out / CHAIN).chain)
    assert f"{steps} finished steps" in text
    assert "--resume" in text
    results = sk.run(sk.load(FIT), out=out, steps=steps + 1, resume=True, progress=False, products=False)
    assert len(results.chain) == steps + 1
    assert results.calls >= 6 * (steps + 1)


def test_a_killed_run_leaves_a_readable_chain_and_no_workers(tmp_path):
    out = tmp_path / "run"
    process = start(out)
    process.kill()
    process.join(30)
    assert len(sk.load_results(out).chain) >= 3
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    raise AssertionError("its workers outlived it")


FRAGILE = '''
import os
import shutil
from typing import Any
import numpy as np
from streamkit import Component, Observable, Prediction, hookimpl

class Fragile(Observable):
    """The progenitor's distance from the centre; fails when told to."""

    kind = "fragile"

    def data(self) -> Any:
        return np.array([20.0]), np.array([2.0])

    def predict(self, stream: Any) -> Prediction:
        if os.environ.get("FRAGILE") == "broken":
            raise ZeroDivisionError("it broke")
        return Prediction(("distance",), stream.orbit.r[-1:], np.zeros(1))

@hookimpl
def streamkit_components() -> list[type[Component]]:
    return [Fragile]
'''


@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_a_component_that_raises_is_named_and_finished_steps_stay(tmp_path, monkeypatch, workers):
    (tmp_path / "fragile.py").write_text(FRAGILE)
    document = copy.deepcopy(FIT)
    document["plugins"] = [str(tmp_path / "fragile.py")]
    document["stripping"]["particles"] = 50
    document["progenitor"]["lookback"] = 1
    document["observable"] = {"kind": "fragile"}
    spec, out = sk.load(document), tmp_path / "run"
    sk.run(spec, out=out, steps=2, progress=False, products=False)
    monkeypatch.setenv("FRAGILE", "broken")
    with pytest.raises(sk.ComponentError) as caught:
        sk.run(spec, out=out, steps=4, resume=True, workers=workers, progress=False, products=False)
    for word in ("Fragile.predict", "ZeroDivisionError", "it broke", "potential.v0 = "):
        assert word in str(caught.value)
    assert len(sk.load_results(out).chain) == 2
    assert (out / "plugins" / "fragile.py").exists()
    assert str(tmp_path) not in (out / RUN_FILE).read_text()


@pytest.mark.parametrize("asked", [50, 10_000])
def test_the_search_for_a_start_tries_streams_of_the_size_asked_for(asked):
    document = copy.deepcopy(FIT)
    document["sampler"]["start_particles"] = asked
    full = sk.load(document).bind().stripping.particles

    search = cheap_spec(sk.load(document))

    assert 50 < full < 10_000
    assert search.bind().stripping.particles == min(asked, full)
    assert search.likelihood.noise == "add"


@pytest.mark.parametrize(("steps", "expected"), [(8, 1 / 6), (1, 0.5)])
def test_the_acceptance_is_that_of_the_samples_and_not_of_the_learning(steps, expected):
    """Both walkers move at every step of the first half, one of them at one step of three in the second.

    A single step has only the sampler's own count.
    """
    spec = sk.load(FIT)
    trace = np.zeros((steps, 2, len(spec.names)))
    trace[: steps // 2] = np.arange(steps // 2)[:, None, None] + 1.0
    trace[-1, 0] = 7.0
    stored = Chain(trace, np.zeros((steps, 2)), None, np.full(2, 0.5 * steps), {})

    assert draws_of(stored, spec, quick=False).acceptance == pytest.approx(expected)


def test_too_few_walkers_are_refused(tmp_path):
    document = copy.deepcopy(FIT)
    document["sampler"]["walkers"] = 3
    with pytest.raises(sk.SpecError, match=r"sampler\.walkers: found 3"):
        sk.run(sk.load(document), out=tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()
