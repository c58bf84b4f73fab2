"""All calls so far, in the coordinates of the walks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit import Array, BoolArray
from streamkit.builtin.samplers.emulator.coordinates import Space
from streamkit.builtin.samplers.emulator.emulator import Emulator
from streamkit.builtin.samplers.emulator.learn import learn
from streamkit.builtin.samplers.emulator.problem import Answers, Problem


@dataclass(frozen=True)
class Calls:
    """Points and what calls gave there.

    Attributes
    ----------
    y, theta
        (n, d) coordinates and parameters.
    answers
        Of the calls.
    """

    problem: Problem
    space: Space
    y: Array
    theta: Array
    answers: Answers

    @classmethod
    def at(cls, problem: Problem, space: Space, y: Array, theta: Array | None = None) -> Calls:
        """Call the model at coordinates y (n, d), or at the same places as parameters theta (n, d)."""
        theta = np.ascontiguousarray(space.back(y) if theta is None else theta)
        return cls(problem, space, y, theta, problem.evaluate(theta))

    def __len__(self) -> int:
        return len(self.y)

    def __add__(self, other: Calls) -> Calls:
        answers = self.answers.joined(other.answers)
        y, theta = (np.concatenate([getattr(each, name) for each in (self, other)]) for name in ("y", "theta"))
        return Calls(self.problem, self.space, y, theta, answers)

    def take(self, rows: BoolArray) -> Calls:
        """Return some of them."""
        answers = Answers(*(each[rows] for each in self.answers))
        return Calls(self.problem, self.space, self.y[rows], self.theta[rows], answers)

    @property
    def good(self) -> BoolArray:
        """(n,) Whether a call gave a prediction."""
        return np.asarray(np.isfinite(self.answers.ln_likelihood), dtype=bool)

    def learn(self, tilt: Array | None = None) -> Emulator | None:
        """Return the emulator of all of them; ``tilt`` (n,) is added to their ln likelihoods, which weigh them."""
        return learn(self.problem, self.y, self.answers, self.theta, tilt)
