"""How far a run has come, how to go on with it, and a run file to begin with."""

import json
import re
import shlex
import shutil
import tomllib

import numpy as np
import pytest
from commands import call, refused
from documents import ROOT
from runfiles import FIT

import streamkit as sk
from streamkit.builtin.samplers.ensemble.sampler import Emcee
from streamkit.cli.init import examples, tables_of
from streamkit.fit import describe_status, read_status
from streamkit.fit.show.status import _expected_end
from streamkit.report import locked
from streamkit.runfile import to_toml
from streamkit.sample import CALLS, SMALL_CALLS, Evaluation, EvaluationCache, read_chain_file


@pytest.fixture(scope="module")
def run(finished_run, tmp_path_factory):
    """Return a run of one's own: it is locked here."""
    return sk.load_results(shutil.copytree(finished_run, tmp_path_factory.mktemp("runs") / "run"))


def test_the_status_of_a_run_that_ended(run):
    known = json.loads(call("status", run.directory, "--json").output)
    assert (known["state"], known["steps"], known["most_steps"], known["walkers"]) == ("steps", 30, 30, 6)
    assert known["acceptance"] == pytest.approx(run.acceptance)
    assert known["last_alive"] == (run.directory / "chain.h5").stat().st_mtime
    assert "expected_end" not in known
    text = call("status", run.directory).output
    assert "30 of at most 30" in text
    assert f"to continue, with more steps:\n  {known['go_on']}" in text
    assert known["go_on"].endswith(" --steps 60 --resume")  # with 30, the run's own, nothing would be done
    assert run.note()[:30] in " ".join(text.split())


def test_a_sampler_without_steps_shows_its_calls(run, tmp_path):
    """From its first calls on, long before its first samples."""
    for name in ("run.toml", "manifest.json", "data"):
        if (source := run.directory / name).is_dir():
            shutil.copytree(source, tmp_path / name)
        elif source.exists():
            shutil.copy(source, tmp_path / name)
    for name, n in ((CALLS, 2), (SMALL_CALLS, 5)):
        cache = EvaluationCache(tmp_path / name, run.spec.digest())
        for i in range(n):
            nothing = np.full(1, np.nan)
            cache.add(np.full(2, float(i)), Evaluation(-np.inf, -np.inf, nothing, nothing, "no stream"))
        cache.write()
    known = read_status(tmp_path)
    assert (known["calls"], known["small_calls"], known["steps"]) == (2, 5, 0)
    text = describe_status(tmp_path, known)
    assert "2 with all particles, 5 with few" in text
    assert not any(line.split()[:1] == ["steps"] for line in text.splitlines())
    assert "calls" not in read_status(run.directory)


def test_a_run_that_is_going_on_has_an_expected_end(run):
    with locked(run.directory):
        known = read_status(run.directory)
        assert known["state"] == "running"
        text = describe_status(run.directory, known, now=known["last_alive"] + 90)
    assert "90 s ago" in text
    assert "to continue" not in text
    assert known["expected_end"] >= known["last_alive"]
    assert read_status(run.directory)["state"] == "steps"


def test_the_expected_end_is_that_of_the_mean_pace(run):
    """30 steps in 60 s: 15 more take 30 s, if no convergence comes before."""
    known = read_status(run.directory)
    attributes = {"since": known["last_alive"] - 60.0, "first": 0}
    end = _expected_end(run, known | {"most_steps": 45}, attributes)
    assert end == pytest.approx(known["last_alive"] + 60 / 30 * 15)
    assert _expected_end(run, known, {}) is None


def test_log_and_status_expect_the_same_end():
    """Walkers of one autocorrelation time (1 + phi) / (1 - phi) = 9 converge after 50 of them: the look at 500 steps.

    The log hears it at the look at 300 steps, the status reads it between two looks.
    """
    rng, phi = np.random.default_rng(2), 0.8
    chain = rng.standard_normal((370, 64, 2))
    for i in range(1, len(chain)):
        chain[i] = phi * chain[i - 1] + np.sqrt(1 - phi**2) * chain[i]
    sampler = Emcee(moves="stretch", walkers=64, steps=5000)
    at_the_look = sampler.expected_steps(chain[:300], sampler.convergence(chain[:300]))
    assert at_the_look in (400.0, 500.0)
    assert sampler.expected_steps(chain) == at_the_look
    assert sampler.model_copy(update={"steps": 380}).expected_steps(chain) == 380
    assert sampler.expected_steps(chain[:50]) == 5000  # before the first look


def test_a_chain_that_is_long_enough_waits_for_r_hat():
    """Walkers about different means: the length is there, and R-hat - 1 falls with the inverse of the length."""
    rng = np.random.default_rng(4)
    chain = rng.standard_normal((400, 16, 1)) + np.linspace(-0.4, 0.4, 16)[:, None]
    judged = Emcee(moves="stretch", walkers=16).convergence(chain)
    assert not judged
    assert judged.span > judged.tau_factor
    assert judged.expected_steps == pytest.approx(400 * (judged.r_hat.max() - 1) / 0.02, abs=100)


