"""One stored step of a chain: all data that the next step depends on, and the checksum of the chain up to the step.

The same rules check a step before it is written and when it is read: `Step.checked`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from streamkit.errors import ChainError, ComponentError, brief, printable
from streamkit.sample.evaluation import blob_dtype
from streamkit.stream import Array, BoolArray

MEMORY = "memory"  # group of arrays in a record, and in the chain file
FORMER = "replicas"  # the array of the memory that runs of version 0.1.0 stored outside this group
MOST = 10**15  # upper limit of counts in a file, so that forged numbers cannot overflow
Count = Annotated[int, Field(ge=0, le=MOST)]


def _in_one_line(text: Any) -> Any:
    """Return a text without control characters: a terminal obeys these, and in LaTeX a new line ends a comment."""
    return printable(text.replace("\n", " ")) if isinstance(text, str) else text


Text = Annotated[str, BeforeValidator(_in_one_line)]  # of a file that may come from elsewhere
NUMBERS = "biuf"  # kinds of arrays in memory: truth values, integers, floating-point numbers
WIDEST = 8  # bytes of such a number: HDF5 has no portable form of a longer one
TWISTER_WORDS = 624
BUFFERED = 4  # numbers that numpy's generator Philox draws at a time


def _plain_facts(facts: Any) -> Any:
    """Return a mapping of any kind as a dictionary, which is what strict validation takes."""
    return dict(facts) if isinstance(facts, Mapping) else facts


class Counts(BaseModel):
    """Calls, rejections and facts, as they are stored beside a chain; ``surrogate`` is a fact of version 0.1.0."""

    model_config = ConfigDict(strict=True)

    calls: Count = 0
    search_calls: Count = 0
    reasons: dict[Text, Count] = {}
    facts: Annotated[dict[Text, Text], BeforeValidator(_plain_facts)] = {}
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
    accepted: BoolArray  # (walkers,) whether the step moved each walker
    random_state: Any  # this and memory: as in `streamkit.Ensemble`
    # Calls and rejections up to the end of the step, and the sampler's facts.
    counts: Mapping[str, Any] = field(default_factory=dict)
    memory: Mapping[str, Array] = field(default_factory=dict)
    checksum: str = ""  # the checksum of all samples up to this step: `extend_checksum`
    digest: str = ""  # the digest of the run

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
        arrays |= {f"{MEMORY}/{name}": value for name, value in self.memory.items()}
        text = json.dumps(entries, default=_plain, ensure_ascii=False)
        return arrays | {"about": np.frombuffer(text.encode(errors="replace"), dtype=np.uint8)}

    def checked(self) -> Step:
        """Return a copy of the step as a file gives it back: numbers as floats, texts without control characters.

        Arrays in ``memory`` keep their types. Raises ComponentError if a file cannot hold the step: with what was
        found and what is allowed.
        """
        try:
            _check_names(self.memory)
            check_random_state(self.random_state)
            step = replace(
                self,
                coords=as_floats("the points", self.coords),
                log_prob=as_floats("ln p", self.log_prob),
                accepted=_as_truth(self.accepted),
                memory={name: _native(value) for name, value in self.memory.items()},
            )
            return _step_of(step.record())
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise ComponentError(f"a step cannot be stored: {brief(error)}") from None


def _plain(value: Any) -> Any:
    """Return arrays, numbers of numpy and mappings as JSON has them; TypeError for anything else."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"found {value!r}, expected numbers, texts, lists and mappings")


def step_of(record: Mapping[str, Any]) -> Step:
    """Return the step of a record; ChainError if it is none."""
    try:
        return _step_of(record)
    except (KeyError, ValueError, TypeError) as error:
        raise ChainError(f"a record of the journal is no step of a chain ({brief(error)})") from None


def _step_of(record: Mapping[str, Any]) -> Step:
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
        _memory(record),
        entries.checksum,
        entries.digest,
    )
    _check_arrays(step)
    return step


def _check_arrays(step: Step) -> None:
    """Check the shapes and types of a step's arrays, and its random state; ValueError or TypeError if one is wrong."""
    walkers, d = step.coords.shape
    check_array("coords", step.coords, (walkers, d))
    check_array("log_prob", step.log_prob, (walkers,))
    if step.accepted.shape != (walkers,) or step.accepted.dtype != bool:
        raise ValueError("accepted holds no truth value for each walker")
    check_records(step.blobs, (walkers,))
    check_numbers(step.memory)
    check_random_state(step.random_state)


