"""One step of the ensemble: all that a run needs to go on from it, and the checksum of the chain up to it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import emcee
import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from streamkit.errors import ChainError, brief, printable
from streamkit.stream import Array

MOST = 10**15  # no run counts further: it keeps forged numbers out of arithmetic
Count = Annotated[int, Field(ge=0, le=MOST)]
Text = Annotated[str, AfterValidator(printable)]


class Counts(BaseModel):
    """Calls and rejections, as they are stored beside a chain."""

    model_config = ConfigDict(strict=True)

    calls: Count = 0
    search_calls: Count = 0
    reasons: dict[Text, Count] = {}
    surrogate: Text = ""


class _About(BaseModel):
    """What the record of a step holds beside its arrays."""

    model_config = ConfigDict(strict=True)

    number: Count
    counts: Counts
    random: tuple[str, int, int, float]
    checksum: str
    digest: str


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
        about = _About.model_validate_json(record["about"].tobytes())
        kind, *rest = about.random
        step = Step(
            about.number,
            record["coords"],
            record["log_prob"],
            record.get("blobs"),
            record["accepted"],
            (kind, record["keys"], *rest),
            about.counts.model_dump(),
            record.get("tried"),
            record.get("replicas"),
            about.checksum,
            about.digest,
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
    if step.blobs is not None and (step.blobs.shape != (walkers,) or step.blobs.dtype.names is None):
        raise ValueError("blobs holds no record for each walker")
    if step.tried is not None:
        check_array("tried", step.tried, (walkers, *step.tried.shape[1:2]), finite=False)
    if step.replicas is not None:
        check_array("replicas", step.replicas, (len(step.replicas), d))
    check_random_state(step.random_state)


def check_random_state(state: tuple[Any, ...]) -> None:
    """Check a state of numpy's Mersenne twister, ValueError if it is none: numpy itself looks at no number of it."""
    kind, keys, position, *rest = state
    keys = np.asarray(keys)
    is_state = kind == "MT19937" and keys.shape == (624,) and keys.dtype.kind in "ui" and 0 <= position <= len(keys)
    if not is_state or len(rest) != 2 or not np.isfinite(rest).all():
        raise ValueError("there is no state of a random generator")


def check_array(name: str, array: Array, shape: tuple[int, ...], finite: bool = True) -> None:
    """Check that an array is one of numbers, of this shape and not empty; ValueError if not."""
    if array.shape != shape or array.dtype != float or (finite and not np.isfinite(array).all()):
        raise ValueError(f"{name} is no array of numbers of shape {shape}")


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
