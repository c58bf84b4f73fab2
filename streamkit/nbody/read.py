"""Read a snapshot, whatever its layout."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from streamkit.errors import StreamkitError, brief, nearest
from streamkit.nbody.gadget import read_gadget
from streamkit.nbody.snapshot import Snapshot, SnapshotError
from streamkit.nbody.table import read_table

LAYOUTS = (".npz", ".hdf5", ".h5")


def read_snapshot(path: str | Path) -> Snapshot:
    """Read a snapshot; ``FILE.hdf5:PartType2`` picks one of several particle types.

    Raises SnapshotError for a file that cannot be read, units that are missing or wrong, missing or broken fields.
    """
    name, _, group = str(path).partition(":PartType")
    file = Path(name)
    if file.suffix not in LAYOUTS:
        raise SnapshotError(
            f"{file}: a snapshot must be a plain table (.npz) or HDF5 in the Gadget layout (.hdf5, .h5), "
            f"found {file.suffix or 'no suffix'!r}.{nearest(file.suffix, LAYOUTS)}"
        )
    if not file.is_file():
        raise SnapshotError(f"{file}: {'is a directory' if file.is_dir() else 'there is no such file'}")
    try:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # `_check` finds what overflows
            snapshot = read_table(file) if file.suffix == ".npz" else read_gadget(file, group)
    except StreamkitError as error:
        raise SnapshotError(str(error)) from None
    except MemoryError as error:
        raise SnapshotError(f"{file}: does not fit into the memory: {error}") from None
    except Exception as error:  # a damaged file makes the libraries raise whatever they meet first
        raise SnapshotError(f"{file}: cannot be read, it is damaged or no snapshot: {brief(error)}") from None
    _check(snapshot)
    return snapshot


def _check(snapshot: Snapshot) -> None:
    n = snapshot.q.shape[1]
    if n == 0:
        raise SnapshotError(f"{snapshot.source}: holds no particles")
    for what, values in (("positions", snapshot.q), ("velocities", snapshot.v), ("track of the core", snapshot.core)):
        if values is not None and not np.isfinite(values).all():
            raise SnapshotError(f"{snapshot.source}: the {what} hold numbers that are not finite")
    if snapshot.winding is not None and not np.isfinite(snapshot.winding).all():
        raise SnapshotError(f"{snapshot.source}: the windings hold numbers that are not finite")
