"""Groups, arrays and numbers of HDF5 files that people have: nothing from other files, nothing larger than the file.

Each raises StreamkitError with a sentence that begins with the file; call them inside `read_foreign`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from streamkit.errors import StreamkitError
from streamkit.report.hdf5 import DENSEST


def group_of(file: Path, parent: Any, name: str) -> Any:
    """Return a group of the file."""
    group = parent[name]
    if not isinstance(group, h5py.Group) or group.file.filename != parent.file.filename:
        raise StreamkitError(f"{file}: {name}: expected a group of this file, found something else")
    return group


def numbers_of(file: Path, parent: Any, name: str, dtype: type = float) -> Any:
    """Return a data set of numbers as an array; of complex ones for ``dtype`` complex."""
    where, data = f"{file}: {f'{parent.name}/{name}'.strip('/')}", parent[name]
    if not isinstance(data, h5py.Dataset) or data.dtype.kind not in ("iufc" if dtype is complex else "iuf"):
        raise StreamkitError(f"{where}: holds no numbers, expected an array of them")
    if data.file.filename != parent.file.filename or data.external or data.is_virtual:
        raise StreamkitError(f"{where}: is in another file; expected all numbers in one")
    if data.nbytes > DENSEST * file.stat().st_size:
        raise StreamkitError(f"{where}: claims the shape {data.shape}, and the file is too small for it")
    return np.array(data, dtype=dtype)


def number_of(file: Path, name: str, value: Any) -> float:
    """Return a number of an attribute called ``name``, or the first of several."""
    try:
        number = float(np.ravel(value)[0])
    except (TypeError, ValueError, IndexError):
        number = np.nan
    if not np.isfinite(number):
        raise StreamkitError(f"{file}: {name}: expected a number, found {str(value)[:60]!r}")
    return number
