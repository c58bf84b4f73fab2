"""The places of a chain as calls that the emulator's learner learns from."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np

from streamkit import Array, BoolArray, Data, EmulatedLikelihood, Evaluations, StreamkitError, Target
from streamkit.builtin.samplers.emulator.sampler import PredictionEmulator

MOST = 2000  # places that are learned from, the newest
LEAST = 3  # places for each parameter
EXPLAINED = 1e-6  # relative difference up to which a stored ln likelihood is that of the predictions and the data
COMPARED = 50  # places at which this is looked at


class Called:
    """The posterior with the calls that were made: what the emulator's learner needs of a `streamkit.Target`.

    Where ln likelihood is not the Gaussian one of the predictions and the data, as the observable has its own or its
    data depend on a parameter, it takes the place of the predictions.

    Parameters
    ----------
    earlier, found
        (n, d) places, and what calls gave there.
    """

    undeclared = ()

    def __init__(self, target: Target, earlier: Array, found: Evaluations) -> None:
        self._target, self.earlier = target, earlier
        self.coordinates: BoolArray = np.ones(target.size, dtype=bool)
        self.subject = "the observables" if _explains(found, target.data) else "ln likelihood"
        self.data, self._found = target.data, found
        if self.subject == "ln likelihood":
            self.data = Data(np.zeros(1), np.ones(1))
            mean = np.where(np.isfinite(found.ln_likelihood), found.ln_likelihood, np.nan)[:, None]
            self._found = replace(found, mean=mean, variance=np.zeros_like(mean))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)  # the priors, the seed

    def predictions(self, points: Array, small: bool = False) -> Evaluations:
        """Return what the calls gave: ``points`` are those of ``earlier``."""
        return self._found

    def compare(self, points: Array, mean: Array, variance: Array, details: Array) -> Array:
        """Return ln likelihood (n,) for given predictions; one that was learned itself is taken without its error."""
        return mean[:, 0] if self.subject == "ln likelihood" else self.data.gaussian_of_many(mean, variance)


def learn(target: Target, steps: int, refused: Array) -> tuple[EmulatedLikelihood, Array, str] | None:
    """Learn the likelihood from the first steps of the chain, and from places (n, d) without a prediction.

    Returns it with the different places (n, d) of the walkers, and its subject: "the observables" or "ln likelihood".
    None if there are too few, or if they do not span the space.
    """
    every = target.chain()[:steps].reshape(-1, target.size)
    newest = np.sort(np.unique(every, axis=0, return_index=True)[1])[-MOST:]
    if len(newest) < LEAST * target.size:
        return None
    whole, none = target.chain_evaluations(), np.full((len(refused), len(target.data.values)), np.nan)
    nothing = np.full(len(refused), -np.inf)
    found = Evaluations(
        np.concatenate([whole.ln_probability[newest], nothing]),
        np.concatenate([whole.ln_likelihood[newest], nothing]),
        np.concatenate([whole.mean[newest], none]),
        np.concatenate([whole.variance[newest], none]),
        ("",) * (len(newest) + len(refused)),
        np.empty((len(newest) + len(refused), 0)),
    )
    called = Called(target, np.concatenate([every[newest], refused]), found)
    learner = PredictionEmulator(realisation="one" if called.data.add_noise else "limit")
    try:
        return learner.emulated(cast(Target, called)), every[newest], called.subject
    except StreamkitError:  # too few places, or the walkers hardly moved
        return None


def _explains(found: Evaluations, data: Data) -> bool:
    """Return whether ln likelihood (n,) is the Gaussian one of the predictions and the data."""
    there = np.flatnonzero(np.isfinite(found.ln_likelihood))
    some = there[np.unique(np.linspace(0, len(there) - 1, COMPARED).astype(int))]
    gauss = np.array([data.gaussian(found.mean[i], found.variance[i]) for i in some])
    lnl = found.ln_likelihood[some]
    return bool(np.allclose(gauss - gauss[0], lnl - lnl[0], rtol=EXPLAINED, atol=EXPLAINED))
