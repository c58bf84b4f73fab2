"""The sections of a run file that no component fills: how to sample, how to compare."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class Sampler(BaseModel):
    """Settings of emcee."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    walkers: int = Field(default=32, ge=2, description="Number of walkers, at least twice the free parameters.")
    steps: int = Field(default=5000, ge=1, description="Longest chain, in steps per walker.")
    tau_factor: float = Field(
        default=50.0, gt=0, description="Stop when the chain is longer than so many autocorrelation times."
    )
    r_hat: float = Field(
        default=1.02, gt=1, description="Stop only when the split R-hat of every parameter is below this."
    )
    start_particles: int = Field(
        default=1000,
        ge=2,
        description="Particles of the streams that the search for a start tries, the run's own number at most. Where "
        "an observable is made of little of the debris, such small streams have none of it: take more.",
    )
    moves: Literal["surrogate", "de", "stretch"] = Field(
        default="surrogate",
        description="Exchange with a learned surrogate of the posterior, differential evolution, or the stretch move.",
    )


class Likelihood(BaseModel):
    """Settings of the comparison with the data."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    noise: Literal["add", "ignore"] = Field(
        default="ignore",
        description="Whether the variance of the model's own estimate is added to that of the data.",
    )
