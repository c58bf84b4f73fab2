"""The particles of a stream as a file: ECSV, HDF5 or FITS."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from streamkit.report.files import check_target, origin, save, save_table, through_memory
from streamkit.runfile import Spec
from streamkit.stream import Frame, Stream

if TYPE_CHECKING:
    from astropy.table import QTable

# Suffixes a stream can be written to, with astropy's name of the format.
FORMATS = {".ecsv": "ascii.ecsv", ".hdf5": "hdf5", ".h5": "hdf5", ".fits": "fits"}


def write_stream(stream: Stream, spec: Spec, path: Path, *, frame: Frame = None, force: bool = False) -> None:
    """Write one row per particle, with units, and in the header what is needed to make the stream again.

    The columns are those of `Stream.table`; with a ``frame`` there are its angles beside RA and Dec. The path ends in
    one of `FORMATS`. An existing file is only replaced with ``force``, whole or not at all.

    Raises StreamkitError if the file exists, cannot be written, or has another suffix.
    """
    check_target(path, FORMATS, "output", force)
    table = stream.table(frame)
    form = FORMATS[path.suffix]
    # ``run`` is the resolved run file with every free parameter at the stream's value: `streamkit.load` takes it.
    table.meta.update(origin(spec) | {"run": spec.with_values(stream.parameters).document})
    if form == "ascii.ecsv":
        save_table(path, table)
        return
    if form == "hdf5":
        save(path, through_memory(lambda content: _write_hdf5(table, content)))
        return
    table.meta = fits_cards(table.meta)
    save(path, lambda part: table.write(str(part), format=form, overwrite=True))


def _write_hdf5(table: QTable, content: BytesIO) -> None:
    import h5py

    with h5py.File(content, "w") as file:
        table.write(file, format="hdf5", path="stream", serialize_meta=True)


def fits_cards(meta: dict[str, Any]) -> dict[str, Any]:
    """Flatten a header into FITS cards, of ASCII; names beyond eight letters need the HIERARCH convention."""
    cards: dict[str, Any] = {}
    for name, value in meta.items():
        if name == "parameters":
            cards.update({f"HIERARCH {path}": number for path, number in value.items()})
        elif isinstance(value, dict):
            cards[name.upper()] = json.dumps(value)
        else:
            plain = value.encode("ascii", "backslashreplace").decode() if isinstance(value, str) else value
            cards[f"HIERARCH {name}" if len(name) > 8 else name.upper()] = plain
    return cards