def test_the_expected_end_is_that_of_the_time_limit_if_sooner(run):
    known = read_status(run.directory) | {"most_steps": 1000}
    attributes = {"since": known["last_alive"] - 60.0, "first": 0}
    assert _expected_end(run, known, attributes | {"deadline": 1e9}) == 1e9
    assert _expected_end(run, known, attributes | {"deadline": 0.0}) > known["last_alive"] + 60


def test_the_pace_does_not_count_the_search(run):
    """The run notes when its walkers begin, in the file that `status` reads."""
    attributes = read_chain_file(run.directory / "chain.h5").attributes
    assert attributes["first"] == 0
    assert (run.directory / "manifest.json").stat().st_mtime < attributes["since"]


@pytest.mark.slow
def test_the_command_to_go_on_keeps_the_options(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(to_toml(sk.load(FIT).document))
    options = ["--steps", "2", "--workers", "2", "-q"]
    assert call("run", "small.toml", "--set", "progenitor.v_los=150", "-o", "out", *options).exit_code == 0
    go_on = shlex.split(json.loads(call("status", "out", "--json").output)["go_on"])
    assert go_on == ["streamkit", "run", "out/run.toml", "-o", "out", "--workers", "2", "--steps", "4", "--resume"]
    (tmp_path / "small.toml").unlink()
    done = call(*go_on[1:])
    assert done.exit_code == 0, done.output
    results = sk.load_results("out")
    assert len(results.chain) == 4
    assert results.spec.document["progenitor"]["v_los"] == "150.0 km/s"


def test_no_step_and_no_run(run, tmp_path):
    assert "no such directory" in refused("status", tmp_path / "none")
    assert "holds no run: it has no manifest.json" in refused("status", tmp_path)
    assert "is a file, expected the directory of a run" in refused("report", run.directory / "run.toml")
    for name in ("manifest.json", "run.toml"):
        shutil.copy(run.directory / name, tmp_path)
    known = json.loads(call("status", tmp_path, "--json").output)
    assert (known["state"], known["steps"], known["last_alive"]) == ("unfinished", 0, None)
    assert "stopped before its end" in call("status", tmp_path).output


def test_a_run_file_to_begin_with(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    listed = call("init").output
    assert "sagittarius " in listed
    assert "version = " not in listed  # the comment alone is the description
    assert "gd1_recovery" in listed
    assert [name for name in examples() if not re.search(rf"^  {name} +\w", listed, re.MULTILINE)] == []  # descriptions
    assert "mine.toml" in call("init", "sagittarius", "-o", "mine.toml").output
    assert "next: streamkit check 'my run.toml'" in call("init", "sagittarius", "-o", "my run.toml").output
    text = (tmp_path / "mine.toml").read_text()
    assert text == (ROOT / "examples" / "sagittarius" / "sagittarius.toml").read_text()
    assert sum(line.lstrip().startswith("#") for line in text.splitlines()) > 5
    assert "--force" in refused("init", "sagittarius", "-o", "mine.toml")
    assert call("init", "sagittarius", "-f", "-o", "mine.toml").exit_code == 0
    assert "Did you mean 'sagittarius'" in refused("init", "sagitarius")


def test_a_template_for_a_stream_of_ones_own(tmp_path, monkeypatch):
    """It is valid as it is, with member stars, and every line to change is marked."""
    monkeypatch.chdir(tmp_path)
    assert "streamkit init --own" in call("init").output
    assert "own.toml" in call("init", "--own").output
    spec = sk.load("own.toml")
    assert "progenitor.v_los" in spec.names
    assert spec.bind().observable.members is not None
    text = (tmp_path / "own.toml").read_text()
    assert text.count("<-") > 10
    assert "--force" in refused("init", "--own")
    assert "found the example" in refused("init", "gd1", "--own", "-f")


def test_a_wheel_holds_the_examples():
    """Their folder is packed without texts and pictures: `init` lists the same in a clone and where it is installed."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    files = [file for path in examples().values() for file in (path, *tables_of(path).values())]
    assert "examples" in wheel["only-include"]
    assert wheel["sources"] == {"examples": "streamkit/examples"}
    left_out = {"." + pattern.rpartition(".")[2] for pattern in wheel["exclude"]}
    assert not {file.suffix for file in files} & left_out
    assert all(file.is_file() and file.is_relative_to(ROOT / "examples") for file in files)


def test_the_tables_of_an_example_come_with_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "phi2.ecsv").touch()
    assert "phi2.ecsv" in refused("init", "gd1")
    assert not (tmp_path / "gd1.toml").exists()
    assert call("init", "gd1", "-f").exit_code == 0
    assert sk.load("gd1.toml").document["observable"]["kind"] == "track"


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "gd1" else pytest.mark.slow) for name in examples()]
)
def test_an_example_is_valid_in_an_empty_directory(name, tmp_path, monkeypatch):
    """With all its tables: those of other examples have names of their own."""
    monkeypatch.chdir(tmp_path)
    written = call("init", name).output
    spec = sk.load(f"{name}.toml")
    assert spec.bind_all(spec.centre()).potentials
    assert {path.name for path in tmp_path.iterdir()} == {f"{name}.toml", *spec.files}
    assert all(file in written for file in spec.files)
    assert "../" not in (tmp_path / f"{name}.toml").read_text().replace("# ../", "").partition("[")[2]
