import numpy as np
from pydantic import Field

from streamkit import Sampler, Samples, hookimpl


class Importance(Sampler):
    """Draws from the prior, weighted by their likelihood: for posteriors nearly as wide as the prior."""

    kind = "importance"
    stopping = ("draws",)
    example = {"draws": 30000}
    draws: int = Field(default=3000, ge=1, description="Draws from the prior.")

    def sample(self, target):
        """Draw a hundred at a time, and yield all draws so far."""
        rng = np.random.default_rng(target.seed)
        points, lnl = np.empty((0, target.size)), np.empty(0)
        while len(points) < self.draws and target.time_left() > 0:
            new = target.from_unit(rng.random((min(100, self.draws - len(points)), target.size)))
            points, lnl = np.concatenate([points, new]), np.concatenate([lnl, target.evaluate(new)])
            weights = np.exp(lnl - lnl.max())
            evidence = lnl.max() + np.log(weights.mean())
            error = weights.std() / weights.mean() / np.sqrt(len(weights))
            missing = "" if len(points) == self.draws else f"{len(points)} of {self.draws} draws are made"
            yield Samples(points, lnl, float(evidence), float(error), missing)


@hookimpl
def streamkit_components():
    return [Importance]
