"""The chain file ``chain.h5``: emcee's HDF5 backend, what streamkit adds to it, and reading it with care."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from time import sleep
from types import EllipsisType
from typing import Any

import h5py
import numpy as np
from emcee.backends import HDFBackend

from streamkit.errors import ChainError
from streamkit.stream import Array

CHAIN = "chain.h5"
GROUP = "mcmc"


class ChainFile(HDFBackend):  # type: ignore[misc]  # emcee has no types
    """emcee's backend, which opens and closes the file at every step, so that a killed run leaves it whole.

    Without HDF5's file lock: a `streamkit report` of a run that is still going must not stop it. Two runs are
    kept apart by a lock on the directory.
    """

    def open(self, mode: str = "r") -> h5py.File:
        """Open the file."""
        return h5py.File(self.filename, mode, locking=False)

    def note(self, **attributes: Any) -> None:
        """Store attributes beside the chain: mappings and lists as JSON."""
        with self.open("a") as file:
            for key, value in attributes.items():
                file.attrs[key] = json.dumps(value) if isinstance(value, dict | list) else value

    def put(self, name: str, shape: tuple[int, ...], index: int | EllipsisType, row: Array) -> None:
        """Store a row, or all (...), of an array of this shape, which is NaN where nothing was stored."""
        with self.open("a") as file:
            if name not in file:
                file.create_dataset(name, shape, dtype=float, fillvalue=np.nan)
            file[name][index] = row

    def get(self, name: str) -> Array | None:
        """Return the array of `put`; None if there is none."""
        with self.open() as file:
            return np.asarray(file[name][...]) if name in file else None


@dataclass(frozen=True)
class Chain:
    """What a chain file holds.

    Attributes
    ----------
    chain
        (steps, walkers, d) samples.
    log_prob
        (steps, walkers) ln posterior.
    blobs
        (steps, walkers) records of `streamkit.posterior.blob_dtype`.
    accepted
        (walkers,) accepted moves.
    attributes
        What the run noted: digest, quick, status, calls, reasons.
    """

    chain: Array
    log_prob: Array
    blobs: Any
    accepted: Array
    attributes: dict[str, Any]


def read_chain_file(path: Path) -> Chain:
    """Read a chain file, that of a running run too; ChainError if it is missing, truncated, or no chain."""
    if not path.exists():
        raise ChainError(f"{path}: there is no chain file: the run did not get as far as its first step")
    for attempt in range(3):
        try:
            return _read(path)
        except (OSError, KeyError, RuntimeError, ValueError) as error:
            reason = error
            if attempt < 2:
                sleep(0.1)  # the running run may just be writing
    raise ChainError(
        f"{path}: not a readable chain file ({str(reason).splitlines()[0]}). It may be truncated. "
        "Nothing was changed: restore it from a copy, or start again with --force."
    )


def _read(path: Path) -> Chain:
    with h5py.File(path, "r", locking=False) as file:
        group = file[GROUP]
        steps = int(group.attrs["iteration"])
        attributes = {key: _plain(value) for key, value in file.attrs.items()}
        chain, log_prob = group["chain"][:steps], group["log_prob"][:steps]
        blobs = group["blobs"][:steps] if "blobs" in group else np.empty(log_prob.shape, dtype=[])
        if len(chain) != steps or len(log_prob) != steps:
            raise ValueError(f"{steps} steps announced, {len(chain)} found")
        return Chain(chain, log_prob, blobs, group["accepted"][...], attributes)


def _plain(value: Any) -> Any:
    """Turn an HDF5 attribute into a plain Python value."""
    if isinstance(value, str) and value[:1] in ("{", "["):
        return json.loads(value)
    return value.item() if isinstance(value, np.generic) else value
