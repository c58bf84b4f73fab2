"""The sampler nautilus for streamkit: importance nested sampling with neural networks, and the evidence."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, ClassVar

import nautilus
import numpy as np
from pydantic import Field
from threadpoolctl import threadpool_limits

from streamkit import CONTRACT, Array, Component, Sampler, Samples, Target, hookimpl

STREAMKIT_CONTRACT = CONTRACT
PART = 2000  # calls after which the samples so far are yielded


class Nautilus(Sampler):
    """Importance nested sampling by nautilus: few calls for each effective sample, and the evidence."""

    kind = "nautilus"
    reference = "Lange 2023, MNRAS 525, 3181"
    bibtex = """
@article{Lange2023,
  author = {{Lange}, Johannes U.},
  title = {{NAUTILUS: boosting Bayesian importance nested sampling with deep learning}},
  journal = {MNRAS},
  year = 2023,
  volume = {525},
  pages = {3181--3194},
  doi = {10.1093/mnras/stad2441},
}
"""
    stopping = ("effective_samples", "max_calls")
    example: ClassVar[dict[str, Any]] = {"live_points": 150, "effective_samples": 500, "networks": 1}

    effective_samples: int = Field(default=4000, ge=1, description="Stop when there are so many effective samples.")
    max_calls: int = Field(
        default=1_000_000, ge=1, description="Stop after so many calls of the posterior in any case."
    )
    live_points: int = Field(default=2000, ge=10, description="Live points. More find more modes, and cost more calls.")
    networks: int = Field(
        default=4, ge=0, description="Neural networks that learn ln likelihood; without any, ellipsoids alone."
    )
    batch: int = Field(default=96, ge=1, description="Calls that are made at a time; a multiple of the workers.")
    live_evidence: float = Field(
        default=0.01, gt=0, lt=1, description="Explore until the live points hold this fraction of the evidence."
    )
    discard_exploration: bool = Field(
        default=False, description="Leave out the points of the exploration: no bias at all, and more calls."
    )

    def sample(self, target: Target) -> Iterator[Samples]:
        """Run nautilus; tell every 2000 calls."""
        places: dict[bytes, Array] = {}
        # Calls and effective samples at the end of the exploration, whose length is unknown before.
        begun: dict[str, float] = {}

        def ln_likelihood(u: Array) -> Array:
            points = target.from_unit(u)
            if sampler.explored:
                begun.setdefault("calls", sampler.n_like)
                begun.setdefault("samples", sampler.n_eff)
                new, gained = sampler.n_like - begun["calls"], sampler.n_eff - begun["samples"]
                if gained > 0:
                    target.expect(sampler.n_like + (self.effective_samples - sampler.n_eff) * new / gained)
            places.update({row.tobytes(): point for row, point in zip(np.ascontiguousarray(u), points, strict=True)})
            return target.evaluate(points)

        sampler = nautilus.Sampler(
            _unchanged, ln_likelihood, target.size, n_live=self.live_points, n_networks=self.networks,
            n_batch=self.batch, vectorized=True, pass_dict=False, seed=target.seed,
        )  # fmt: skip
        done = False
        while not done and sampler.n_like < self.max_calls and target.time_left() > 0:
            with threadpool_limits(1):  # the workers have the cores, and sums of threads differ in their last digits
                done = bool(
                    sampler.run(
                        f_live=self.live_evidence,
                        n_eff=self.effective_samples,
                        n_like_max=min(sampler.n_like + PART, self.max_calls),
                        discard_exploration=self.discard_exploration,
                        timeout=target.time_left(),
                    )
                )
            u, ln_weights, _ = sampler.posterior()
            if not np.isfinite(ln_weights).any():
                continue
            points = np.array([places[row.tobytes()] for row in np.ascontiguousarray(u)])
            missing = "" if done else _missing(sampler, self.effective_samples)
            yield Samples(points, ln_weights, float(sampler.log_z), 1 / math.sqrt(sampler.n_eff), missing)

    def reject_dimension(self, d: int) -> str:
        """Ask for two parameters: nautilus cannot do with one."""
        return "" if d > 1 else "kind: nautilus needs 2 free parameters, found 1"

    def quick_settings(self, d: int) -> dict[str, int | float]:
        """Take few live points and few samples."""
        return {"live_points": min(self.live_points, 400), "effective_samples": min(self.effective_samples, 500)}


def _unchanged(u: Array) -> Array:
    """Return the fractions of the priors: `Target.from_unit` makes parameters of them, once."""
    return u


def _missing(sampler: nautilus.Sampler, wanted: int) -> str:
    if not sampler.explored:
        return f"nautilus is still exploring, after {sampler.n_like} calls"
    return f"{sampler.n_eff:.0f} effective samples, and {wanted} are wanted"


@hookimpl
def streamkit_components() -> list[type[Component]]:
    """List the sampler."""
    return [Nautilus]
