"""Engines: the same chain on each, and a sentence where one cannot be had."""

import importlib.util
import os
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from runfiles import FIT
from toys import Gaussian, Slow, walk

import streamkit as sk
from streamkit.errors import blamed
from streamkit.fit import read_status, runner
from streamkit.fit.options import engine_of
from streamkit.runfile import Engine
from streamkit.sample import CallTimeout, ChainMemory, Workers, engine
from streamkit.sample.calls import timeout, workers
from streamkit.sample.calls.timeout import NO_ANSWER, call_with_timeout
from streamkit.sample.calls.workers import OVERTIME

SUPPORT = str(Path(__file__).parents[2] / "support")
SCRIPT = """
import sys
import numpy as np
from test_engines import chain
if __name__ == "__main__":
    np.save(sys.argv[2], chain(sys.argv[1]))
"""


def chain(name):
    chain = ChainMemory()
    with (
        engine(Engine(kind=name, workers=2)) as where,
        Workers({"full": Gaussian(), "cheap": Gaussian()}, where) as pool,
    ):
        walk(Gaussian(), pool, chain, walkers=8, steps=10)
    return chain.samples()


@pytest.fixture(scope="module")
def alone():
    return chain("serial")


def test_processes_make_the_same_chain(alone):
    np.testing.assert_array_equal(chain("processes"), alone)


@pytest.mark.parametrize("name", ["dask", "mpi"])
def test_others_make_the_same_chain(alone, tmp_path, name):
    module = {"dask": "distributed", "mpi": "mpi4py"}[name]
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} is not installed: pip install 'tidal-streamkit[{name}]'")
    if name == "mpi" and shutil.which("mpiexec") is None:
        pytest.skip("there is no mpiexec")
    (tmp_path / "script.py").write_text(SCRIPT)
    launch = ["mpiexec", "-n", "3", sys.executable, "-m", "mpi4py.futures"] if name == "mpi" else [sys.executable]
    paths = [SUPPORT, str(Path(__file__).parent), *sys.path]
    subprocess.run([*launch, str(tmp_path / "script.py"), name, str(tmp_path / "chain.npy")], check=True, timeout=120,
                   env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)})  # fmt: skip
    np.testing.assert_array_equal(np.load(tmp_path / "chain.npy"), alone)


def test_an_engine_that_is_not_there_says_how_to_get_it():
    for name, module in (("dask", "distributed"), ("mpi", "mpi4py")):
        if importlib.util.find_spec(module) is None:
            with (
                pytest.raises(sk.StreamkitError, match=rf"pip install 'tidal-streamkit\[{name}\]'"),
                engine(Engine(kind=name)),
            ):
                pass
    if importlib.util.find_spec("mpi4py") is not None:
        with pytest.raises(sk.StreamkitError, match=r"mpiexec .*mpi4py\.futures"), engine(Engine(kind="mpi")):
            pass


@pytest.mark.parametrize(
    ("section", "options", "told"),
    [
        ({"kind": "process"}, {}, r"engine\.kind: found 'process', should be .*Did you mean 'processes'\?"),
        ({}, {"engine": "dusk"}, r"engine\.kind: found 'dusk', .*Did you mean 'dask'\?"),
        ({"workers": 0}, {}, r"engine\.workers: found 0, should be greater than or equal to 1"),
        ({"worker": 2}, {}, r"engine\.worker: \[engine\] has no field 'worker'\. Did you mean 'workers'\?"),
        ({"scheduler": "tcp://x:1"}, {}, 'a scheduler belongs to kind = "dask"; found kind = "processes"'),
        ({}, {"engine": "serial", "scheduler": "tcp://x:1"}, 'a scheduler belongs to kind = "dask"'),
        ({}, {"engine": "serial", "workers": ThreadPoolExecutor(1)}, "takes the place of an engine"),
    ],
)
def test_what_is_no_engine_is_told(section, options, told):
    with pytest.raises(sk.SpecError, match=told):
        sk.run(FIT | {"engine": section}, progress=False, **options)


def test_the_run_file_says_which_engine_and_the_command_line_comes_before_it(tmp_path, monkeypatch):
    """The pool that a run is given; the digest knows of no engine; the command to go on repeats what was said."""
    pools = []
    monkeypatch.setattr(runner.sample, "Workers", lambda posteriors, where, **more: pools.append(where) or 1 / 0)
    document = FIT | {"engine": {"workers": 3}}
    spec = sk.load(document)
    assert spec.digest() == sk.load(FIT).digest()
    assert "engine" not in sk.load(FIT).document
    assert sk.load(FIT).with_values({"engine.workers": 3}) == spec
    for options, words in (
        ({}, []),
        ({"workers": 2}, ["--workers", "2"]),
        ({"engine": "serial"}, ["--engine", "serial"]),
        ({"workers": 1, "quick": True}, ["--quick", "--workers", "1"]),
    ):
        with pytest.raises(ZeroDivisionError):
            sk.run(document, tmp_path, progress=False, force=True, **options)
        go_on = shlex.split(read_status(tmp_path)["go_on"])
        assert go_on[:5] == ["streamkit", "run", str(tmp_path / "run.toml"), "-o", str(tmp_path)]
        assert go_on[5:] == [*words, "--resume"]
    assert pools == [3, 2, 1, 1]
    chosen = sk.load(FIT | {"engine": {"kind": "dask", "scheduler": "tcp://x:1"}})
    assert engine_of(chosen, None, "serial", None) == Engine(kind="serial")


