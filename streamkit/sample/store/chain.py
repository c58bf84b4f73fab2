"""The chain of a run on the disk: ``chain.h5``, and the latest steps in the journal."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from streamkit.errors import ChainError
from streamkit.report import DamagedError, read_own
from streamkit.sample.store.journal import journal_of
from streamkit.sample.store.step import (
    FORMER,
    MEMORY,
    MOST,
    Count,
    Counts,
    Step,
    check_array,
    check_numbers,
    check_random_state,
    check_records,
    extend_checksum,
    step_of,
)  # fmt: skip
from streamkit.stream import Array

CHAIN = "chain.h5"
GROUP = "mcmc"
RANDOM = "random_state"  # attribute: the state of a `numpy.random.Generator`; emcee's format only has a RandomState's
RESTORE = "Restore it from a copy, or start again with --force."


@dataclass(frozen=True, eq=False)
class Chain:
    """The content of a chain file and of the journal beside it."""

    chain: Array  # (steps, walkers, d) samples
    log_prob: Array  # (steps, walkers) ln posterior
    blobs: Any  # (steps, walkers) records of `streamkit.sample.blob_dtype`
    accepted: Array  # (walkers,) accepted moves
    attributes: dict[str, Any]  # attributes of the run: digest, quick, status, counts
    random_state: Any = None  # the generator's state after the last step; None without a step
    memory: Mapping[str, Array] = field(default_factory=dict)  # arrays by name, of the last step
    journal: list[Step] = field(default_factory=list)  # the last steps, which only the journal has
    start: Step | None = None  # the ensemble before the first step, if the journal has it
    checksum: str = ""  # the checksum of all samples
    lacks_journal: bool = False  # whether the journal that follows the file is missing or empty
    torn: int = 0  # bytes at the end of the journal that are a part of the step after the last: `Journal.torn`


def read_chain_file(path: Path) -> Chain:
    """Read a chain file and its journal, those of a running run too.

    Raises ChainError if there is neither, if one is truncated or no chain, or if it was changed after it was written.
    """
    journal = journal_of(path)
    steps = [step_of(record) for record in journal.read()]  # first: it may be cleared
    if not path.exists() and not steps:
        raise ChainError(f"{path}: there is no chain file: the run did not get as far as its first step")
    try:
        stored = read_own(path, partial(_read, path))
    except DamagedError as error:
        if not steps or steps[0].number > 1:
            raise damaged(path, str(error)) from None
        stored = _nothing(steps[0])
    lacks_journal = not steps and not journal.torn and bool(stored.attributes.get("goes_on"))
    return replace(_continued(stored, steps, path), torn=journal.torn, lacks_journal=lacks_journal)


def _nothing(first: Step) -> Chain:
    """Return the chain without any step, for an ensemble of this form."""
    walkers, d = first.coords.shape
    blobs = np.empty((0, walkers), dtype=first.blobs.dtype)
    attributes = {"digest": first.digest} if first.digest else {}
    return Chain(
        np.empty((0, walkers, d)), np.empty((0, walkers)), blobs, np.zeros(walkers), attributes, checksum=first.digest
    )


def _continued(stored: Chain, steps: list[Step], path: Path) -> Chain:
    """Return the chain continued by the steps of the journal that it does not hold yet."""
    done, checksum = len(stored.chain), stored.checksum
    tail: list[Step] = []
    start = steps[0] if steps and steps[0].number == 0 and done == 0 else None
    for step in steps:
        if step.number <= done:
            continue
        _check_form(stored, tail[0] if tail else step, step, path)
        checksum = extend_checksum(checksum, step.coords, step.log_prob, step.blobs)
        if step.number != done + len(tail) + 1 or step.checksum != checksum:
            raise ChainError(
                f"{journal_of(path).path}: does not continue {path.name}, of {done} steps: one of them belongs to "
                f"another run. {RESTORE}"
            )
        tail.append(step)
    if not tail:
        if start is None:
            return stored
        attributes = stored.attributes | {"counts": dict(start.counts)}
        return Chain(stored.chain, stored.log_prob, stored.blobs, stored.accepted, attributes,
                     start=start, checksum=checksum)  # fmt: skip
    last, blobs = tail[-1], np.array([step.blobs for step in tail])
    return Chain(
        np.concatenate([stored.chain, [step.coords for step in tail]]),
        np.concatenate([stored.log_prob, [step.log_prob for step in tail]]),
        np.concatenate([stored.blobs, blobs]) if done else blobs,
        stored.accepted + np.sum([step.accepted for step in tail], axis=0),
        stored.attributes | {"counts": dict(last.counts)},
        last.random_state,
        last.memory,
        tail,
        checksum=checksum,
    )


def _check_form(stored: Chain, first: Step, step: Step, path: Path) -> None:
    """Check that a step has the walkers, parameters and records of the chain, and of the journal's first step."""
    same = step.coords.shape == stored.chain.shape[1:] and step.blobs.dtype == first.blobs.dtype
    if len(stored.chain):
        same = same and step.blobs.dtype == stored.blobs.dtype
    if not same:
        raise ChainError(
            f"{journal_of(path).path}: does not continue {path.name}: step {step.number} has other walkers, parameters "
            f"or records. {RESTORE}"
        )


