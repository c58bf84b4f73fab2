"""The parts of a run file that are no components: its keys, the likelihood, the engine."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

VERSION = 1  # the version of the run file that this streamkit writes and reads


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
        default={}, description="Data on the host without a stream, each as [data.NAME]."
    )
    stream: dict[str, Any] = Field(
        default={},
        description="Several streams in one host: [stream.NAME.progenitor], [stream.NAME.stripping], "
        "[stream.NAME.observable], in place of the three sections above. Above its sections a stream may have a frame "
        "and a table, for all of its sections that have these fields.",
    )
    streams: list[str] = Field(
        default=[],
        description="Files of one stream each, such as gd1.toml for the stream gd1: what would stand below "
        "[stream.NAME]. Their paths, and the paths in them, are relative to the run file.",
    )
    stream_defaults: dict[str, Any] = Field(
        default={},
        description="What several streams share, in sections as those of a stream. A stream's own value replaces a "
        "default; a default that the kind of a stream's section does not have is left out there.",
    )
    likelihood: dict[str, Any] = Field(default={}, description="How the prediction is compared with the data.")
    sampler: dict[str, Any] = Field(default={}, description="How the posterior is sampled.")
    engine: dict[str, Any] = Field(
        default={},
        description="Where the posterior is evaluated. The samples do not depend on it; options of the command "
        "line override it.",
    )

    @field_validator("plugins")
    @classmethod
    def _each_once(cls, files: list[str]) -> list[str]:
        (name, count), *_ = Counter(Path(file).name for file in files).most_common(1) or [("", 0)]
        if count > 1:
            raise ValueError(f"found two files called {name!r}, expected one of each name")
        return files


class Likelihood(BaseModel):
    """Settings of the comparison with the data."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    noise: Literal["add", "ignore"] = Field(
        default="ignore",
        description="Whether the variance of the model's own estimate is added to that of the data.",
    )


class Engine(BaseModel):
    """How a run evaluates the posterior: processes and machines. The digest of the run does not depend on it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    kind: Literal["processes", "serial", "mpi", "dask"] = Field(
        default="processes",
        description="Processes of this machine, the command's own alone, the ranks of an MPI job, or Dask's workers.",
    )
    workers: int = Field(
        default=1, ge=1, description="Processes, or Dask's workers on this machine. MPI has one for each other rank."
    )
    scheduler: str = Field(
        default="", description="Address of a running Dask scheduler, in place of workers on this machine."
    )

    @model_validator(mode="after")
    def _of_dask(self) -> Self:
        if self.scheduler and self.kind != "dask":
            raise ValueError(f'a scheduler belongs to kind = "dask"; found kind = "{self.kind}"')
        return self
