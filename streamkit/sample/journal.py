"""The journal ``chain.journal``: records appended to a file one by one, each there as a whole or not at all."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from streamkit.errors import ChainError, brief
from streamkit.report import safely, to_disk
from streamkit.stream import Array

JOURNAL = "chain.journal"
MAGIC = b"streamkit journal 1\n"
LENGTH, CHECKSUM = 8, 16  # bytes in front of a record: its length, and its BLAKE2b checksum


class Journal:
    """Records of arrays in a file that only grows, until it is cleared.

    A record is on the disk, as far as the disk keeps what ``fsync`` asks for, when `append` returns. What a death or a
    full disk leaves of one that was just being written is known by its length or its checksum, and dropped. The file
    is open only while something is written, so that nothing that closes descriptors hurts it.

    Parameters
    ----------
    path
        The file; it need not exist.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._end: int | None = None

    def read(self) -> list[dict[str, Array]]:
        """Return all whole records; an empty list without a file.

        Raises ChainError if the file is no journal, or damaged in other places than its end.
        """
        try:
            data = self.path.read_bytes()
        except FileNotFoundError:
            self._end = 0
            return []
        except OSError as error:
            raise ChainError(f"{self.path}: cannot be read ({error.strerror or error})") from None
        if not MAGIC.startswith(data[: len(MAGIC)]):
            raise ChainError(f"{self.path}: not a journal of streamkit")
        found, self._end = [], len(MAGIC) if len(data) >= len(MAGIC) else 0
        for record, end in self._records(data):
            found.append(record)
            self._end = end
        return found

    def _records(self, data: bytes) -> Iterator[tuple[dict[str, Array], int]]:
        """Yield the whole records, and where each of them ends."""
        at = len(MAGIC)
        while at + LENGTH + CHECKSUM <= len(data):
            begin = at + LENGTH + CHECKSUM
            length = int.from_bytes(data[at : at + LENGTH], "little")
            end = begin + length
            if not length or end > len(data):
                return
            body = data[begin:end]
            if _checksum(body) != data[at + LENGTH : begin]:
                if end < len(data):
                    raise ChainError(
                        f"{self.path}: is damaged at byte {at}. Nothing was changed: restore it from a copy, or start "
                        "again with --force."
                    )
                return
            yield _unpacked(self.path, body), end
            at = end

    def append(self, record: Mapping[str, Array]) -> None:
        """Add a record.

        ChainError if it cannot be written, or if what this journal wrote before is not there any more; then the file is
        as it was.
        """
        if self._end is None:
            self.read()
        end = self._end or 0
        body = _packed(record)
        frame = b"" if end else MAGIC
        frame += len(body).to_bytes(LENGTH, "little") + _checksum(body) + body
        new = not self.path.exists()
        if end and (new or self.path.stat().st_size < end):
            raise ChainError(f"{self.path}: was removed or cut by somebody else while it was written")
        with safely(self.path), self.path.open("xb" if new else "r+b", buffering=0) as file:
            file.truncate(end)  # what a death left of a record
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
        """Take the file away: what it holds is stored elsewhere."""
        with safely(self.path):
            self.path.unlink(missing_ok=True)
        self._end = 0


def journal_of(chain: Path) -> Journal:
    """Return the journal of a chain file."""
    return Journal(chain.with_suffix(Path(JOURNAL).suffix))


def _checksum(body: bytes) -> bytes:
    return hashlib.blake2b(body, digest_size=CHECKSUM).digest()


def _packed(record: Mapping[str, Array]) -> bytes:
    file = io.BytesIO()
    np.savez(file, **record)  # type: ignore[arg-type]  # numpy's stub mistakes the arrays for its option
    return file.getvalue()


def _unpacked(path: Path, body: bytes) -> dict[str, Array]:
    try:
        with np.load(io.BytesIO(body), allow_pickle=False) as arrays:
            return dict(arrays)
    except (ValueError, OSError, BadZipFile) as error:
        raise ChainError(f"{path}: holds a record that is not readable ({brief(error)})") from None
