"""Files of a run that somebody changes and gives the right checksum: what is in them must be checked too."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from streamkit.report import hdf5


@contextmanager
def forging(path: Path) -> Iterator[h5py.File]:
    """Open a file of samples or a chain file for changes, and write its new checksum."""
    with h5py.File(path, "a") as file:
        yield file
    path.write_bytes(hdf5.with_checksum(path.read_bytes()))
