"""Likely mistakes in the data of a measurement: the measurement with one sign, unit, column or choice changed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from itertools import combinations
from typing import Any, Literal, NamedTuple, get_args, get_origin

import numpy as np

from streamkit.components import Measurement
from streamkit.errors import StreamkitError
from streamkit.fields import Table, columns_of
from streamkit.stream import Array
from streamkit.units import datum_unit

Change = tuple[str, dict[str, Any]]  # the change in words, and the fields that it changes
OPPOSITE = "the opposite sign of"  # how the words of such a change begin
LN10_5 = np.log(10) / 5  # with an error s of its modulus a distance d has the error d s ln(10) / 5


class Slip(NamedTuple):
    """A number that was given in another unit than its field's: the change in words, corrected values and errors."""

    text: str
    values: Callable[[Array], Array]
    errors: Callable[[Array, Array], Array]


def _factor(unit: str, factor: float) -> Slip:
    """Return the slip of numbers in a unit; a file that states the unit may state a wrong one."""
    times = f"multiplied by {factor:.4g}" if factor > 1 else f"divided by {1 / factor:.4g}"
    text = f"{times}, as numbers in {unit} or below a wrong unit,"
    return Slip(text, lambda x: x * factor, lambda _, error: error * factor)


def _distance(modulus: Array) -> Array:
    return np.asarray(10 ** (np.clip(modulus, -20, 60) / 5 - 2))


# By the unit of the field: the likely units of a table without units.
SLIPS: dict[str, tuple[Slip, ...]] = {
    "kpc": (
        _factor("pc", 1e-3),
        _factor("Mpc", 1e3),
        Slip("read in mag (a distance modulus)", _distance, lambda x, error: LN10_5 * _distance(x) * error),
    ),
    "mag": (
        Slip(
            "read in kpc (a distance)",
            lambda x: 5 * np.log10(np.abs(x)) + 10,
            lambda x, error: error / np.abs(x) / LN10_5,
        ),
    ),
    "km/s": (_factor("m/s", 1e-3),),
    "mas/yr": (_factor("arcsec/yr", 1e3), _factor("microarcsec/yr", 1e-3)),
    "deg": (_factor("rad", 180 / np.pi),),
}
HOURS = _factor("hours", 15.0)  # of a right ascension: no longitude along a stream is given in hours
RIGHT_ASCENSION = "ra"


def corrected(measurement: Measurement) -> Iterator[tuple[str, Measurement]]:
    """Return the measurement with each likely mistake corrected, and the change in words, the most likely first.

    The changes concern tables and data with a value and an error. Changes that the fields refuse are left out.
    """
    fields = {name: getattr(measurement, name) for name in type(measurement).model_fields}
    for text, changes in _changes(measurement, fields):
        with suppress(ValueError, StreamkitError), np.errstate(all="ignore"):
            yield text, type(measurement)(**(fields | changes))


def _changes(measurement: Measurement, fields: Mapping[str, Any]) -> Iterator[Change]:
    declared = type(measurement).model_fields
    tables = {name: (value, _units(declared[name])) for name, value in fields.items() if isinstance(value, Table)}
    units = {name: datum_unit(declared[name]) for name, value in fields.items() if value is not None}
    data = {name: fields[name] for name, unit in units.items() if unit}
    for name, (value, error) in data.items():
        yield f"{OPPOSITE} {name}", {name: (-value, error)}
    for name, (table, _) in tables.items():
        for column in _values(table):
            yield f"{OPPOSITE} {_named(name, column)}", {name: _with(table, {column: -table[column]})}
    yield from _swapped_data(data, units)
    yield from _swapped_columns(tables)
    for name, (value, error) in data.items():
        for slip in SLIPS.get(units[name], ()):
            one, of_one = np.array([value]), np.array([error])
            changed = (float(slip.values(one)[0]), float(slip.errors(one, of_one)[0]))
            yield f"{name} {slip.text}", {name: changed}
    for name, (table, declared_units) in tables.items():
        for column in _values(table):
            hours = (HOURS,) if column == RIGHT_ASCENSION else ()
            for slip in (*SLIPS.get(declared_units.get(column, ""), ()), *hours):
                same = [error for error in _errors(table) if declared_units.get(error) == declared_units[column]]
                columns = {column: slip.values(table[column])}
                columns |= {error: slip.errors(table[column], table[error]) for error in same}
                yield f"{_named(name, column)} {slip.text}", {name: _with(table, columns)}
    for name, value in fields.items():
        annotation = declared[name].annotation
        for choice in get_args(annotation) if get_origin(annotation) is Literal else ():
            if choice != value:
                yield f"{name} = {choice!r}", {name: choice}


def _swapped_data(data: Mapping[str, tuple[float, float]], units: Mapping[str, str]) -> Iterator[Change]:
    for one, other in combinations(data, 2):
        if units[one] == units[other]:
            yield f"{one} and {other} exchanged", {one: data[other], other: data[one]}


def _swapped_columns(tables: Mapping[str, tuple[Table, Mapping[str, str]]]) -> Iterator[Change]:
    for name, (table, units) in tables.items():
        for one, other in combinations(_values(table), 2):
            if units.get(one) == units.get(other):
                columns = {one: table[other], other: table[one]}
                yield f"the columns {one} and {other} exchanged", {name: _with(table, columns)}
    for first, second in combinations(tables, 2):
        (a, a_units), (b, b_units) = tables[first], tables[second]
        for one in _values(a):
            for other in _values(b):
                if one != other and a_units.get(one) == b_units.get(other) and len(a) == len(b):
                    shared = [error for error in _errors(a) if error in _errors(b)]
                    changed = {first: _with(a, {one: b[other]} | {error: b[error] for error in shared})}
                    changed[second] = _with(b, {other: a[one]} | {error: a[error] for error in shared})
                    yield f"the columns {one} and {other} exchanged", changed


def _units(field: Any) -> dict[str, str]:
    columns = columns_of(field)
    return {} if columns is None else {name: unit.name for name, unit in columns.units.items()}


def _values(table: Table) -> list[str]:
    return [name for name in table.names if "error" not in name]


def _errors(table: Table) -> list[str]:
    return [name for name in table.names if "error" in name]


def _with(table: Table, columns: Mapping[str, Array]) -> Table:
    return Table({name: columns.get(name, table[name]) for name in table.names})


def _named(field: str, column: str) -> str:
    return column if column == field else f"{column} in {field}"
