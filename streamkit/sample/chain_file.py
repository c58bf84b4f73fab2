"""emcee's backend of a run with a directory: every step into the journal, and by the hundred into ``chain.h5``."""

from __future__ import annotations

import io
import json
import logging
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import emcee
import h5py
import numpy as np
from emcee.backends import Backend, HDFBackend

from streamkit.errors import ChainError
from streamkit.report import BLOCK, DamagedError, read_own, replace_whole, safely, verified, with_checksum
from streamkit.sample.chain import GROUP, REPLICAS, TRIED, damaged, read_chain_file
from streamkit.sample.journal import journal_of
from streamkit.sample.step import Step, extend_checksum
from streamkit.stream import Array

# Steps after which the journal's are moved into the chain file, or an eighth of the chain's if that is more: the file
# is written anew each time, so that a kill leaves it as it was.
TAIL = 100


class ChainFile(Backend):  # type: ignore[misc]  # emcee has no types
    """emcee's backend whose steps survive any end of the process.

    `save_step` takes a step from emcee, and `commit` makes it a record of the journal, together with all else that a
    resumed run needs: there is never one without the other. The steps of the journal are moved into the chain file
    by `consolidate`, which replaces it as a whole.

    Parameters
    ----------
    filename
        The chain file; the journal lies beside it.

    Attributes
    ----------
    start
        The ensemble before the first step, or None.
    """

    def __init__(self, filename: str) -> None:
        super().__init__()
        self.filename = filename
        self.start: Step | None = None
        self._path = Path(filename)
        self._journal = journal_of(self._path)
        self._attributes: dict[str, Any] = {}
        self._tail: list[Step] = []
        self._patience = 0
        self._taken: tuple[emcee.State, Array] | None = None
        self._checksum = ""
        self._counts: dict[str, Any] = {}
        self._tried: list[Array] = []
        self._replicas: Array | None = None

    def note(self, **attributes: Any) -> None:
        """Store attributes beside the chain, the next time that the file is written: mappings and lists as JSON."""
        self._attributes |= attributes

    def reset(self, nwalkers: int, ndim: int) -> None:
        """Begin an empty chain, in place of what is there."""
        self._journal.clear()
        self._set_empty(nwalkers, ndim)
        image = _Image(b"")
        image.reset(nwalkers, ndim)
        self._write(image)

    def _set_empty(self, nwalkers: int, ndim: int) -> None:
        super().reset(nwalkers, ndim)
        self.start, self._tail, self._tried, self._replicas = None, [], [], None
        self._checksum, self._counts = self._digest, {}

    def begin(self, state: emcee.State, counts: Mapping[str, Any]) -> None:
        """Store the ensemble before its first step: to find it took a search."""
        nobody = np.zeros(self.nwalkers, dtype=bool)
        step = Step(0, state.coords, state.log_prob, state.blobs, nobody, tuple(state.random_state),
                    dict(counts), digest=self._digest)  # fmt: skip
        self._journal.append(step.record())
        self.start = step

    def load(self) -> None:
        """Continue a chain where it ended. ChainError if it cannot be read, or was changed.

        A warning in the log says if a step is lost that was just being written.
        """
        found = read_chain_file(self._path)
        self._attributes = found.attributes | self._attributes
        counts = self._attributes.pop("counts", {})
        self._set_empty(*found.chain.shape[1:])
        self.iteration, self.accepted, self.random_state = len(found.chain), found.accepted, found.random_state
        self.start, self._tail, self._replicas = found.start, found.journal, found.replicas
        self._tried = [] if found.tried is None else list(found.tried[: self.iteration])
        self._checksum, self._counts = found.checksum, counts
        if found.torn:
            logging.getLogger("streamkit").warning(
                "%s: ends with a part of step %d (%d bytes), which was being written when the run ended. The part is "
                "dropped, and the run continues after step %d.",
                self._journal.path, self.iteration + 1, found.torn, self.iteration,
            )  # fmt: skip

    @property
    def _digest(self) -> str:
        return str(self._attributes.get("digest", ""))

    @property
    def counts(self) -> dict[str, Any]:
        """Calls and rejections up to the last step."""
        return dict(self._counts)

    @property
    def tried(self) -> Array | None:
        """(steps, walkers, k) What the moves learn from, NaN where nothing was stored; None if there is nothing."""
        return np.array(self._tried) if self._tried else None

    @property
    def replicas(self) -> Array | None:
        """(k, d) Replicas of the surrogate after the last step; None if there are none."""
        return self._replicas

    def has_blobs(self) -> bool:
        """Tell emcee that there may be records beside the samples."""
        return True

    def grow(self, ngrow: int, blobs: Any) -> None:
        """Do nothing: the file grows when steps are moved into it."""

    def save_step(self, state: emcee.State, accepted: Array) -> None:
        """Take a step, to be stored by `commit`."""
        self._taken = state, accepted

    def commit(self, counts: Mapping[str, Any], tried: Array | None = None, replicas: Array | None = None) -> None:
        """Store the step that emcee saved last, with what belongs to it: see `Step`.

        ChainError if it cannot be written; the chain then ends with the step before.
        """
        assert self._taken is not None  # noqa: S101  emcee has saved a step
        state, accepted = self._taken
        checksum = extend_checksum(self._checksum, state.coords, state.log_prob, state.blobs)
        step = Step(
            self.iteration + 1, state.coords.copy(), state.log_prob.copy(), None if state.blobs is None else
            state.blobs.copy(), np.array(accepted), tuple(state.random_state), dict(counts), tried,
            None if replicas is None else replicas.copy(), checksum, self._digest,
        )  # fmt: skip
        self._journal.append(step.record())
        self._taken = None
        self._tail.append(step)
        self.iteration, self.accepted, self.random_state = step.number, self.accepted + accepted, step.random_state
        self._checksum, self._counts, self._replicas = checksum, dict(step.counts), step.replicas
        if tried is not None:
            self._tried.append(tried)
        if len(self._tail) >= max(TAIL, self._stored // 8, self._patience):
            try:
                self.consolidate()
            except ChainError:  # the journal holds the steps; it is told at the end if there is no room even then
                self._patience = 2 * len(self._tail)

    @property
    def _stored(self) -> int:
        """Steps in the chain file."""
        return int(self.iteration) - len(self._tail)

    def consolidate(self) -> None:
        """Move the steps of the journal, and what was noted, into the chain file.

        ChainError if it cannot be written: it is then as it was, and so is the journal.
        """
        image = self._image()
        if self._tail:
            image.grow(len(self._tail), self._tail[0].blobs)
            for step in self._tail:
                state = step.state
                if step is not self._tail[-1]:
                    state.random_state = ()  # HDF5 would not use the room of the one before again
                image.save_step(state, step.accepted)
        self._write(image)
        if self._tail:
            self._tail, self._patience = [], 0
            with suppress(ChainError):  # its steps are passed over by their numbers
                self._journal.clear()

    def _image(self) -> _Image:
        """Return the chain file as it is, or an empty one where the journal holds all steps."""
        if self._stored:
            try:
                with safely(self._path):
                    return _Image(verified(self._path))
            except DamagedError as error:
                raise damaged(self._path, str(error)) from None
        image = _Image(b"")
        image.reset(self.nwalkers, self.ndim)
        return image

    def _write(self, image: _Image) -> None:
        with image.open("a") as file:
            tried, replicas, counts = self.tried, self._replicas, self._counts
            _put(file, TRIED, tried)
            _put(file, REPLICAS, replicas)
            notes = self._attributes | {"counts": counts, "checksum": self._checksum}
            for key, value in notes.items():
                file.attrs[key] = json.dumps(value) if isinstance(value, dict | list) else value
        content = with_checksum(image.content.getvalue())
        with safely(self._path):
            replace_whole(self._path, lambda part: part.write_bytes(content))

    def get_value(self, name: str, flat: bool = False, thin: int = 1, discard: int = 0) -> Any:
        """Return ``chain``, ``log_prob`` or ``blobs`` of all steps, as emcee's backends do."""
        if self.iteration <= 0:
            raise AttributeError("no step has been taken yet")
        first = discard + thin - 1
        parts = []
        if first < self._stored:
            try:
                parts.append(read_own(self._path, lambda file: file[GROUP][name][first : self._stored : thin]))
            except DamagedError as error:
                raise damaged(self._path, str(error)) from None
        field = "coords" if name == "chain" else name
        rows = range(first, int(self.iteration), thin)
        parts.append([getattr(self._tail[i - self._stored], field) for i in rows if i >= self._stored])
        value = np.concatenate([part for part in parts if len(part)])
        return value.reshape(-1, *value.shape[2:]) if flat else value


class _Image(HDFBackend):  # type: ignore[misc]
    """emcee's HDF5 backend on a file in memory, which is written to the disk by plain writes.

    HDF5 itself cannot be trusted on a full disk: files that it fails to close make it fail again at exit.
    """

    def __init__(self, content: bytes) -> None:
        super().__init__("")
        self.content = io.BytesIO(content)

    def open(self, mode: str = "r") -> h5py.File:
        """Open the file."""
        if mode == "a" and not self.content.getbuffer().nbytes:
            return h5py.File(self.content, "w", userblock_size=BLOCK)
        return h5py.File(self.content, mode)


def _put(file: h5py.File, name: str, array: Array | None) -> None:
    if array is None:
        return
    if name in file and file[name].shape == array.shape:
        file[name][...] = array
        return
    if name in file:
        del file[name]
    file[name] = array