class _Attributes(BaseModel):
    """The attributes of a chain file that are used; others are ignored."""

    model_config = ConfigDict(strict=True)

    digest: str = ""
    checksum: str = ""
    quick: bool = False
    status: Literal["converged", "few", "steps", "time", "unfinished"] = "unfinished"
    since: float = Field(default=0.0, ge=0, le=MOST)
    first: Count = 0
    deadline: float = Field(default=0.0, ge=0, le=MOST)
    goes_on: bool = False
    counts: Counts = Counts()


def _read(path: Path, file: h5py.File) -> Chain:
    """Read the chain file alone."""
    group = file[GROUP]
    steps = int(group.attrs["iteration"])
    attributes = {key: _plain(value) for key, value in file.attrs.items()}
    chain, log_prob, accepted = group["chain"][:steps], group["log_prob"][:steps], group["accepted"][...]
    blobs = group["blobs"][:steps] if "blobs" in group else np.empty((0, len(accepted)))
    if len(chain) != steps or len(log_prob) != steps:
        raise ValueError(f"{steps} steps announced, {len(chain)} found")
    checked = _Attributes.model_validate(attributes)
    if "counts" in attributes:
        attributes["counts"] = checked.counts.model_dump(exclude_defaults=True)
    random = [value for key, value in sorted(group.attrs.items()) if key.startswith("random_state_")]
    memory = {FORMER: file[FORMER][...]} if FORMER in file else {}
    memory |= {name: file[MEMORY][name][...] for name in file.get(MEMORY, ())}
    check_numbers(memory)
    _check_shapes(chain, log_prob, accepted, blobs)
    random_state = attributes.pop(RANDOM, None) or tuple(random) or None
    if steps or random_state is not None:
        check_random_state(random_state)
    if not (np.isfinite(chain).all() and np.isfinite(log_prob).all()):
        raise damaged(path, "it holds samples that are no numbers")
    checksum = attributes.get("digest", "")
    for row in range(steps):
        checksum = extend_checksum(checksum, chain[row], log_prob[row], blobs[row])
    if checked.checksum != checksum:
        raise damaged(path, "its samples have another checksum")
    return Chain(chain, log_prob, blobs, accepted, attributes, random_state, memory, checksum=checksum)


def _check_shapes(chain: Array, log_prob: Array, accepted: Array, blobs: Any) -> None:
    """Check the arrays of a chain file against each other; ValueError if one has another shape, or holds no numbers."""
    steps, walkers, d = chain.shape
    if not (walkers and d):
        raise ValueError(f"chain has {walkers} walkers of {d} parameters")
    check_array("chain", chain, (steps, walkers, d), finite=False)  # reported below, with the path of the file
    check_array("log_prob", log_prob, (steps, walkers), finite=False)
    check_array("accepted", accepted, (walkers,))
    if (accepted < 0).any() or (accepted > steps).any():
        raise ValueError(f"accepted holds other numbers than 0 to {steps}")
    if steps:
        check_records(blobs, (steps, walkers))


def damaged(path: Path, what: str) -> ChainError:
    """Return the error for a chain file that was damaged or changed."""
    return ChainError(
        f"{path}: was damaged or changed after it was written: {what}. The steps in it are lost without a copy. "
        f"{RESTORE}"
    )


def _plain(value: Any) -> Any:
    """Turn an HDF5 attribute into a plain Python value."""
    if isinstance(value, str) and value[:1] in ("{", "["):
        return json.loads(value)
    return value.item() if isinstance(value, np.generic) else value
