"""The storage of a chain's steps: in memory, or in files, first the journal and then by the hundred ``chain.h5``."""

from __future__ import annotations

import io
import json
import logging
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from emcee.backends import HDFBackend

from streamkit.errors import ChainError, ComponentError
from streamkit.report import BLOCK, DamagedError, safely, verified, write_own
from streamkit.sample.store.chain import RANDOM, Chain, damaged, read_chain_file
from streamkit.sample.store.journal import journal_of
from streamkit.sample.store.step import FORMER, MEMORY, Step, extend_checksum
from streamkit.stream import Array

# Steps in the journal after which they are moved into the chain file, or an eighth of the chain if that is more. The
# file is written anew each time, so that a kill leaves the old one unchanged.
TAIL = 100
# Level of compression: most proposals are refused, so that a sample and its predictions repeat the previous ones.
COMPRESSION = 4
LARGE = 100_000  # smallest size in bytes of other arrays that are compressed


class ChainMemory:
    """The steps of a chain in memory."""

    def __init__(self) -> None:
        self.last: Step | None = None  # the last step that was stored, number 0 for the start; None for an empty chain
        self._attributes: dict[str, Any] = {}
        self._shape = 0, 0  # walkers and parameters
        self._coords: list[Array] = []
        self._steps: list[Step] = []
        self._accepted: Array = np.zeros(0)
        self._checksum = ""

    @property
    def iteration(self) -> int:
        """The number of stored steps."""
        return len(self._coords)

    @property
    def acceptance(self) -> float:
        """Fraction of the proposals that were accepted."""
        return float(np.mean(self._accepted)) / max(self.iteration, 1)

    def note(self, **attributes: Any) -> None:
        """Store attributes beside the chain: mappings and lists as JSON."""
        self._attributes |= attributes

    def reset(self, walkers: int, d: int) -> None:
        """Begin an empty chain, in place of any other."""
        self.last, self._coords, self._steps = None, [], []
        self._accepted, self._shape = np.zeros(walkers), (walkers, d)
        self._checksum = self._digest

    def append(self, step: Step) -> None:
        """Store the start, or the next step; its checksum and digest are filled in.

        ComponentError if the step cannot be stored, or has another form than the steps before. Nothing is then written.
        """
        step = replace(step, digest=self._digest).checked()
        self._check_form(step)
        if step.number:
            checksum = extend_checksum(self._checksum, step.coords, step.log_prob, step.blobs)
            step = replace(step, checksum=checksum)
            self._write_step(step)
            self._coords.append(step.coords)
            self._steps.append(step)
            self._accepted = self._accepted + step.accepted
            self._checksum = checksum
        else:
            self._write_step(step)
        self.last = step

    def _check_form(self, step: Step) -> None:
        """Check that the points have the shape of the steps before; ComponentError if not."""
        if step.coords.shape != self._shape:
            raise ComponentError(
                f"a step cannot be stored: the points: found {step.coords.dtype} of shape {step.coords.shape}, "
                f"expected shape {self._shape} as in the steps before"
            )

    def samples(self) -> Array:
        """(steps, walkers, d) All samples."""
        return np.array(self._coords) if self._coords else np.empty((0, *self._shape))

    def consolidate(self, goes_on: bool = False) -> None:
        """Move the steps to their final place. In memory there is nothing to do."""

    def whole(self) -> Chain:
        """Return the chain. ChainError if it has no step."""
        if not self._steps:
            raise ChainError("the run ended before its first step: there are no samples")
        log_prob, blobs = (np.array([getattr(step, name) for step in self._steps]) for name in ("log_prob", "blobs"))
        counts = {"counts": dict(self._steps[-1].counts)}
        return Chain(self.samples(), log_prob, blobs, self._accepted, self._attributes | counts)

    @property
    def _digest(self) -> str:
        return str(self._attributes.get("digest", ""))

    def _write_step(self, step: Step) -> None:
        """Write a step to the disk; does nothing in memory."""