def test_a_call_is_ended_or_noticed_wherever_it_is_made():
    def work(seconds):
        time.sleep(seconds)
        return seconds

    assert call_with_timeout(5.0, work, 0.01) == 0.01
    begin, before = time.monotonic(), signal.getsignal(signal.SIGALRM)
    timer = signal.getitimer(signal.ITIMER_REAL)[0]  # that of the tests
    assert call_with_timeout(0.05, work, 1000) == NO_ANSWER
    assert time.monotonic() - begin < 60
    with pytest.raises(ZeroDivisionError):
        call_with_timeout(5.0, divmod, 1, 0)
    assert signal.getsignal(signal.SIGALRM) == before
    assert timer - 60 < signal.getitimer(signal.ITIMER_REAL)[0] <= timer
    with ThreadPoolExecutor(1) as thread:  # as Dask's workers: too late, but noticed
        assert thread.submit(call_with_timeout, 0.05, work, 0.2).result() == NO_ANSWER
        assert thread.submit(call_with_timeout, 5.0, work, 0.01).result() == 0.01


def test_the_first_call_ends_too(monkeypatch):
    """It is made in the main process, with time to compile."""
    monkeypatch.setattr(workers, "COMPILING", 0.1)
    begin = time.monotonic()
    with pytest.raises(CallTimeout, match=r"the first call took longer than .* 0\.1 s"):
        workers.first_call(0.1, Slow(1000).evaluate, np.zeros(3))
    assert time.monotonic() - begin < 60
    workers.first_call(5.0, Slow(0).evaluate, np.zeros(3))


def test_no_component_keeps_a_call_from_its_end(monkeypatch):
    monkeypatch.setattr(timeout, "AGAIN", 0.05)

    def stubborn(tries):
        for _ in range(tries):
            with suppress(BaseException):
                time.sleep(1000)

    def disguised():
        with blamed("potential x"):
            time.sleep(1000)

    assert call_with_timeout(0.05, stubborn, 3) == NO_ANSWER
    assert call_with_timeout(0.05, disguised) == NO_ANSWER


def test_an_engine_that_cannot_end_a_call_does_not_wait_for_ever(monkeypatch):
    monkeypatch.setattr(workers, "COMPILING", 0.0)
    over = threading.Event()
    monkeypatch.setattr(workers, "evaluate_sent", lambda *_: over.wait(100))
    with ThreadPoolExecutor(1) as mine:
        try:
            with (
                Workers({"full": Gaussian()}, mine, limit=0.2) as pool,
                pytest.raises(CallTimeout, match=r"1 call did not end within sampler\.call_limit = 0\.2 s"),
            ):
                pool.evaluate(np.zeros((2, 3)))
        finally:
            over.set()


def test_calls_over_the_limit_are_rejections_on_other_engines_too():
    points = np.random.default_rng(0).standard_normal((20, 3))
    slow = (np.abs(points[:, 0]) * 1e6).astype(int) % 10 == 0
    assert slow[1:].any()
    slow[0] = False  # it is the worker's first, which may compile
    with ThreadPoolExecutor(1) as mine, Workers({"full": Slow(0.5)}, mine, limit=0.25, reject=True) as pool:
        assert [found.reason == OVERTIME for found in pool.evaluate(points)] == slow.tolist()


@pytest.mark.parametrize("where", [1, 2, ThreadPoolExecutor])
def test_calls_of_several_posteriors_share_one_queue(where):
    points = np.random.default_rng(2).normal(size=(3, 40, 3))
    batches = [("full", points[0]), ("cut", points[1]), ("full", points[2])]
    executor = where(2) if where is ThreadPoolExecutor else where
    posteriors = {"full": Gaussian(), "cut": Gaussian(cut=True)}
    with Workers(posteriors, executor) as pool:
        found = list(pool.each_of(batches))
    alone = [posteriors[which].evaluate(p) for which, some in batches for p in some]
    assert [each.lnp for each in found] == [each.lnp for each in alone]
    assert pool.calls == {"full": 80, "cut": 40}
    assert pool.reasons["full"].total() + pool.reasons["cut"].total() == sum(bool(each.reason) for each in alone) > 0
