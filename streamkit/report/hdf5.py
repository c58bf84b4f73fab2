"""HDF5 files that may be damaged: a checksum shows it before HDF5 opens them, or another process reads them first.

A damaged file can keep HDF5 busy for ever, and no exception or signal of Python's reaches it there.
"""

from __future__ import annotations

import hashlib
import io
import os
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import h5py

from streamkit.errors import StreamkitError, brief, expect_file
from streamkit.report.files import replace_whole, safely

T = TypeVar("T")
# Bytes in front of the HDF5 in a file with a checksum: a user block, which HDF5 ignores.
BLOCK = 512
MARK = b"streamkit sha256 "
DENSEST = 1100  # largest compression of gzip, which is 1032, and its headers
# Largest CPU time for reading a file without a checksum: a constant, and a time for each byte.
SECONDS, BYTES_PER_SECOND = 2.0, 2e6


class DamagedError(StreamkitError):
    """A file is damaged, or not HDF5. The message says what was found, and not which file."""


def with_checksum(content: bytes) -> bytes:
    """Return a file of HDF5 that has a user block of `BLOCK` bytes, with its checksum in that block."""
    return _block(content[BLOCK:]) + content[BLOCK:]


def _block(body: bytes) -> bytes:
    return (MARK + hashlib.sha256(body).hexdigest().encode() + b"\n").ljust(BLOCK, b"\0")


def verified(path: Path) -> bytes:
    """Return the content of a file of `write_own`.

    Raises DamagedError if the checksum differs or there is none, OSError if the file cannot be read.
    """
    expect_file(path)
    content = path.read_bytes()
    if content[:BLOCK] != _block(content[BLOCK:]):
        raise DamagedError("its checksum is not the one it was written with")
    return content


def write_own(path: Path, content: bytes) -> None:
    """Write a file of HDF5 that has a user block of `BLOCK` bytes, as a whole and with its checksum.

    Raises ChainError if it cannot be written.
    """
    with safely(path):
        replace_whole(path, lambda part: part.write_bytes(with_checksum(content)))


def read_own(path: Path, read: Callable[[h5py.File], T]) -> T:
    """Return the result of ``read`` for a file that streamkit wrote, after it is `verified`.

    Raises DamagedError if the file is damaged or no HDF5, refers to other files, or claims to hold more than it can; a
    StreamkitError of ``read`` passes.
    """
    try:
        content = verified(path)
    except OSError as error:
        raise DamagedError(error.strerror or str(error)) from None

    def read_contained(file: h5py.File) -> T:
        _check_contained(file, DENSEST * len(content))
        return read(file)

    return _read(io.BytesIO(content), read_contained)


def _check_contained(file: h5py.File, most: int) -> None:
    """Raise DamagedError if data are outside of the file, through a link of any kind, or are more bytes than ``most``.

    HDF5 would read any file of the user's, and numpy would make room for any size.
    """
    groups, seen = [file], {h5py.h5o.get_info(file.id).addr}
    for group in groups:  # grows below
        for name in group:
            where = f"{group.name}/{name}".lstrip("/")
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                raise DamagedError(f"{where} is a link to somewhere else")
            item = group[name]
            if isinstance(item, h5py.Dataset):
                if item.external or item.is_virtual:
                    raise DamagedError(f"the data of {where} are in another file")
                if item.nbytes > most:
                    raise DamagedError(f"{where} claims to hold {item.nbytes} bytes, more than the file can hold")
            elif isinstance(item, h5py.Group) and (address := h5py.h5o.get_info(item.id).addr) not in seen:
                seen.add(address)
                groups.append(item)


def read_foreign(path: Path, read: Callable[[h5py.File], T]) -> T:
    """Return the result of ``read`` for a file of unknown origin.

    Where the platform has fork, a fork of this process reads it first: HDF5 may crash, or never return.
    Raises DamagedError if the file is damaged or no HDF5; a StreamkitError of ``read`` passes.
    """
    with suppress(ImportError):  # elsewhere than on Unix
        _rehearse(path, read)
    return _read(path, read)


def _read(source: Path | io.BytesIO, read: Callable[[h5py.File], T]) -> T:
    try:
        with h5py.File(source, "r", locking=False) as file:
            return read(file)
    except StreamkitError:
        raise
    except MemoryError:
        raise DamagedError("it claims to hold more than fits into the memory") from None
    except Exception as error:  # a damaged file makes h5py and numpy raise whatever they meet first
        raise DamagedError(brief(error)) from None


def _rehearse(path: Path, read: Callable[[h5py.File], Any]) -> None:
    """Raise DamagedError if a process that reads the file dies of it."""
    import resource  # not everywhere

    with suppress(OSError):
        seconds = int(SECONDS + path.stat().st_size / BYTES_PER_SECOND) + 1
        with warnings.catch_warnings():
            # from Python 3.12 on, threads of numpy's linear algebra are warned of too; these survive a fork
            warnings.filterwarnings("ignore", message=".*fork", category=DeprecationWarning)
            process = os.fork()
        if not process:
            try:
                resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
                resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
                _read(path, read)
            finally:
                os._exit(0)
        _, status = os.waitpid(process, 0)
        if os.WIFSIGNALED(status):
            raise DamagedError("HDF5 crashes on it, or does not end")
