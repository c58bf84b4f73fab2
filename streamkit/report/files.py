"""Atomic writing of files, locks of directories, and the provenance of tables."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from io import BytesIO, StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from streamkit.distribution import VERSION
from streamkit.errors import ChainError, StreamkitError, nearest

if TYPE_CHECKING:
    from astropy.table import QTable
    from filelock import BaseFileLock
    from matplotlib.figure import Figure

    from streamkit.runfile import Spec

PICTURES = (".png", ".pdf", ".svg")  # suffixes a picture can be written to
LOCK = ".streamkit.lock"  # hidden file in a directory that a run writes into
WAIT = 2.0  # seconds for which a lock is tried: `is_locked` in another process holds it for a moment


def check_target(path: Path, suffixes: Collection[str], option: str, force: bool) -> None:
    """Refuse a file that could not be written, before anything is computed.

    Raises StreamkitError for a suffix that is not one of ``suffixes``, a directory that does not exist, or a file that
    does and may not be replaced.
    """
    if path.suffix not in suffixes:
        raise StreamkitError(
            f"{option} {str(path)!r}: the suffix says the format and must be one of {', '.join(suffixes)}; "
            f"found {path.suffix!r}.{nearest(path.suffix, suffixes)}"
        )
    if not path.parent.is_dir():
        raise StreamkitError(f"{option} {str(path)!r}: the directory {str(path.parent)!r} does not exist")
    if path.is_dir():
        raise StreamkitError(f"{option} {str(path)!r}: this is a directory, a file name is wanted")
    if path.exists() and not force:
        raise StreamkitError(f"{option} {str(path)!r}: the file exists; add --force to replace it")


def check_directory(directory: Path, products: Collection[str], what: str, force: bool) -> None:
    """Refuse to replace the products of an earlier command, before anything is computed.

    The directory need not exist. ``what`` names its ``products`` together: "an ablation".

    Raises StreamkitError if some of them are there and may not be replaced.
    """
    there = [name for name in products if (directory / name).exists()]
    if there and not force:
        some = ", ".join(there[:3]) + (" ..." if len(there) > 3 else "")
        raise StreamkitError(
            f"{directory}: holds {what} already ({some}). --force replaces it, or choose another directory."
        )


class UnwritableError(StreamkitError):
    """A file cannot be written: no room, no permission."""


def save(path: Path, writer: Callable[[Path], object]) -> None:
    """Write a file by ``writer``, whole or not at all.

    Raises UnwritableError if the file cannot be written.
    """
    try:
        replace_whole(path, writer)
    except OSError as error:
        reason = error.strerror or str(error)
        raise UnwritableError(f"output {str(path)!r}: cannot be written ({reason})") from error


def through_memory(write: Callable[[BytesIO], object]) -> Callable[[Path], object]:
    """Return a writer for `save` of what a library of HDF5 writes: HDF5 ends the process where a disk is full."""

    def writer(part: Path) -> None:
        content = BytesIO()
        write(content)
        part.write_bytes(content.getbuffer())

    return writer


def save_table(path: Path, table: QTable, form: str = "ascii.ecsv") -> None:
    """Write a table as text in UTF-8, in a format of astropy, as `save` does."""
    text = StringIO()  # astropy would write a file in the encoding of the locale
    table.write(text, format=form)
    save(path, lambda part: part.write_bytes(text.getvalue().encode()))


COLOURS, DPI = 256, 200  # of a PNG


def save_picture(path: Path, figure: Figure) -> None:
    """Write a picture, as `save` does; the letters of a PDF or SVG stay letters, in fonts that journals accept."""
    from matplotlib import rc_context

    with rc_context({"pdf.fonttype": 42, "svg.fonttype": "none"}):
        save(path, lambda part: _write_picture(part, figure))


def _write_picture(path: Path, figure: Figure) -> None:
    if path.suffix != ".png":
        figure.savefig(path, dpi=DPI)
        return
    from PIL import Image

    figure.savefig(path, dpi=DPI, pil_kwargs={"compress_level": 1})  # it is read again at once
    with Image.open(path) as image:
        # particles are dots of many shades: 256 colours look the same, in a third of the bytes
        image.convert("RGB").quantize(COLOURS).save(path, dpi=(DPI, DPI))


def save_pictures(path: Path, figure: Figure, pdf: bool) -> None:
    """Write a picture, and its PDF if ``pdf`` is set or an older PDF exists, which would show another picture."""
    save_picture(path, figure)
    beside = path.with_suffix(".pdf")
    if pdf or beside.exists():
        save_picture(beside, figure)


def origin(spec: Spec) -> dict[str, Any]:
    """Return what every table says of where it comes from: streamkit's version, the run file, its digest and seed."""
    return {
        "streamkit_version": VERSION,
        "run_file": Path(str(spec.source)).name,
        "run_digest": spec.digest(),
        "seed": spec.seed,
    }


