"""One step of a chain as it is stored: all that the next step depends on, and the checksum of the chain up to it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from streamkit.errors import ChainError, brief, printable
from streamkit.stream import Array

MEMORY, HISTORY = "memory", "history"  # groups of arrays in a record, and in the chain file
# Arrays that runs of version 0.1.0 stored under keys of their own: name here, and key there.
FORMER = {MEMORY: ("replicas", "replicas"), HISTORY: ("trials", "tried")}
MOST = 10**15  # upper limit of counts in a file, so that forged numbers cannot overflow
Count = Annotated[int, Field(ge=0, le=MOST)]
Text = Annotated[str, AfterValidator(printable)]


class Counts(BaseModel):
    """Calls, rejections and facts, as they are stored beside a chain; ``surrogate`` is a fact of version 0.1.0."""

    model_config = ConfigDict(strict=True)

    calls: Count = 0
    search_calls: Count = 0
    reasons: dict[Text, Count] = {}
    facts: dict[Text, Text] = {}
    surrogate: Text = ""


class _Entries(BaseModel):
    """The entries of a step's record beside its arrays."""

    model_config = ConfigDict(strict=True)

    number: Count
    counts: Counts
    random: tuple[str, int, int, float] | dict[str, Any]
    checksum: str
    digest: str


@dataclass(frozen=True, eq=False)
class Step:
    """The ensemble after a step, or before the first, as it is stored."""

    number: int  # steps taken, this one included
    # (walkers, d), (walkers,), and (walkers,) records of `streamkit.sample.blob_dtype`.
    coords: Array
    log_prob: Array
    blobs: Any
    accepted: Array  # (walkers,) whether the step moved each walker
    random_state: Any  # this, memory and history: as in `streamkit.Ensemble`
    # Calls and rejections up to the end of the step, and the sampler's facts.
    counts: Mapping[str, Any] = field(default_factory=dict)
    memory: Mapping[str, Array] = field(default_factory=dict)
    history: Mapping[str, Array] = field(default_factory=dict)
    checksum: str = ""  # that of all samples up to this step: `extend_checksum`
    digest: str = ""  # that of the run

    def record(self) -> dict[str, Any]:
        """Return the step as a record of a journal."""
        entries: dict[str, Any] = {
            "number": self.number,
            "counts": dict(self.counts),
            "checksum": self.checksum,
            "digest": self.digest,
        }
        arrays = {"coords": self.coords, "log_prob": self.log_prob, "accepted": self.accepted, "blobs": self.blobs}
        if isinstance(self.random_state, Mapping):
            entries["random"] = self.random_state
        else:
            kind, arrays["keys"], *rest = self.random_state
            entries["random"] = [kind, *(value.item() if isinstance(value, np.generic) else value for value in rest)]
        for group, values in ((MEMORY, self.memory), (HISTORY, self.history)):
            arrays |= {f"{group}/{name}": value for name, value in values.items()}
        text = json.dumps(entries, default=np.ndarray.tolist)
        return arrays | {"about": np.frombuffer(text.encode(), dtype=np.uint8)}


def step_of(record: Mapping[str, Any]) -> Step:
    """Return the step of a record; ChainError if it is none."""
    try:
        entries = _Entries.model_validate_json(record["about"].tobytes())
        random: Any = entries.random
        if not isinstance(random, dict):
            kind, *rest = random
            random = (kind, record["keys"], *rest)
        step = Step(
            entries.number,
            record["coords"],
            record["log_prob"],
            record["blobs"],
            record["accepted"],
            random,
            entries.counts.model_dump(exclude_defaults=True),
            _named(record, MEMORY),
            _named(record, HISTORY),
            entries.checksum,
            entries.digest,
        )
        _check_arrays(step)
    except (KeyError, ValueError, TypeError) as error:
        raise ChainError(f"a record of the journal is no step of a chain ({brief(error)})") from None
    return step


def _check_arrays(step: Step) -> None:
    """Check the shapes and types of a step's arrays, and its random state; ValueError or TypeError if one is wrong."""
    walkers, d = step.coords.shape
    check_array("coords", step.coords, (walkers, d))
    check_array("log_prob", step.log_prob, (walkers,))
    if step.accepted.shape != (walkers,) or step.accepted.dtype != bool:
        raise ValueError("accepted holds no truth value for each walker")
    if step.blobs.shape != (walkers,) or step.blobs.dtype.names is None:
        raise ValueError("blobs holds no record for each walker")
    for arrays in (step.memory, step.history):
        for name, values in arrays.items():
            check_array(name, values, values.shape, finite=False)
    check_random_state(step.random_state)


def check_random_state(state: Any) -> None:
    """Check a state of numpy's Mersenne twister; ValueError if it is none. Numpy does not check its numbers.

    The states of other generators are mappings, which numpy checks.
    """
    if isinstance(state, Mapping):
        return
    kind, keys, position, *rest = state
    keys = np.asarray(keys)
    is_state = kind == "MT19937" and keys.shape == (624,) and keys.dtype.kind in "ui" and 0 <= position <= len(keys)
    if not is_state or len(rest) != 2 or not np.isfinite(rest).all():
        raise ValueError("there is no state of a random generator")


def check_array(name: str, array: Array, shape: tuple[int, ...], finite: bool = True) -> None:
    """Check that an array is one of numbers, of this shape and not empty; ValueError if not."""
    if array.shape != shape or array.dtype != float or (finite and not np.isfinite(array).all()):
        raise ValueError(f"{name} is no array of numbers of shape {shape}")


def _named(record: Mapping[str, Any], group: str) -> dict[str, Array]:
    """Return the arrays of a record that are memory, or history, by name."""
    arrays = {name.partition("/")[2]: value for name, value in record.items() if name.startswith(f"{group}/")}
    name, key = FORMER[group]
    return arrays | ({name: record[key]} if key in record else {})


def checksum_of(*parts: Any) -> str:
    """Return the checksum of arrays and texts."""
    total = hashlib.blake2b(digest_size=16)
    for part in parts:
        total.update(part.encode() if isinstance(part, str) else np.ascontiguousarray(part).tobytes())
        total.update(b"|")
    return total.hexdigest()


def extend_checksum(before: str, coords: Array, log_prob: Array, blobs: Any) -> str:
    """Return the checksum of a chain that is continued by the samples of a step, as in `Step`.

    ``before`` is the checksum of the chain without them; that of no sample at all is the digest of the run.
    """
    return checksum_of(before, coords, log_prob, *([] if blobs is None else [blobs]))
