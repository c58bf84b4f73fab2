"""Warnings about tables: of another stream, by the frame in the header, or with data under names that are not read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import reduce
from typing import Any

import numpy as np

from streamkit.components import Observable
from streamkit.fields import Files, Table, columns_of
from streamkit.runfile import Spec, StreamInputs
from streamkit.stream import Array, named_matrices, place_of, sky_matrix

COMMON = ("icrs", "galactic")  # frames of no stream: a header may say that the data came from them
# Columns by the names of Gaia's archive and of papers, and what they are called here.
USUAL = {
    "pmra": "pm_ra_cosdec", "pmra_error": "pm_ra_cosdec_error", "pmdec": "pm_dec", "pmdec_error": "pm_dec_error",
    "pmra_pmdec_corr": "pm_correlation", "rv": "radial_velocity", "rv_error": "radial_velocity_error",
    "v_los": "radial_velocity", "vlos": "radial_velocity", "dist": "distance", "dist_error": "distance_error",
}  # fmt: skip
SAME_FRAME = 0.01  # degrees by which the axes of one frame may differ: papers print few digits


def header_warnings(spec: Spec, inputs: StreamInputs) -> list[str]:
    """Return a warning for each table along a stream whose header names a frame other than its observable's.

    A header may say ``frame``, as tables of ECSV do; names of frames are looked for in its text.
    """
    warnings = []
    for name, observable in inputs.observables.items():
        frame = observable.sky_frame()
        if frame is None:
            continue
        path = _path(spec, inputs, name)
        own = np.asarray(sky_matrix(frame))
        for field, file, table, _ in _tables(spec, path, observable):
            if "phi1" not in table.names:
                continue
            try:
                text = str(Files(spec.folder).header(file).get("frame", ""))
            except ValueError:  # the file has gone since it was read
                continue
            frames = named_matrices().items()
            named = {other: matrix for other, matrix in frames if other in text and other not in COMMON}
            if not named or any(angle_between(own, matrix) <= SAME_FRAME for matrix in named.values()):
                continue
            stated, matrix = next(iter(named.items()))
            phi1 = float(np.median(table["phi1"]))
            phi2 = float(np.median(table["phi2"])) if "phi2" in table.names else 0.0
            here, there = (_shown(turn, phi1, phi2) for turn in (matrix, own))
            called = repr(frame) if isinstance(frame, str) else "another one"
            warnings.append(
                f"{path}.{field}: the header of {file!r} says that its frame is {stated!r}, and the observable has "
                f"{called}. The middle of its data, phi1 = {phi1:.3g} deg, is at (ra, dec) = {here} deg by the first, "
                f"and at {there} deg by the second. Is it the table of another stream?"
            )
    return warnings


def unread_warnings(spec: Spec, inputs: StreamInputs) -> list[str]:
    """Return a warning for each table that has columns under `USUAL` names, which are not read."""
    warnings = []
    for name, observable in inputs.observables.items():
        path = _path(spec, inputs, name)
        for field, file, table, renamed in _tables(spec, path, observable):
            columns = columns_of(type(observable).model_fields[field])
            if columns is None:
                continue
            try:
                there = Files(spec.folder).names(file)
            except ValueError:  # the file has gone since it was read
                continue
            lost = {
                ours: theirs
                for theirs, ours in USUAL.items()
                if theirs in {*there} - {*renamed.values()} and ours in {*columns.units} - {*table.names}
            }
            if lost:
                given = ", ".join(f'{ours} = "{theirs}"' for ours, theirs in lost.items())
                warnings.append(
                    f"{path}.{field}: {', '.join(lost.values())} of {file!r} are not read, as these columns have other "
                    f"names here. If they are data: {{ file = \"{file}\", columns = {{ {given} }} }}"
                )
    return warnings


def _path(spec: Spec, inputs: StreamInputs, name: str) -> str:
    return f"{spec.prefix(inputs.name)}observable{'' if len(inputs.observables) == 1 else '.' + name}"


def _tables(spec: Spec, path: str, observable: Observable) -> Iterator[tuple[str, str, Table, Mapping[str, str]]]:
    """Yield the fields of an observable that are tables from a file: name, file, table and the columns' names there."""
    section: Any = reduce(lambda part, key: part.get(key, {}), path.split("."), spec.document)
    for field in type(observable).model_fields:
        table, given = getattr(observable, field), section.get(field)
        file = given.get("file") if isinstance(given, Mapping) else given
        if isinstance(table, Table) and isinstance(file, str):
            yield field, file, table, given.get("columns", {}) if isinstance(given, Mapping) else {}


def angle_between(one: Array, other: Array) -> float:
    """Return the largest angle between the axes of two frames, in degrees."""
    return float(np.degrees(np.arccos(np.clip(np.diag(one @ other.T).min(), -1.0, 1.0))))


def _shown(matrix: Array, phi1: float, phi2: float) -> str:
    """Return right ascension and declination of a place in a frame, as text."""
    lon, lat = np.radians([phi1, phi2])
    ra, dec = place_of(matrix.T @ np.array([np.cos(lon) * np.cos(lat), np.sin(lon) * np.cos(lat), np.sin(lat)]))
    return f"({ra:.1f}, {dec:.1f})"
