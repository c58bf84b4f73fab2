"""Engines: the same chain on each, and a sentence where one cannot be had."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from emcee.backends import Backend
from toys import Gaussian, sampling

import streamkit as sk
from streamkit.sample import Limits, Workers, engine

SUPPORT = str(Path(__file__).parents[1] / "support")
SCRIPT = """
import sys
import numpy as np
from test_engines import chain
if __name__ == "__main__":
    np.save(sys.argv[2], chain(sys.argv[1]))
"""


def chain(name):
    backend = Backend()
    with engine(name, 2) as workers, Workers({"full": Gaussian(), "cheap": Gaussian()}, workers) as pool:
        run = sampling(pool, backend, walkers=8)
        run.begin()
        run.advance(Limits(10, tau_factor=1e9))
    return backend.get_chain()


@pytest.fixture(scope="module")
def alone():
    return chain("serial")


def test_processes_make_the_same_chain(alone):
    np.testing.assert_array_equal(chain("processes"), alone)


@pytest.mark.parametrize("name", ["dask", "mpi"])
def test_others_make_the_same_chain(alone, tmp_path, name):
    module = {"dask": "distributed", "mpi": "mpi4py"}[name]
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} is not installed: pip install 'streamkit[{name}]'")
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
            with pytest.raises(sk.StreamkitError, match=rf"pip install 'streamkit\[{name}\]'"), engine(name, 2):
                pass
    if importlib.util.find_spec("mpi4py") is not None:
        with pytest.raises(sk.StreamkitError, match=r"mpi4py\.futures"), engine("mpi", 2):
            pass
    with pytest.raises(sk.StreamkitError, match="Did you mean 'processes'"), engine("process", 2):
        pass
    with pytest.raises(sk.StreamkitError, match="only the engine dask has one"), engine("serial", 1, "tcp://x:1"):
        pass
