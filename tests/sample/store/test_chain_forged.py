"""Chain files that somebody changed, some of them with the right checksum."""

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from forging import forging
from toys import banana_run

import streamkit as sk
from streamkit.sample import ChainFile


def nan(file):
    file["mcmc/chain"][3, 2, 1] = np.nan


def sample(file):
    file["mcmc/chain"][3, 2, 1] += 1e-9


def fewer(file):
    file["mcmc"].attrs["iteration"] = 20


def linked(file):
    file.move("mcmc/chain", "mcmc/other")
    file["mcmc/chain"] = h5py.SoftLink("/mcmc/other")


def elsewhere(file):
    with h5py.File(file.filename + ".2", "w") as other:
        other["mcmc/log_prob"] = file["mcmc/log_prob"][...]
    del file["mcmc/log_prob"]
    file["mcmc/log_prob"] = h5py.ExternalLink(file.filename + ".2", "mcmc/log_prob")


def accepted(file):
    file["mcmc/accepted"][0] = 31


def position(file):
    """Numpy would read behind the state of its generator."""
    file["mcmc"].attrs["random_state_2"] = 10**9


def stateless(file):
    for name in [name for name in file["mcmc"].attrs if name.startswith("random_state")]:
        del file["mcmc"].attrs[name]


def texts(file):
    file.create_dataset("memory/more", data=np.array([b"x"]))


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """The file of a chain whose moves have learned, to be copied."""
    path = tmp_path_factory.mktemp("chain") / "chain.h5"
    banana_run(ChainFile(path), 30, "surrogate")
    return path


@pytest.mark.parametrize("forged", [False, True], ids=["", "with a new checksum"])
@pytest.mark.parametrize("change", [nan, sample, fewer, linked, elsewhere, accepted, position, stateless, texts])
def test_a_chain_changed_behind_its_back_is_refused(chain, tmp_path, change, forged):
    path = Path(shutil.copy(chain, tmp_path))
    with forging(path) if forged else h5py.File(path, "a") as file:
        change(file)
    with pytest.raises(sk.ChainError, match="changed after it was written: "):
        ChainFile(path).load()
