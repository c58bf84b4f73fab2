"""One step of a chain as it is stored: all that the next step depends on, and the checksum of the chain up to it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from streamkit.errors import ChainError
from streamkit.stream import Array

MEMORY, HISTORY = "memory", "history"  # groups of arrays in a record, and in the chain file
# Arrays that runs of version 0.1.0 stored under keys of their own: name here, and key there.
FORMER = {MEMORY: ("replicas", "replicas"), HISTORY: ("trials", "tried")}


@dataclass(frozen=True, eq=False)
class Step:
    """The ensemble after a step, or before the first, as it is stored.

    Attributes
    ----------
    number
        Steps taken, this one included.
    coords, log_prob, blobs
        (walkers, d), (walkers,), and (walkers,) records of `streamkit.sample.blob_dtype`.
    accepted
        (walkers,) whether the step moved each walker.
    random_state, memory, history
        As those of `streamkit.Ensemble`.
    counts
        Calls and rejections up to the end of the step, and the sampler's facts.
    checksum
        That of all samples up to this step: `extend_checksum`.
    digest
        That of the run.
    """

    number: int
    coords: Array
    log_prob: Array
    blobs: Any
    accepted: Array
    random_state: Any
    counts: Mapping[str, Any] = field(default_factory=dict)
    memory: Mapping[str, Array] = field(default_factory=dict)
    history: Mapping[str, Array] = field(default_factory=dict)
    checksum: str = ""
    digest: str = ""

    def record(self) -> dict[str, Any]:
        """Return the step as a record of a journal."""
        about: dict[str, Any] = {
            "number": self.number,
            "counts": dict(self.counts),
            "checksum": self.checksum,
            "digest": self.digest,
        }
        arrays = {"coords": self.coords, "log_prob": self.log_prob, "accepted": self.accepted, "blobs": self.blobs}
        if isinstance(self.random_state, Mapping):
            about["random"] = self.random_state
        else:
            kind, arrays["keys"], *rest = self.random_state
            about["random"] = [kind, *(value.item() if isinstance(value, np.generic) else value for value in rest)]
        for kept, values in ((MEMORY, self.memory), (HISTORY, self.history)):
            arrays |= {f"{kept}/{name}": value for name, value in values.items()}
        return arrays | {"about": np.frombuffer(json.dumps(about, default=np.ndarray.tolist).encode(), dtype=np.uint8)}


def step_of(record: Mapping[str, Any]) -> Step:
    """Return the step of a record; ChainError if it is none."""
    try:
        about = json.loads(record["about"].tobytes())
        random = about["random"]
        if not isinstance(random, dict):
            kind, *rest = random
            random = (kind, record["keys"], *rest)
        return Step(
            about["number"],
            record["coords"],
            record["log_prob"],
            record["blobs"],
            record["accepted"],
            random,
            about["counts"],
            _named(record, MEMORY),
            _named(record, HISTORY),
            about["checksum"],
            about["digest"],
        )
    except (KeyError, ValueError, TypeError) as error:
        raise ChainError(f"a record of the journal is no step of a chain ({error})") from None


def _named(record: Mapping[str, Any], kept: str) -> dict[str, Array]:
    """Return the arrays of a record that are memory, or history, by name."""
    arrays = {name.partition("/")[2]: value for name, value in record.items() if name.startswith(f"{kept}/")}
    name, key = FORMER[kept]
    return arrays | ({name: record[key]} if key in record else {})


def checksum_of(*parts: Any) -> str:
    """Return the checksum of arrays and texts."""
    total = hashlib.blake2b(digest_size=16)
    for part in parts:
        total.update(part.encode() if isinstance(part, str) else np.ascontiguousarray(part).tobytes())
        total.update(b"|")
    return total.hexdigest()


def extend_checksum(before: str, coords: Array, log_prob: Array, blobs: Any) -> str:
    """Return the checksum of a chain that is continued by the samples of a step.

    Parameters
    ----------
    before
        The checksum of the chain without them; that of no sample at all is the digest of the run.
    coords, log_prob, blobs
        As in `Step`.
    """
    return checksum_of(before, coords, log_prob, *([] if blobs is None else [blobs]))
