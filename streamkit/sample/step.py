"""One step of the ensemble: all that a run needs to go on from it, and the checksum of the chain up to it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import emcee
import numpy as np

from streamkit.errors import ChainError
from streamkit.stream import Array


@dataclass(frozen=True, eq=False)
class Step:
    """The ensemble after a step, or before the first.

    Attributes
    ----------
    number
        Steps taken, this one included.
    coords, log_prob, blobs
        (walkers, d), (walkers,), and (walkers,) records of `streamkit.posterior.blob_dtype`.
    accepted
        (walkers,) whether the step moved each walker.
    random_state
        That of the generator after the step, as `numpy.random.RandomState.get_state` gives it.
    counts
        Calls and rejections up to the end of the step.
    tried
        (walkers, k) what the moves learn from in this step, or None.
    replicas
        (k, d) the replicas of the surrogate after the step, or None.
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
    random_state: tuple[Any, ...]
    counts: Mapping[str, Any] = field(default_factory=dict)
    tried: Array | None = None
    replicas: Array | None = None
    checksum: str = ""
    digest: str = ""

    @property
    def state(self) -> emcee.State:
        """The ensemble as emcee has it."""
        return emcee.State(
            self.coords, log_prob=self.log_prob, blobs=self.blobs, random_state=self.random_state, copy=True
        )

    def record(self) -> dict[str, Array]:
        """Return the step as arrays."""
        kind, keys, *rest = self.random_state
        about = {
            "number": self.number,
            "counts": dict(self.counts),
            "random": [kind, *(value.item() if isinstance(value, np.generic) else value for value in rest)],
            "checksum": self.checksum,
            "digest": self.digest,
        }
        arrays = {"tried": self.tried, "replicas": self.replicas, "blobs": self.blobs}
        return {
            "about": np.frombuffer(json.dumps(about).encode(), dtype=np.uint8),
            "coords": self.coords,
            "log_prob": self.log_prob,
            "accepted": self.accepted,
            "keys": keys,
        } | {name: value for name, value in arrays.items() if value is not None}


def step_of(record: Mapping[str, Any]) -> Step:
    """Return the step of a record; ChainError if it is none."""
    try:
        about = json.loads(record["about"].tobytes())
        kind, *rest = about["random"]
        return Step(
            about["number"],
            record["coords"],
            record["log_prob"],
            record.get("blobs"),
            record["accepted"],
            (kind, record["keys"], *rest),
            about["counts"],
            record.get("tried"),
            record.get("replicas"),
            about["checksum"],
            about["digest"],
        )
    except (KeyError, ValueError, TypeError) as error:
        raise ChainError(f"a record of the journal is no step of a chain ({error})") from None


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
