"""A sampler as a plugin file may bring one: importance sampling of the prior."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from streamkit import Component, Sampler, Samples, Target, hookimpl


class Importance(Sampler):
    """Draws from the prior, weighted by their likelihood."""

    kind = "importance"
    stopping = ("draws",)
    example: ClassVar[dict[str, Any]] = {"draws": 40000}

    draws: int = Field(default=3000, ge=1, description="Draws from the prior.")
    each: int = Field(default=500, ge=1, description="Draws at a time.")
    fault: str = Field(default="", description="What to do wrong.")

    def sample(self, target: Target) -> Iterator[Samples]:
        """Draw, and tell after each time."""
        rng = np.random.default_rng(target.seed)
        points, lnl = np.empty((0, target.size)), np.empty(0)
        while len(points) < self.draws and target.time_left() > 0:
            new = target.from_unit(rng.random((min(self.each, self.draws - len(points)), target.size)))
            points, lnl = np.concatenate([points, new]), np.concatenate([lnl, target.evaluate(new)])
            missing = "" if len(points) >= self.draws else f"{len(points)} draws, and {self.draws} are wanted"
            weights = np.exp(lnl - lnl.max())
            error = weights.std() / weights.mean() / np.sqrt(len(weights))
            result = {"shape": points[:, :1], "unknown": points + 1e-9, "": points}.get(self.fault, points)
            ln_weights = np.full(len(lnl), np.nan) if self.fault == "weights" else lnl
            if self.fault != "nothing":
                yield Samples(result, ln_weights, float(lnl.max() + np.log(weights.mean())), float(error), missing)


@hookimpl
def streamkit_components() -> list[type[Component]]:
    """List the components of this file."""
    return [Importance]
