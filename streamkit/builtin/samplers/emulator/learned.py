"""The likelihood that an emulator learns from calls that have been made, for whoever asks for it without a fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit import Array, BoolArray, StreamkitError, Target
from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.learn.of_target import LikelihoodOnly, OfTarget
from streamkit.builtin.samplers.emulator.learn.problem import Problem
from streamkit.builtin.samplers.emulator.learn.space import Space
from streamkit.builtin.samplers.emulator.walk.density import Emulated


@dataclass(frozen=True)
class Learned:
    """An emulated likelihood of parameters: a `streamkit.EmulatedLikelihood`."""

    emulated: Emulated

    def ln_likelihood(self, points: Array) -> Array:
        """Return ln likelihood (n,) at points (n, d)."""
        return self.emulated.ln_likelihood(self.emulated.space.normal(points))

    def is_trusted(self, points: Array) -> BoolArray:
        """Return whether points (n, d) are among the calls, (n,)."""
        predicted = self.emulated.emulator.predict(self.emulated.space.learned_of(points))
        return np.asarray(predicted.beyond <= 1.0, dtype=bool)

    def redrawn(self, rng: np.random.Generator) -> Learned:
        """Return the likelihood that other noise in the calls could have given."""
        return Learned(self.emulated.redrawn(rng))


def learned(target: Target, noise: bool) -> Learned:
    """Return the likelihood of a target by its earlier calls; StreamkitError if there are too few predictions."""
    problem: Problem = OfTarget(target)
    if target.undeclared:
        problem = LikelihoodOnly(problem)
    space = Space(problem)
    calls = Calls.of(problem, space, target.earlier)
    emulator = calls.learn() if calls.good.any() else None
    if emulator is None:
        raise StreamkitError(f"too few of {len(calls)} stored calls have a prediction to learn from")
    return Learned(Emulated(space, emulator, noise))
