"""Another method of inference: a function of mock data, or files of samples; its samples are checked here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from astropy.table import QTable

from streamkit.errors import StreamkitError, brief, nearest
from streamkit.report import read_foreign
from streamkit.runfile import Spec
from streamkit.stream import Array
from streamkit.study.calibration.mocks import Mock, mock_name

# The samples that it returns: an array (n, d) in the order of the run file's free parameters, or (n,) by name.
Method: TypeAlias = Callable[[Mock], Any]
SUFFIXES = (".csv", ".ecsv", ".npz", ".h5", ".hdf5")  # files of samples
FEWEST = 20  # samples: a rank among fewer says nothing of a 95 % interval
ROUNDING = 1e-6  # of a prior's range: methods in single precision step over its ends by so much


def name_of(method: Method) -> str:
    """Return how a method is called in messages and tables."""
    return str(getattr(method, "__qualname__", type(method).__name__))


def as_samples(given: Any, spec: Spec, where: str) -> Array:
    """Return samples (n, d) in the run file's order and units.

    Raises StreamkitError, with ``where`` first, if a name is missing, if they are no numbers, too few, not finite, or
    outside the prior.
    """
    names = spec.names
    if isinstance(given, Mapping) and (missing := [name for name in names if name not in given]):
        more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        raise StreamkitError(
            f"{where}: no samples of {missing[0]}{more}.{nearest(missing[0], given)} "
            f"Found: {', '.join(map(str, given)) or 'nothing'}. Wanted: {', '.join(names)}"
        )
    try:
        samples = (
            np.array([given[name] for name in names], dtype=float).T
            if isinstance(given, Mapping)
            else np.array(given, dtype=float)
        )
    except (TypeError, ValueError) as error:
        raise StreamkitError(f"{where}: the samples are no array of numbers ({brief(error)})") from None
    if samples.ndim != 2 or samples.shape[1] != len(names):
        raise StreamkitError(
            f"{where}: the samples have the shape {samples.shape}, expected (n, {len(names)}): a row for each sample, "
            f"with {', '.join(names)}"
        )
    if len(samples) < FEWEST:
        raise StreamkitError(f"{where}: {len(samples)} samples are too few for a rank; at least {FEWEST} are needed")
    return _inside(samples, spec, where)


def _inside(samples: Array, spec: Spec, where: str) -> Array:
    """Return the samples, those at an end of a prior within it. Raises StreamkitError for the others."""
    for i, (name, prior, unit) in enumerate(zip(spec.names, spec.priors, spec.units, strict=True)):
        column = samples[:, i]
        if bad := int((~np.isfinite(column)).sum()):
            raise StreamkitError(f"{where}: {bad} of {len(column)} samples of {name} are not finite")
        low, high = prior.support
        slack = ROUNDING * (high - low) if np.isfinite(high - low) else 0.0
        if outside := int(((column < low - slack) | (column > high + slack)).sum()):
            raise StreamkitError(
                f"{where}: {outside} of {len(column)} samples of {name} are outside its prior, {low:g} to {high:g}"
                f"{unit and f' {unit}'} (they go from {column.min():g} to {column.max():g}). A posterior has none "
                "there: check the unit, or leave them out"
            )
        samples[:, i] = np.clip(column, low, high)
    return samples


def read_samples(directory: Path, index: int, spec: Spec) -> Array:
    """Return the samples (n, d) of a draw that another method left in a directory.

    Their file is ``samples_000`` with one of `SUFFIXES`. A table has a column for each free parameter, by its name and
    in the unit of the run file; others are not read. npz and HDF5 have an array (n,) for each, or ``theta`` (n, d) with
    the names of its columns in ``theta_names``.

    Raises StreamkitError if there is no file or more than one, it is damaged, or its samples cannot be used.
    """
    name = mock_name(index, "samples")
    files = [file for suffix in SUFFIXES if (file := directory / f"{name}{suffix}").exists()]
    if len(files) != 1:
        found = f"both {files[0].name} and {files[1].name}, and one is wanted" if files else "no samples of this draw"
        raise StreamkitError(
            f"{directory}: draw {index} has {found}: {name}{', '.join(SUFFIXES[:-2])} or {SUFFIXES[-2]}"
        )
    return as_samples(_arrays(files[0], spec), spec, str(files[0]))


def _arrays(file: Path, spec: Spec) -> Any:
    """Return the columns of a file by name."""
    try:
        if file.suffix == ".npz":
            with np.load(file, allow_pickle=False) as content:
                arrays = {name: content[name] for name in content.files}
        elif file.suffix in (".h5", ".hdf5"):
            arrays = read_foreign(file, lambda content: {name: content[name][()] for name in content})
        else:
            return _table(file, spec)
    except StreamkitError as error:
        raise StreamkitError(f"{file}: cannot be read ({error})") from None
    except Exception as error:  # numpy, astropy and zipfile raise whatever they meet first
        raise StreamkitError(f"{file}: cannot be read ({brief(error)})") from None
    if "theta" not in arrays:
        return arrays
    theta = np.asarray(arrays["theta"])
    names = [text.decode() if isinstance(text, bytes) else str(text) for text in arrays.get("theta_names", ())]
    if theta.ndim != 2 or len(names) != theta.shape[1]:
        raise StreamkitError(
            f"{file}: theta has the shape {theta.shape}, and theta_names names {len(names)} columns: as many names as "
            "columns are wanted"
        )
    return dict(zip(names, theta.T, strict=True))


def _table(file: Path, spec: Spec) -> dict[str, Array]:
    """Return the columns of a text table; those with a unit in the run file's."""
    table = QTable.read(file, format=f"ascii{file.suffix}")
    units = dict(zip(spec.names, spec.units, strict=True))
    columns: dict[str, Any] = {}
    for name in table.colnames:
        column = table[name]
        if getattr(column, "unit", None) is not None and name in units:
            column = column.to_value(units[name])
        columns[name] = np.ma.filled(column, np.nan) if np.ma.isMaskedArray(column) else column
    return columns
