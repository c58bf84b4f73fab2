"""Deaths on the engines beyond this machine: the chain is that of one process, at once or after a resumption."""

import copy
import importlib.util
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from commands import refused
from runfiles import FIT

import streamkit as sk
from streamkit.runfile import to_toml

DEADLY = '''
import os
import signal
from pathlib import Path
import numpy as np
from streamkit import Observable, Prediction, hookimpl

CALLS = []
FLAG = Path(__file__).with_name("deadly")

class Deadly(Observable):
    """The progenitor's distance from the centre; its tenth call in a process kills that, while there is a flag."""

    kind = "deadly"

    def data(self):
        return np.array([20.0]), np.array([2.0])

    def predict(self, stream):
        CALLS.append(1)
        if len(CALLS) == 10 and FLAG.exists():
            FLAG.unlink()
            os.kill(os.getpid(), signal.SIGKILL)
        return Prediction(("distance",), stream.orbit.r[-1:], np.zeros(1))

@hookimpl
def streamkit_components():
    return [Deadly]
'''
STEPS = 6


@pytest.fixture
def run_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "deadly.py").write_text(DEADLY)
    document = copy.deepcopy(FIT) | {"plugins": ["deadly.py"], "observable": {"kind": "deadly"}}
    document["stripping"]["particles"] = 20
    document["progenitor"]["lookback"] = 0.5
    document["sampler"] = {"walkers": 8, "steps": STEPS, "moves": "de"}
    (tmp_path / "run.toml").write_text(to_toml(document))
    return tmp_path / "run.toml"


def command(*launcher, engine):
    """Run the command with an engine, bounded; the products are made by the resumption."""
    words = [*launcher, "-m", "streamkit", "run", "run.toml", "-o", "out", "--engine", engine, "--workers", "2", "-q"]
    path = os.pathsep.join(sys.path)
    return subprocess.run(words, capture_output=True, text=True, timeout=380, env=os.environ | {"PYTHONPATH": path})


def need(module, extra):
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} is not installed: pip install 'tidal-streamkit[{extra}]'")


def alone(run_file):
    return sk.run(run_file, progress=False, products=False).chain


def test_a_dead_rank_ends_the_job_and_the_chain_goes_on_as_if_it_had_not(run_file):
    need("mpi4py", "mpi")
    if shutil.which("mpiexec") is None:
        pytest.skip("there is no mpiexec: pip install mpich, or your system's MPI")
    flag = run_file.with_name("deadly")
    flag.touch()
    done = command("mpiexec", "-n", "3", sys.executable, "-m", "mpi4py.futures", engine="mpi")
    assert done.returncode != 0, done.stdout
    assert not flag.exists()
    again = sk.run(run_file, "out", resume=True, progress=False, products=False)
    np.testing.assert_array_equal(again.chain, alone(run_file))


def test_a_dead_worker_of_dask_is_replaced(run_file):
    need("distributed", "dask")
    flag = run_file.with_name("deadly")
    flag.touch()
    done = command(sys.executable, engine="dask")
    assert done.returncode == 0, done.stderr
    assert not flag.exists()
    np.testing.assert_array_equal(sk.load_results("out", trust=True).chain, alone(run_file))


def test_mpi_that_is_launched_wrongly_says_how(run_file):
    told = refused("run", run_file, "--engine", "mpi")
    if importlib.util.find_spec("mpi4py") is None:
        assert "pip install 'tidal-streamkit[mpi]'" in told
    else:
        assert "`mpiexec -n 8 python -m mpi4py.futures -m streamkit run RUN.toml --engine mpi`" in told
    assert not run_file.with_name("run").exists()
