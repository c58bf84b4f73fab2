"""The particles of a stream as a file: ECSV, HDF5 or FITS."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from streamkit.report.files import check_target, origin, save
from streamkit.runfile import Spec
from streamkit.stream import Frame, Stream

if TYPE_CHECKING:
    from astropy.table import QTable


# Suffixes a stream can be written to, with astropy's name of the format.
FORMATS = {".ecsv": "ascii.ecsv", ".hdf5": "hdf5", ".h5": "hdf5", ".fits": "fits"}


def write_stream(stream: Stream, spec: Spec, path: Path, *, frame: Frame = None, force: bool = False) -> None:
    """Write one row per particle, with units, and in the header what is needed to make the stream again.

    The columns are those of `Stream.table`: with a ``frame``, its angles stand beside RA and Dec. The path ends in one
    of `FORMATS`. An existing file is replaced by ``force`` alone, whole or not at all.

    Raises StreamkitError if the file exists, cannot be written, or has another suffix.
    """
    check_target(path, FORMATS, "output", force)
    table = stream.table(frame)
    table.meta.update(provenance(stream, spec))
    save(path, lambda part: _write_table(table, part, FORMATS[path.suffix]))


def provenance(stream: Stream, spec: Spec) -> dict[str, Any]:
    """Return the header of a stream: the `origin`, and the run file.

    ``run`` is the resolved run file with every free parameter at the stream's value: `streamkit.load` takes
    it, and makes the same stream again.
    """
    return {**origin(spec), "run": spec.with_values(stream.parameters).document}


def _write_table(table: QTable, path: Path, form: str) -> None:
    if form == "fits":
        table.meta = fits_cards(table.meta)
        table.write(path, format=form, overwrite=True)
    elif form == "hdf5":
        table.write(str(path), format=form, path="stream", serialize_meta=True, overwrite=True)
    else:
        table.write(path, format=form, overwrite=True)


def fits_cards(meta: dict[str, Any]) -> dict[str, Any]:
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
