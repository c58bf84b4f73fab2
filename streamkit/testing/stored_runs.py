"""Checks of a sampler by the code that samples and stores a run: its files are written, read and continued."""

from __future__ import annotations

import tempfile
from itertools import islice
from pathlib import Path

import numpy as np

import streamkit as sk
from streamkit import sample
from streamkit.testing.common import require
from streamkit.testing.samplers import Gaussian

HALF = 15  # steps before the chain is resumed, and after


class Evaluated:
    """The Gaussian of the checks as `streamkit.sample.Workers` calls it, point by point."""

    def __init__(self) -> None:
        self._target = Gaussian()

    def evaluate(self, theta: sk.Array) -> sample.Evaluation:
        """Evaluate at theta (2,): the predictions are the parameters."""
        lnl = float(self._target.evaluate(theta[None])[0])
        if not np.isfinite(lnl):
            return self.rejected("no stream")
        lnp = float(self._target.ln_prior(theta[None])[0]) + lnl
        return sample.Evaluation(lnp, lnl, theta.copy(), np.zeros(2))

    def rejected(self, reason: str) -> sample.Evaluation:
        """Return the evaluation of parameters without an answer."""
        nothing = np.full(2, np.nan)
        return sample.Evaluation(-np.inf, -np.inf, nothing, nothing, reason)


def target_of(storage: sample.Storage) -> sample.PosteriorTarget:
    """Return the target of a run of the Gaussian, with this storage."""
    problem, posterior = Gaussian(), Evaluated()
    calls = sample.Workers({"full": posterior, "cheap": posterior})
    return sample.PosteriorTarget(problem.priors, problem.data, problem.seed, calls, storage)


def survives_its_files(component: sk.Sampler) -> None:
    """Check that a run's files give back what the sampler yields, and that a chain continues from its files."""
    if component.emulates:  # the target of such a sampler compares predictions by the components of a run file
        return
    with tempfile.TemporaryDirectory() as folder:
        if isinstance(component, sk.ChainSampler):
            _chain_survives(component, Path(folder))
        else:
            _samples_survive(component, Path(folder) / sample.SAMPLES)


def _chain_survives(component: sk.ChainSampler, folder: Path) -> None:
    whole = _walked(component, sample.chain_storage(None, {}, resumes=False), 2 * HALF)
    first = _walked(component, sample.chain_storage(folder, {}, resumes=False), HALF)
    read = sample.read_chain_file(folder / sample.CHAIN)
    require(np.array_equal(read.chain, first), "the points that the chain file gives back are others")
    again = _walked(component, sample.chain_storage(folder, {}, resumes=True), 2 * HALF)
    reason = "the points, random_state or memory of a step must hold all that the next depends on"
    require(np.array_equal(again, whole), f"a chain that is resumed from its files has other steps: {reason}")


def _walked(component: sk.ChainSampler, storage: sample.Storage, steps: int) -> sk.Array:
    """Return the chain (steps, walkers, d) after so many steps, the stored ones included."""
    longest = component.model_copy(update={"steps": steps})
    for _ in sample.run_sampler(longest, target_of(storage)):
        pass
    return storage.chain.samples()


def _samples_survive(component: sk.Sampler, path: Path) -> None:
    for weighted in islice(sample.run_sampler(component, target_of(sample.Storage())), 2):
        weighted.write(path)
        read = sample.read_weighted(path)
        same = np.array_equal(read.points, weighted.points) and np.array_equal(read.ln_weights, weighted.ln_weights)
        require(same, "the samples that the file gives back are others")
        require(read.verdicts == weighted.verdicts, "the verdicts that the file gives back are others")