def check_random_state(state: Any) -> None:
    """Check the state of a generator of numpy; ValueError if it is none. A mapping of another library passes.

    Numpy does not check the positions in its states, and would read memory that is not its own.
    """
    try:
        if isinstance(state, Mapping):
            known = _check_generator(state)
        else:
            kind, keys, position, *rest = state
            known = kind == "MT19937" and len(rest) == 2 and bool(np.isfinite(rest).all())
            known = known and _is_twister(keys, position)
    except (KeyError, IndexError, TypeError, ValueError, OverflowError, AttributeError):
        known = False
    if not known:
        raise ValueError("random_state is neither that of a numpy.random.RandomState nor of a Generator")


def _check_generator(state: Mapping[str, Any]) -> bool:
    """Return whether a mapping is a state of the generator that it names; any error of numpy if it is none."""
    name = state["bit_generator"]
    cls = getattr(np.random, name, None)
    if not (isinstance(cls, type) and issubclass(cls, np.random.BitGenerator)):
        return isinstance(name, str)
    cls(0).state = dict(state)
    if name == "MT19937":
        return _is_twister(state["state"]["key"], state["state"]["pos"])
    return name != "Philox" or bool(0 <= state["buffer_pos"] <= BUFFERED)


def _is_twister(keys: Any, position: Any) -> bool:
    keys = np.asarray(keys)
    is_whole = isinstance(position, int | np.integer) and 0 <= int(position) <= TWISTER_WORDS
    return is_whole and keys.shape == (TWISTER_WORDS,) and keys.dtype.kind in "ui"


def check_array(name: str, array: Array, shape: tuple[int, ...], finite: bool = True) -> None:
    """Check that an array is one of floats, of this shape; ValueError if not."""
    if array.shape != shape or array.dtype != float:
        raise ValueError(f"{name} is no array of floats of shape {shape}: found {array.dtype} of shape {array.shape}")
    if finite and not np.isfinite(array).all():
        raise ValueError(f"{name} holds NaN or infinite numbers")


def check_records(records: Any, shape: tuple[int, ...]) -> None:
    """Check an array of records of `streamkit.sample.blob_dtype`; ValueError if it is none, or of another shape."""
    names = records.dtype.names or ()
    if records.shape != shape or "mean" not in names or records.dtype != blob_dtype(*records.dtype["mean"].shape):
        raise ValueError("blobs holds no record of a prediction for each sample")
    if (records["variance"] < 0).any():
        raise ValueError("blobs holds a negative variance")


def check_numbers(arrays: Mapping[str, Array]) -> None:
    """Check the types of arrays in memory; ValueError with the name of a wrong one."""
    for name, array in arrays.items():
        if array.dtype.kind not in NUMBERS or array.dtype.itemsize > WIDEST:
            raise ValueError(
                f"{MEMORY} {name!r}: found the type {array.dtype}, expected floats, integers or truth values of at "
                "most 64 bits"
            )


def _check_names(arrays: Any) -> None:
    """Check the names of arrays in memory, which are the names of data sets of HDF5."""
    if not isinstance(arrays, Mapping):
        raise TypeError(f"{MEMORY}: found {arrays!r:.80}, expected arrays by name")
    for name in arrays:
        if not isinstance(name, str) or not name.strip(".") or "/" in name or not name.isprintable():
            raise ValueError(f"found the name {name!r} of an array, expected a word without a slash")


def as_floats(name: str, values: Any) -> Array:
    """Return a copy of real numbers as an array of floats; ValueError for any other type."""
    array = np.asarray(values)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{name}: found the type {array.dtype}, expected floats")
    return np.array(array, dtype=float, order="C")


def _native(values: Any) -> Array:
    """Return a copy of an array in this machine's order of bytes."""
    array = np.asarray(values)
    return array.astype(array.dtype.newbyteorder("="))


def _as_truth(values: Any) -> BoolArray:
    array = np.asarray(values)
    if not (np.equal(array, 0) | np.equal(array, 1)).all():
        raise ValueError("accepted: found other values than True and False")
    return array.astype(bool)


def _memory(record: Mapping[str, Any]) -> dict[str, Array]:
    """Return the arrays of a record that are memory, by name; those of other groups, of former versions, are left."""
    arrays = {name.partition("/")[2]: value for name, value in record.items() if name.startswith(f"{MEMORY}/")}
    return arrays | ({FORMER: record[FORMER]} if FORMER in record else {})


def checksum_of(*parts: Any) -> str:
    """Return the checksum of arrays and texts."""
    total = hashlib.blake2b(digest_size=16)
    for part in parts:
        total.update(part.encode() if isinstance(part, str) else np.ascontiguousarray(part).tobytes())
        total.update(b"|")
    return total.hexdigest()


def extend_checksum(before: str, coords: Array, log_prob: Array, blobs: Any) -> str:
    """Return the checksum of a chain that is continued by the samples of a step, as in `Step`.

    ``before`` is the checksum of the chain without the step; the checksum of an empty chain is the digest of the run.
    """
    return checksum_of(before, coords, log_prob, *([] if blobs is None else [blobs]))