def replace_whole(path: Path, writer: Callable[[Path], object]) -> None:
    """Write a temporary file beside ``path`` by ``writer``, then rename it in one step.

    The file is synchronised with the disk before it replaces an older one, so that a power cut leaves one of the two. A
    former temporary file is removed first: a kill may have left it, or somebody may have put a link in its place,
    through which another file would be overwritten.
    """
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        part.unlink(missing_ok=True)
        os.close(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))  # fails where there is a link
        writer(part)
        to_disk(part)
        os.replace(part, path)  # noqa: PTH105  the one call that is atomic by contract
        with suppress(OSError):  # not every system opens directories
            to_disk(path.parent)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def to_disk(path: Path) -> None:
    """Synchronise a file, or the entries of a directory, with the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def safely(path: Path) -> Iterator[None]:
    """Turn a failure to write the file, a full disk among them, into a `ChainError` that says so."""
    try:
        yield
    except OSError as error:
        raise ChainError(f"{path}: cannot be written ({error.strerror or error})") from error


def contents(directory: Path) -> list[str]:
    """Return the names in a directory without hidden files, which are the lock and remains of a kill."""
    return sorted(path.name for path in directory.iterdir() if not path.name.startswith("."))


@contextmanager
def locked(directory: Path) -> Iterator[None]:
    """Lock the directory for one run. It is made if missing, and removed again if it stays empty.

    The lock belongs to the process: a kill may leave the hidden file `LOCK`, but no lock.

    Raises ChainError if another run holds it, or it cannot be made or written: with the reason.
    """
    from filelock import FileLock

    made = [path for path in (directory, *directory.parents) if not os.path.exists(path)]  # noqa: PTH110  never raises
    lock = FileLock(directory / LOCK)
    try:
        _take(lock, directory)
        yield
    finally:
        if lock.is_locked:
            with suppress(OSError):  # while it is held: after that it may be another run's
                (directory / LOCK).unlink()
            with suppress(OSError):  # a plugin has closed its descriptor
                lock.release()
        for path in made:
            with suppress(OSError):  # something lies in it
                path.rmdir()


def is_locked(directory: Path) -> bool:
    """Return whether a run is writing into a directory now."""
    from filelock import FileLock, Timeout

    if not (directory / LOCK).exists():
        return False
    lock = FileLock(directory / LOCK)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        return True
    except OSError:  # a directory that cannot be written, by us
        return False
    lock.release()
    return False


def _take(lock: BaseFileLock, directory: Path) -> None:
    from filelock import Timeout

    try:
        directory.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise ChainError(f"{directory}: is a file, and the output needs a directory") from None
    except OSError as error:
        raise ChainError(f"{directory}: cannot be made: {error.strerror or error}") from None
    try:
        lock.acquire(timeout=WAIT)
    except Timeout:
        raise ChainError(f"{directory}: another run is writing here right now") from None
    except OSError as error:
        raise ChainError(f"{directory}: cannot be locked for writing: {error.strerror or error}") from None