class ChainFile(ChainMemory):
    """The steps of a chain in files, where they survive any end of the process.

    `append` adds a record to the journal, with all that a resumed run needs. `consolidate` moves the steps of the
    journal into the chain file beside it, which it replaces as a whole.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self._journal = journal_of(path)
        self._patience = 0

    def reset(self, walkers: int, d: int) -> None:
        """Begin an empty chain, in place of any other."""
        self._journal.clear()
        super().reset(walkers, d)
        image = _Image(b"")
        image.reset(walkers, d)
        self._write(image)

    def load(self) -> None:
        """Read a chain, to continue it. ChainError if it cannot be read, or was changed.

        A warning in the log names a step that is lost because it was just being written.
        """
        stored = read_chain_file(self.path)
        steps, (walkers, d) = len(stored.chain), stored.chain.shape[1:]
        self._attributes = stored.attributes | self._attributes
        counts = self._attributes.pop("counts", {})
        super().reset(walkers, d)
        self._coords, self._steps, self._accepted = list(stored.chain), stored.journal, stored.accepted
        self._checksum = stored.checksum
        self.last = stored.start
        if steps:
            self.last = Step(
                steps, stored.chain[-1], stored.log_prob[-1], stored.blobs[-1], np.zeros(walkers, dtype=bool),
                stored.random_state, counts, stored.memory, checksum=stored.checksum, digest=self._digest,
            )  # fmt: skip
        if stored.torn:
            logging.getLogger("streamkit").warning(
                "%s: ends with a part of step %d (%d bytes), which was being written when the run ended. The part is "
                "dropped, and the run continues after step %d.",
                self._journal.path, steps + 1, stored.torn, steps,
            )  # fmt: skip

    def append(self, step: Step) -> None:
        """Store the start, or the next step.

        ChainError if it cannot be written; the chain then ends with the step before.
        """
        super().append(step)
        if len(self._steps) >= max(TAIL, self._stored // 8, self._patience):
            try:
                self.consolidate(goes_on=True)
            except ChainError:  # the journal holds the steps; the end of the run raises if there is no room then
                self._patience = 2 * len(self._steps)

    def whole(self) -> Chain:
        """Read the chain back from its files. ChainError if it cannot be read."""
        return read_chain_file(self.path)

    def _write_step(self, step: Step) -> None:
        self._journal.append(step.record())

    @property
    def _stored(self) -> int:
        """Steps in the chain file."""
        return self.iteration - len(self._steps)

    def consolidate(self, goes_on: bool = False) -> None:
        """Move the steps of the journal, and the attributes, into the chain file.

        ``goes_on`` says that more steps follow in the journal: a reader then misses it where it is not there.
        ChainError if it cannot be written: it is then as it was, and so is the journal.
        """
        image = self._image()
        if self._steps:
            image.extend(self._steps)
        self._attributes["goes_on"] = goes_on
        self._write(image)
        if self._steps:
            self._steps, self._patience = [], 0
            with suppress(ChainError):  # a reader skips its steps by their numbers
                self._journal.clear()

    def _image(self) -> _Image:
        """Return the chain file as it is, or an empty one where the journal holds all steps."""
        if self._stored:
            try:
                with safely(self.path):
                    return _Image(verified(self.path))
            except DamagedError as error:
                raise damaged(self.path, str(error)) from None
        image = _Image(b"")
        image.reset(*self._shape)
        return image

    def _write(self, image: _Image) -> None:
        last, notes = self.last, self._attributes | {"counts": {}, "checksum": self._checksum}
        with image.open("a") as file:
            if FORMER in file:  # stored in the group below instead
                del file[FORMER]
            if last is not None and last.number:
                notes["counts"] = dict(last.counts)
                for name in [*file.get(MEMORY, ())]:
                    if name not in last.memory:  # left from an earlier step
                        del file[MEMORY][name]
                for name, value in last.memory.items():
                    _put(file, f"{MEMORY}/{name}", value)
                if isinstance(last.random_state, Mapping):
                    notes[RANDOM] = dict(last.random_state)
            for key, value in notes.items():
                file.attrs[key] = json.dumps(value) if isinstance(value, dict | list) else value
        write_own(self.path, image.content.getvalue())


class _Image(HDFBackend):  # type: ignore[misc]
    """emcee's HDF5 backend on a file in memory. Plain writes put its content on the disk.

    HDF5 itself fails on a full disk, and again at exit for each file that it could not close.
    """

    def __init__(self, content: bytes) -> None:
        super().__init__("", compression="gzip", compression_opts=COMPRESSION)
        self.content = io.BytesIO(content)

    def extend(self, steps: Sequence[Step]) -> None:
        """Write steps as `HDFBackend.save_step` does, in one block: each chunk is compressed once."""
        self.grow(len(steps), steps[0].blobs)
        with self.open("a") as file:
            group = file[self.name]
            done = int(group.attrs["iteration"])
            rows = slice(done, done + len(steps))
            group["chain"][rows] = np.array([step.coords for step in steps])
            group["log_prob"][rows] = np.array([step.log_prob for step in steps])
            group["blobs"][rows] = np.array([step.blobs for step in steps])
            group["accepted"][:] += np.sum([step.accepted for step in steps], axis=0)
            if not isinstance(steps[-1].random_state, Mapping):
                for i, part in enumerate(steps[-1].random_state):
                    group.attrs[f"random_state_{i}"] = part
            group.attrs["iteration"] = done + len(steps)

    def open(self, mode: str = "r") -> h5py.File:
        """Open the file."""
        if mode == "a" and not self.content.getbuffer().nbytes:
            return h5py.File(self.content, "w", userblock_size=BLOCK)
        return h5py.File(self.content, mode)


def _put(file: h5py.File, name: str, array: Array) -> None:
    """Write an array in place of one of this name; HDF5 would not reuse the space of a deleted array."""
    stored = file.get(name)
    if stored is not None and stored.dtype != array.dtype:
        del file[name]
        stored = None
    if stored is not None and stored.shape[1:] == array.shape[1:] and None in stored.maxshape[:1]:
        stored.resize(array.shape)
    if stored is not None and stored.shape == array.shape:
        stored[...] = array
        return
    if stored is not None:
        del file[name]
    large = array.nbytes > LARGE
    grows = {"maxshape": (None, *array.shape[1:]), "compression": "gzip", "shuffle": True} if large else {}
    file.create_dataset(name, data=array, **grows)
