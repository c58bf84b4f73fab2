"""Write files: the particles of a stream in ECSV, HDF5 or FITS; what other commands make, whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from streamkit import output
from streamkit.errors import StreamkitError, nearest

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from astropy.table import QTable
    from matplotlib.figure import Figure

    from streamkit.phase import Stream
    from streamkit.spec import Spec

FORMATS = {".ecsv": "ascii.ecsv", ".hdf5": "hdf5", ".h5": "hdf5", ".fits": "fits"}
"""Suffixes a stream can be written to, with astropy's name of the format."""
PICTURES = (".png", ".pdf", ".svg")
"""Suffixes a picture can be written to."""


def check_target(path: Path, suffixes: Collection[str], option: str, force: bool) -> None:
    """Refuse a file that could not be written, before anything is computed.

    Raises
    ------
    StreamkitError
        For a suffix that is not one of ``suffixes``, a directory that does not exist, or a file that does and
        may not be replaced.
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

    Parameters
    ----------
    directory
        It need not exist.
    products
        The files that would be written.
    what
        What they are together: ``"an ablation"``.
    force
        Whether they may be replaced.

    Raises
    ------
    StreamkitError
        If some of them are there and may not be replaced.
    """
    there = [name for name in products if (directory / name).exists()]
    if there and not force:
        some = ", ".join(there[:3]) + (" ..." if len(there) > 3 else "")
        raise StreamkitError(
            f"{directory}: holds {what} already ({some}). --force replaces it, or choose another directory."
        )


def write(stream: Stream, spec: Spec, path: Path, *, force: bool = False) -> None:
    """Write one row per particle, with units, and in the header what is needed to make the stream again.

    Parameters
    ----------
    stream
        The stream; its particles are written as `Stream.table` gives them.
    spec
        The run file it was made from: its digest, seed and resolved text go into the header.
    path
        Ends in one of `FORMATS`.
    force
        Whether an existing file may be replaced. It is replaced whole, or not at all.

    Raises
    ------
    StreamkitError
        If the file exists, cannot be written, or has another suffix.
    """
    check_target(path, FORMATS, "output", force)
    table = stream.table()
    table.meta.update(provenance(stream, spec))
    save(path, lambda part: _write(table, part, FORMATS[path.suffix]))


def save(path: Path, writer: Callable[[Path], object]) -> None:
    """Let ``writer`` write the file: the whole of it comes into place, or nothing.

    Raises
    ------
    StreamkitError
        If the file cannot be written.
    """
    try:
        output.write(path, writer)
    except OSError as error:
        reason = error.strerror or str(error)
        raise StreamkitError(f"output {str(path)!r}: cannot be written ({reason})") from error


def save_table(path: Path, table: QTable) -> None:
    """Write a table as ECSV, as `save` does."""
    save(path, lambda part: table.write(part, format="ascii.ecsv", overwrite=True))


def save_picture(path: Path, figure: Figure) -> None:
    """Write a picture, as `save` does."""
    save(path, lambda part: figure.savefig(part, dpi=200))


def provenance(stream: Stream, spec: Spec) -> dict[str, Any]:
    """Return the header of a stream: the `origin`, and the run file.

    ``run`` is the resolved run file with every free parameter at the stream's value: `streamkit.load` takes
    it, and makes the same stream again.
    """
    return {**origin(spec), "run": spec.with_values(stream.parameters).document}


def origin(spec: Spec) -> dict[str, Any]:
    """Return what every table says of where it comes from: streamkit's version, the run file, its digest and seed."""
    from streamkit import __version__

    return {
        "streamkit_version": __version__,
        "run_file": Path(str(spec.source)).name,
        "run_digest": spec.digest(),
        "seed": spec.seed,
    }


def _write(table: QTable, path: Path, form: str) -> None:
    if form == "fits":
        table.meta = _cards(table.meta)
        table.write(path, format=form, overwrite=True)
    elif form == "hdf5":
        table.write(str(path), format=form, path="stream", serialize_meta=True, overwrite=True)
    else:
        table.write(path, format=form, overwrite=True)


def _cards(meta: dict[str, Any]) -> dict[str, Any]:
    """Flatten a header into FITS cards; names beyond eight letters need the HIERARCH convention."""
    cards: dict[str, Any] = {}
    for name, value in meta.items():
        if name == "parameters":
            cards.update({f"HIERARCH {path}": number for path, number in value.items()})
        elif isinstance(value, dict):
            cards[name.upper()] = json.dumps(value)
        else:
            cards[f"HIERARCH {name}" if len(name) > 8 else name.upper()] = value
    return cards
