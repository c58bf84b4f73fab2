"""Weighted samples of a run, their file ``samples.h5``, and samples of equal weight drawn from them."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import h5py
import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from streamkit.components import Verdict
from streamkit.errors import ChainError, ComponentError, brief
from streamkit.report import BLOCK, DamagedError, read_own, write_own
from streamkit.sample.store.step import Count, Counts, Text, as_floats, check_array, check_records
from streamkit.stream import Array

SAMPLES = "samples.h5"
ARRAYS = "points", "ln_weights", "log_prob", "blobs"
ENOUGH = 400  # effective samples of a converged run (Vehtari+ 2021, sec. 4)


@dataclass(frozen=True, eq=False)
class Weighted:
    """Weighted samples of the posterior with their evaluations."""

    # (n, d) parameters, and (n,) natural logs of the weights up to a constant.
    points: Array
    ln_weights: Array
    # (n,) ln posterior, and (n,) records of `streamkit.sample.blob_dtype`.
    log_prob: Array
    blobs: Any
    ln_evidence: float  # NaN, as its error, if unknown
    ln_evidence_error: float
    missing: str  # the missing part of the sampler's stopping rule; empty when the rule is met
    attributes: dict[str, Any]  # attributes of the run: digest, quick, status, counts
    verdicts: tuple[Verdict, ...] = ()  # the results of the sampler's checks

    @cached_property
    def weights(self) -> Array:
        """(n,) Weights whose sum is 1."""
        weights = np.exp(self.ln_weights - np.max(self.ln_weights))
        return np.asarray(weights / weights.sum())

    @property
    def ess(self) -> float:
        """The effective number of samples, 1 / sum of squared weights (Kish 1965)."""
        return float(1 / np.sum(self.weights**2))

    @property
    def lacks(self) -> str:
        """What is missing for converged samples, as the end of a sentence; empty if nothing is."""
        few = f"{self.ess:.0f} effective samples, and {ENOUGH} are wanted"
        return self.missing or ("" if self.ess >= ENOUGH else few)

    def drawn(self, seed: int) -> Array:
        """(k,) Indices of samples of equal weight, as many as the effective number, by systematic resampling.

        They are in a random order: samples come in that of their likelihood.
        """
        rng = np.random.default_rng([seed, 2])
        k = max(round(self.ess), 1)
        steps = np.cumsum(self.weights)
        return rng.permutation(np.searchsorted(steps / steps[-1], (np.arange(k) + rng.random()) / k))

    def checked(self) -> Weighted:
        """Return the samples as a file returns them: numbers as floats, texts without control characters.

        Raises ComponentError if the file cannot hold them: with what was found and what is allowed.
        """
        try:
            floats = {name: as_floats(name, getattr(self, name)) for name in ARRAYS if name != "blobs"}
            return _weighted({**floats, "blobs": self.blobs}, self._notes())
        except (ValueError, TypeError, AttributeError) as error:
            raise ComponentError(f"samples cannot be stored: {brief(error)}") from None

    def _notes(self) -> dict[str, Any]:
        """Return all that is not an array, for the attributes of the file."""
        return self.attributes | {
            "ln_evidence": self.ln_evidence,
            "ln_evidence_error": self.ln_evidence_error,
            "missing": self.missing,
            "verdicts": [asdict(verdict) for verdict in self.verdicts],
        }

    def write(self, path: Path) -> None:
        """Write the file as a whole.

        ChainError if it cannot be written; ComponentError if the samples cannot be stored: see `checked`.
        """
        samples, content = self.checked(), io.BytesIO()
        with h5py.File(content, "w", userblock_size=BLOCK) as file:
            for name in ARRAYS:
                file[name] = getattr(samples, name)
            for key, value in samples._notes().items():
                file.attrs[key] = json.dumps(value) if isinstance(value, dict | list) else value
        write_own(path, content.getvalue())


# A number of numpy too.
Number = Annotated[float, BeforeValidator(lambda value: value.item() if isinstance(value, np.generic) else value)]


Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Verdict(BaseModel):
    """A `Verdict` whose texts may come from elsewhere."""

    model_config = ConfigDict(strict=True)

    subject: Text
    level: Literal["fine", "look here", "do not use"]
    value: Text
    sentence: Text
    rule: Text


class Stage(BaseModel):
    """The answer after some of the calls: median and ends of the 68 % interval of each quantity of the history."""

    model_config = ConfigDict(strict=True)

    calls: Count
    small_calls: Count = 0  # with few particles
    level: Literal["fine", "look here", "do not use"]  # the worst of the sampler's own checks
    intervals: list[Annotated[list[Finite], Field(min_length=3, max_length=3)]]  # (q, 3) low end, median, high end


class History(BaseModel):
    """The answer against the number of calls."""

    model_config = ConfigDict(strict=True)

    names: list[Text]  # (q,) the quantities: the parameters, and a mass
    stages: list[Stage]

    @model_validator(mode="after")
    def _same_quantities(self) -> History:
        if any(len(stage.intervals) != len(self.names) for stage in self.stages):
            raise ValueError("a stage has not as many intervals as there are names")
        return self


class _Notes(BaseModel):
    """The attributes of the file that are used; others are ignored."""

    model_config = ConfigDict(strict=True)

    digest: Text = ""
    quick: bool = False
    status: Literal["converged", "few", "steps", "time", "unfinished"] = "unfinished"
    counts: Counts = Counts()
    ln_evidence: Number
    ln_evidence_error: Number
    missing: Text
    verdicts: list[_Verdict] = []
    history: History | None = None


def read_weighted(path: Path) -> Weighted:
    """Read the file. ChainError if there is none, or it is not readable, or was changed."""
    if not path.exists():
        raise ChainError(f"{path}: there is no file of samples: the run did not get as far as its first ones")
    try:
        return read_own(path, _read)
    except DamagedError as error:
        raise ChainError(f"{path}: was damaged or changed after it was written: {error}") from None


def _read(file: h5py.File) -> Weighted:
    if lost := [name for name in ARRAYS if not isinstance(file.get(name), h5py.Dataset)]:
        raise ValueError(f"{lost[0]} is missing")
    notes = {key: value.item() if isinstance(value, np.generic) else value for key, value in file.attrs.items()}
    for name in ("counts", "verdicts", "history"):
        if name in notes:
            notes[name] = json.loads(notes[name])
    return _weighted({name: file[name][...] for name in ARRAYS}, notes)


def _weighted(arrays: Mapping[str, Any], notes: Mapping[str, Any]) -> Weighted:
    """Return samples after a check of their arrays and notes; an error of Python's if one is wrong."""
    points, ln_weights, log_prob, blobs = (arrays[name] for name in ARRAYS)
    _check_shapes(points, ln_weights, log_prob, blobs)
    known = _Notes.model_validate(notes)
    attributes: dict[str, Any] = {key: getattr(known, key) for key in ("digest", "quick", "status") if key in notes}
    if "counts" in notes:
        attributes["counts"] = known.counts.model_dump(exclude_defaults=True)
    if known.history is not None:
        attributes["history"] = known.history.model_dump()
    verdicts = tuple(Verdict(**each.model_dump()) for each in known.verdicts)
    return Weighted(points, ln_weights, log_prob, blobs, float(known.ln_evidence), float(known.ln_evidence_error),
                    known.missing, attributes, verdicts)  # fmt: skip


def _check_shapes(points: Array, ln_weights: Array, log_prob: Array, blobs: Any) -> None:
    """Check the arrays of a file of samples against each other; ValueError if one has another shape or no numbers."""
    n, d = points.shape
    check_array("points", points, (n, d))
    check_array("ln_weights", ln_weights, (n,))
    check_array("log_prob", log_prob, (n,), finite=False)  # -inf where a sample has no likelihood
    if not n or np.isnan(log_prob).any() or np.isposinf(log_prob).any():
        raise ValueError("log_prob holds no numbers, or NaN, or plus infinity")
    check_records(blobs, (n,))
