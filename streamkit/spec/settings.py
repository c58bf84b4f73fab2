"""What a run file holds besides components: its keys and sections, how to sample, how to compare."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

VERSION = 1
"""The version of the run file that this streamkit writes and reads."""


class RunFile(BaseModel):
    """The keys and sections of a run file. What a section holds depends on the components installed."""

    model_config = ConfigDict(strict=True, extra="forbid")

    version: int = Field(default=VERSION, ge=1, le=VERSION, description="Version of the run file's format.")
    seed: int = Field(default=0, ge=0, description="Seed of every random draw.")
    plugins: list[str] = Field(default=[], description="One-off plugin files, by paths relative to the run file.")
    sun: dict[str, Any] = Field(default={}, description="The Sun, from which the progenitor was observed.")
    potential: dict[str, Any] = Field(description="The host: one, or several that add up, as [potential.NAME].")
    body: dict[str, Any] = Field(default={}, description="Galaxies that move beside the host, each as [body.NAME].")
    progenitor: dict[str, Any] = Field(
        default={}, description="Its own potential, its place today, and the look-back time."
    )
    stripping: dict[str, Any] = Field(
        default={}, description="When, where and how fast particles leave the progenitor."
    )
    integrator: dict[str, Any] = Field(default={}, description="How orbits are integrated.")
    observable: dict[str, Any] = Field(
        default={},
        description="What is measured of the stream, and the data: one, or several that add up, as [observable.NAME].",
    )
    data: dict[str, Any] = Field(
        default={}, description="Data that are no stream and speak of the host, each as [data.NAME]."
    )
    stream: dict[str, Any] = Field(
        default={},
        description="Several streams in one host: [stream.NAME.progenitor], [stream.NAME.stripping], "
        "[stream.NAME.observable], in place of the three sections above.",
    )
    likelihood: dict[str, Any] = Field(default={}, description="How the prediction is compared with the data.")
    sampler: dict[str, Any] = Field(default={}, description="How the posterior is sampled.")

    @field_validator("plugins")
    @classmethod
    def _each_once(cls, files: list[str]) -> list[str]:
        (name, count), *_ = Counter(Path(file).name for file in files).most_common(1) or [("", 0)]
        if count > 1:
            raise ValueError(f"found two files called {name!r}, expected one of each name")
        return files


class Sampler(BaseModel):
    """Settings of emcee."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    walkers: int = Field(default=32, ge=2, description="Number of walkers, at least twice the free parameters.")
    steps: int = Field(default=5000, ge=1, description="Longest chain, in steps per walker.")
    tau_factor: float = Field(
        default=50.0, gt=0, description="Stop when the chain is longer than so many autocorrelation times."
    )
    r_hat: float = Field(
        default=1.02,
        gt=1,
        description="Stop only when the rank-normalised R-hat of every parameter is below this.",
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
    call_limit: float = Field(
        default=3600.0,
        gt=0,
        description="Longest time of one call in seconds. A worker process is ended then; without workers it is only "
        "noticed when the call is over.",
    )
    over_limit: Literal["stop", "reject"] = Field(
        default="stop",
        description="What becomes of a longer call: the run stops, or it is a rejection, with this reason. Which calls "
        "are rejected then depends on the machine.",
    )


class Likelihood(BaseModel):
    """Settings of the comparison with the data."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    noise: Literal["add", "ignore"] = Field(
        default="ignore",
        description="Whether the variance of the model's own estimate is added to that of the data.",
    )
