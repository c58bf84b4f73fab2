"""What is known of a factor, and where its starts have come to."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from streamkit import Array
from streamkit.builtin.samplers.emulator.certificate import Certificate
from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.walk.density import Emulated, Factor

# A start has missed a place that it puts lower by so much in ln L, beside its best place, than all calls do.
EXCLUDED = 30.0
# Samples that are looked at.
SOME = 1000


@dataclass(frozen=True)
class Start:
    """Where a start has come to.

    Attributes
    ----------
    calls
        All its calls.
    places
        (n, d) coordinates z sampled from its emulated posterior.
    emulated
        The likelihood that it has emulated.
    draws
        Draws of the prior that it began with; 0 where an earlier run's calls were there.
    """

    calls: Calls
    places: Array
    emulated: Emulated
    draws: int = 0

    def missed(self, samples: Array, ln_likelihood: Array) -> float:
        """Return the fraction of samples (n, d) that it excludes, where all calls give this ln likelihood (n,)."""
        lost = np.max(self.emulated.ln_likelihood(self.places)) - self.emulated.ln_likelihood(samples)
        return float(np.mean(lost - (ln_likelihood.max() - ln_likelihood) > EXCLUDED))


@dataclass(eq=False)
class Known:
    """What is known of a factor.

    Attributes
    ----------
    factor
        The factor.
    calls
        All its calls with all particles.
    emulated
        Its emulated likelihood.
    starts
        Its independent starts.
    seen
        How many of them lead to all of the posterior; None before the end, and of one factor of several.
    alone
        The best emulated ln likelihood of the stream alone.
    own_error
        What its emulator's own error would change of ln L at the joint posterior, were it not limited.
    blur
        What its emulator's own error changes of the posterior, see `changes.change_of`.
    share
        Its part of the variance that the noise of the calls leaves, in standard deviations squared.
    called_at
        (n, p) samples of the posterior when it was last called; none before.
    taught
        What its last calls have changed of these samples, see `changes.change_of`; nothing if an earlier run made them.
    moves
        What the calls of the last rounds have changed of the coordinates that are asked for.
    certificate
        What calls that it has not learned from say of it; None before the end.
    trend
        What the trend of the residuals of these calls moves of the coordinates that are asked for.
    is_confirmed
        Whether its own calls may test it, see `held_out`: those of an earlier run, or confirmed by fresh ones and no
        others made since.
    before
        What was emulated in the last rounds.
    """

    factor: Factor
    calls: Calls
    emulated: Emulated
    starts: list[Start]
    alone: float
    own_error: float = np.inf
    blur: float = np.inf
    share: float = np.inf
    called_at: Array = field(default_factory=lambda: np.empty((0, 0)))
    taught: float = np.inf
    moves: float = np.inf
    certificate: Certificate | None = None
    trend: float = np.inf
    is_confirmed: bool = False
    before: list[Emulated] = field(default_factory=list)
    seen: int | None = None
