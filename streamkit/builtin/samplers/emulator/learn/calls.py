"""All calls of a factor so far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit import Array, BoolArray
from streamkit.builtin.samplers.emulator.learn.emulator import Emulator
from streamkit.builtin.samplers.emulator.learn.from_calls import learn
from streamkit.builtin.samplers.emulator.learn.problem import Answers, Problem
from streamkit.builtin.samplers.emulator.learn.space import Space


@dataclass(frozen=True)
class Calls:
    """Points and what calls gave there.

    Attributes
    ----------
    theta
        (n, d) parameters.
    answers
        Of the calls.
    """

    problem: Problem
    space: Space
    theta: Array
    answers: Answers

    @classmethod
    def at(cls, problem: Problem, space: Space, z: Array) -> Calls:
        """Call the model at coordinates z (n, d)."""
        return cls.of(problem, space, space.points(z))

    @classmethod
    def of(cls, problem: Problem, space: Space, theta: Array) -> Calls:
        """Call the model at parameters theta (n, d)."""
        theta = np.ascontiguousarray(theta)
        return cls(problem, space, theta, problem.evaluate(theta))

    def __len__(self) -> int:
        return len(self.theta)

    def __add__(self, other: Calls) -> Calls:
        theta = np.concatenate([self.theta, other.theta])
        return Calls(self.problem, self.space, theta, self.answers.joined(other.answers))

    def take(self, rows: BoolArray) -> Calls:
        """Return some of them."""
        return Calls(self.problem, self.space, self.theta[rows], self.answers.take(rows))

    @property
    def z(self) -> Array:
        """(n, d) Coordinates of walkers."""
        return self.space.normal(self.theta)

    @property
    def y(self) -> Array:
        """(n, d) Coordinates of what is learned."""
        return self.space.learned_of(self.theta)

    @property
    def good(self) -> BoolArray:
        """(n,) Whether a call gave a prediction."""
        return np.asarray(np.isfinite(self.answers.ln_likelihood), dtype=bool)

    def learn(self, tilt: Array | None = None) -> Emulator | None:
        """Return the emulator of all of them; ``tilt`` (n,) is added to their ln likelihoods, which weigh them."""
        return learn(self.problem, self.y, self.answers, self.theta, tilt)
