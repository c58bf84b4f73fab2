"""The file of all draws: HDF5 whose size and structure are made at once, so that a kill leaves it readable.

Data sets are laid out without chunks and filled with NaN. Later writes change numbers in their places and nothing
else. The draws are written in order; ``done`` says how many of them are on the disk.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from streamkit import Array, ChainError, StreamkitError
from streamkit.report import DamagedError, read_foreign, save
from streamkit.runfile import differences
from streamkit_simulate.simulator import PARTICLE

FORMAT = "streamkit simulations 1"
REASON = 200  # bytes of a reason
HEADER = 64 * 1024  # bytes that are kept free for what is beside the draws and the run file
ROWS = 1024  # draws that are copied at a time


@dataclass(frozen=True)
class Layout:
    """What a file has beside the draws, and the shape of a draw."""

    parameters: tuple[str, ...]  # names of the d parameters
    units: tuple[str, ...]  # their units
    names: tuple[str, ...]  # names of the m numbers that are measured
    # (m,) the data of the run file, and their errors.
    observed: Array
    errors: Array
    noise: bool  # whether x has the noise of the data; mean is then stored too
    particles: dict[str, int]  # number of particles of each stream; empty if they are not stored
    content: dict[str, Any]  # what determines the draws: the run file, its digest, the options

    def rows(self) -> dict[str, tuple[tuple[int, ...], Any]]:
        """Return shape and type of one draw in each data set."""
        m = len(self.names)
        shapes: dict[str, tuple[tuple[int, ...], Any]] = {"theta": ((len(self.parameters),), "f8"), "x": ((m,), "f8")}
        if self.noise:
            shapes["mean"] = (m,), "f8"
        shapes["why_not"] = (), f"S{REASON}"
        shapes |= {f"particles/{name}": ((n, len(PARTICLE)), "f4") for name, n in self.particles.items()}
        return shapes

    def bytes_of_draw(self) -> int:
        """Return the size of one draw in the file."""
        return sum(int(np.prod(shape)) * np.dtype(kind).itemsize for shape, kind in self.rows().values())


def create(path: Path, layout: Layout, draws: int, earlier: Path | None = None) -> None:
    """Make the file for so many draws, whole or not at all; it takes over the draws of an ``earlier`` one.

    Raises StreamkitError if the disk has no room for it.
    """
    header = HEADER + len(json.dumps(layout.content))  # HDF5 ends the process where a disk is full
    size, free = draws * layout.bytes_of_draw(), shutil.disk_usage(path.parent).free
    if size + header > free:
        room = max(free - header, 0) // layout.bytes_of_draw()
        raise StreamkitError(
            f"{path}: {draws} draws take {in_bytes(size + header)} and the disk has {in_bytes(free)} left, room for "
            f"{room} draws" + (". Leave out --particles" if layout.particles else "")
        )
    save(path, partial(_fill, layout=layout, draws=draws, earlier=earlier))


def _fill(part: Path, layout: Layout, draws: int, earlier: Path | None) -> None:
    with h5py.File(part, "w") as file:
        file.attrs["format"] = FORMAT
        file["run"] = np.bytes_(json.dumps(layout.content))
        for name, texts in (
            ("theta_names", layout.parameters),
            ("theta_units", layout.units),
            ("x_names", layout.names),
        ):
            file[name] = np.array([text.encode() for text in texts], dtype="S")
        file["x_observed"], file["x_error"] = layout.observed, layout.errors
        file["done"] = np.zeros(1, dtype=np.int64)
        for name, (shape, kind) in layout.rows().items():
            early = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            early.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
            fill = None if np.dtype(kind).kind == "S" else np.nan
            data = file.create_dataset(name, (draws, *shape), kind, fillvalue=fill, dcpl=early)
            if name.startswith("particles/"):
                data.attrs["columns"] = ", ".join(PARTICLE)
        if earlier is not None:
            _copy(earlier, file, layout)


def _copy(earlier: Path, file: h5py.File, layout: Layout) -> None:
    with h5py.File(earlier, "r") as old:
        done = int(old["done"][0])
        for name in layout.rows():
            for first in range(0, done, ROWS):
                part = slice(first, min(first + ROWS, done))
                file[name][part] = old[name][part]
        file["done"][0] = done


@dataclass(frozen=True)
class Archive:
    """A file that is open for writing."""

    file: h5py.File
    layout: Layout

    @property
    def done(self) -> int:
        """The number of draws that are on the disk."""
        return int(self.file["done"][0])

    def append(self, draws: dict[str, Array]) -> None:
        """Write the next draws: arrays of the same length by the name of their data set."""
        first, count = self.done, len(draws["theta"])
        for name, values in draws.items():
            self.file[name][first : first + count] = values
        self._to_disk()
        self.file["done"][0] = first + count
        self._to_disk()

    def _to_disk(self) -> None:
        self.file.flush()
        os.fsync(self.file.id.get_vfd_handle())


@contextmanager
def opened(path: Path, layout: Layout) -> Iterator[Archive]:
    """Open a file for writing; ChainError if another process writes into it, or it cannot be written."""
    try:
        file = h5py.File(path, "r+", locking=True)
    except OSError as error:
        locked = "lock" in str(error)
        raise ChainError(f"{path}: {'another command is writing here right now' if locked else error}") from None
    with file:
        yield Archive(file, layout)


def compare(path: Path, layout: Layout) -> tuple[int, int]:
    """Return how many draws a file has, and for how many it has room.

    Raises ChainError if it is of another run file or of other options: with the differences.
    """

    def read(file: h5py.File) -> tuple[str, Any, int, int]:
        return str(file.attrs["format"]), json.loads(file["run"][()]), int(file["done"][0]), len(file["theta"])

    try:
        form, content, done, room = read_foreign(path, read)
    except (DamagedError, KeyError) as error:
        raise ChainError(f"{path}: is no file of streamkit simulate, or a damaged one ({error})") from None
    if form != FORMAT:
        raise ChainError(f"{path}: has the format {form!r}, this version continues {FORMAT!r}")
    if content != layout.content:
        changes = [line for line in differences(content, layout.content) if not line.startswith("digest: ")]
        raise ChainError(
            f"{path}: the draws belong to another run file or other options. What differs (there -> here): "
            f"{'; '.join(changes) or 'the contents of a data file, or the code of a component'}. Choose another file, "
            "or --force to replace it."
        )
    return done, room


def in_bytes(size: float) -> str:
    """Show a size in a unit that fits."""
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB"
