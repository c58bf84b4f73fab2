"""The journal ``chain.journal``: a file to which records are appended one by one, each whole or not at all."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from streamkit.errors import ChainError, brief, expect_file
from streamkit.report import safely, to_disk
from streamkit.stream import Array

JOURNAL = "chain.journal"
MAGIC = b"streamkit journal 1\n"
LENGTH, CHECKSUM = 8, 16  # bytes in front of a record: its length, and its BLAKE2b checksum
HEAD = LENGTH + CHECKSUM
BODY = b"PK\x03\x04"  # first bytes of a record: numpy writes arrays as a zip file


class Journal:
    """Records of arrays in a file that only grows, until it is cleared.

    When `append` returns, the record has been written and synchronised with ``fsync``. A kill or a full disk leaves at
    most one incomplete record, the last, which is dropped. The file need not exist; it is open only during a write.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.torn = 0  # bytes after the last whole record when the file was read: a record that was being written
        self._end: int | None = None

    def read(self) -> list[dict[str, Array]]:
        """Return all whole records; an empty list without a file.

        Raises ChainError if the file is no journal, or damaged in other places than its end.
        """
        try:
            expect_file(self.path)
            data = self.path.read_bytes()
        except FileNotFoundError:
            self._end, self.torn = 0, 0
            return []
        except OSError as error:
            raise ChainError(f"{self.path}: cannot be read ({error.strerror or error})") from None
        if not MAGIC.startswith(data[: len(MAGIC)]):
            raise ChainError(f"{self.path}: not a journal of streamkit")
        records, self._end = [], len(MAGIC) if len(data) >= len(MAGIC) else 0
        while (body := _record_at(data, self._end)) is not None:
            records.append(_unpacked(self.path, body))
            self._end += HEAD + len(body)
        self.torn = len(data) - self._end
        if _is_damaged(data, self._end):
            raise ChainError(
                f"{self.path}: is damaged at byte {self._end}, and not only torn at its end. Nothing was changed: "
                "restore it from a copy, or start again with --force."
            )
        return records

    def append(self, record: Mapping[str, Array]) -> None:
        """Add a record.

        Raises ChainError if it cannot be written, or if the records before it are gone; the file is then unchanged.
        """
        if self._end is None:
            self.read()
        end = self._end or 0
        body = _packed(record)
        frame = b"" if end else MAGIC
        frame += len(body).to_bytes(LENGTH, "little") + _checksum(body) + body
        new = not self.path.exists()
        if self.path.is_symlink():
            raise ChainError(f"{self.path}: is a link to another file, into which nothing is written")
        if end and (new or self.path.stat().st_size < end):
            raise ChainError(f"{self.path}: was removed or cut by somebody else while it was written")
        with safely(self.path), self.path.open("xb" if new else "r+b", buffering=0) as file:
            file.truncate(end)  # drops an incomplete record
            file.seek(end)
            try:
                left = memoryview(frame)
                while left:
                    left = left[file.write(left) :]
                os.fsync(file.fileno())
                if new:
                    to_disk(self.path.parent)
            except OSError:
                file.truncate(end)
                raise
        self._end = end + len(frame)

    def clear(self) -> None:
        """Delete the file, after its records have been stored elsewhere."""
        with safely(self.path):
            self.path.unlink(missing_ok=True)
        self._end = 0


def journal_of(chain: Path) -> Journal:
    """Return the journal of a chain file."""
    return Journal(chain.with_suffix(Path(JOURNAL).suffix))


def _record_at(data: bytes, at: int) -> bytes | None:
    """Return the record that begins at byte ``at``; None if it is not whole."""
    begin, length = at + HEAD, int.from_bytes(data[at : at + LENGTH], "little")
    body = data[begin : begin + length]
    return body if 0 < length == len(body) and _checksum(body) == data[at + LENGTH : begin] else None


def _is_damaged(data: bytes, at: int) -> bool:
    """Return whether the data from byte ``at`` on are more than one incomplete record.

    No whole record begins there. An incomplete record is the last one, and its body is not whole. A whole body, or a
    whole record further on, therefore shows that the length or the checksum at ``at`` is wrong.
    """
    begin = at + HEAD
    if begin < len(data) and _checksum(data[begin:]) == data[at + LENGTH : begin]:
        return True
    length = int.from_bytes(data[at : at + LENGTH], "little")
    if 0 < length < len(data) - begin:
        return True
    while (begin := data.find(BODY, begin + 1)) >= 0:
        if _record_at(data, begin - HEAD) is not None:
            return True
    return False


def _checksum(body: bytes) -> bytes:
    return hashlib.blake2b(body, digest_size=CHECKSUM).digest()


def _packed(record: Mapping[str, Array]) -> bytes:
    file = io.BytesIO()
    np.savez(file, **record)  # type: ignore[arg-type]  # numpy's stub mistakes the arrays for its option
    return file.getvalue()


def _unpacked(path: Path, body: bytes) -> dict[str, Array]:
    try:
        with np.load(io.BytesIO(body), allow_pickle=False) as arrays:
            if sum(part.file_size for part in arrays.zip.infolist()) > len(body):  # numpy does not compress
                raise ValueError("its arrays claim to be larger than it is")
            return dict(arrays)
    except Exception as error:  # for a forged file numpy and zipfile may raise any exception
        raise ChainError(f"{path}: holds a record that is not readable ({brief(error)})") from None
