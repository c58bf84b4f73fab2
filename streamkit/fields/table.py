"""Tables as fields: several columns of one length, from a file or from lists in the run file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

from streamkit.errors import nearest
from streamkit.fields.arrays import ANY, POSITIVE, ArrayOf, array_schema
from streamkit.fields.files import Files
from streamkit.stream import Array
from streamkit.units import Unit, spelled, unit_called

KEYS = ("file", "columns", "units")


class Table:
    """Columns of one length, read-only: ``table["phi1"]`` is an array (n,) in the declared unit.

    Tables are equal if their columns are.
    """

    def __init__(self, columns: Mapping[str, Array], read_by: Columns | None = None) -> None:
        self._columns, self._read_by = dict(columns), read_by

    def is_read_by(self, columns: Columns) -> bool:
        """Whether this declaration has read the table: it need not be checked again."""
        return self._read_by is columns

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the columns."""
        return tuple(self._columns)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self._columns.values())))

    def __contains__(self, name: object) -> bool:
        return name in self._columns

    def __getitem__(self, name: str) -> Array:
        return self._columns[name]

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Table)
            and self.names == other.names
            and all(np.array_equal(column, other[name], equal_nan=True) for name, column in self._columns.items())
        )

    def __hash__(self) -> int:
        return hash(tuple((name, column.tobytes()) for name, column in self._columns.items()))

    def __repr__(self) -> str:
        return f"Table({', '.join(self.names)}; {len(self)} rows)"

    def to_dict(self) -> dict[str, list[float]]:
        """Return the columns as lists."""
        return {name: column.tolist() for name, column in self._columns.items()}


class Columns:
    """Declares the columns of a table field and their units: ``Annotated[Table, Columns(t="Gyr", factor="")]``.

    `optional` adds columns that may be missing. Units are those of astropy; '' is a plain number.

    Raises ValueError: If neither streamkit nor astropy knows a unit.
    """

    def __init__(self, /, **units: str) -> None:
        self.units: dict[str, Unit] = {name: unit_called(unit) for name, unit in units.items()}
        self.needed = frozenset(units)
        self.least = 1
        self.sorted_by = ""
        self.signs: dict[str, str] = {}
        self.ranges: dict[str, tuple[float, float]] = {}
        self.gaps: frozenset[str] = frozenset()

    def optional(self, /, **units: str) -> Columns:
        """Return the declaration with columns that may be missing."""
        return self._changed(units=self.units | {name: unit_called(unit) for name, unit in units.items()})

    def increasing(self, column: str, least: int = 2) -> Columns:
        """Return the declaration of a table in increasing order of a column, with at least ``least`` rows."""
        return self._changed(sorted_by=column, least=least)

    def positive(self, *columns: str) -> Columns:
        """Return the declaration of a table with positive numbers in some columns, such as errors and distances."""
        return self._changed(signs=self.signs | dict.fromkeys(columns, POSITIVE))

    def with_gaps(self, *columns: str) -> Columns:
        """Return the declaration of a table whose values in some columns may be missing: NaN, or a masked entry."""
        return self._changed(gaps=self.gaps | set(columns))

    def between(self, column: str, low: float, high: float) -> Columns:
        """Return the declaration of a table with the numbers of one column in an interval, in its unit."""
        return self._changed(ranges=self.ranges | {column: (low, high)})

    def _changed(self, **values: Any) -> Columns:
        other = Columns()
        vars(other).update(vars(self) | values)
        return other

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Read with `read`, write as lists."""
        return core_schema.with_info_plain_validator_function(
            lambda value, info: self.read(value, info.context),
            serialization=core_schema.plain_serializer_function_ser_schema(lambda table: table.to_dict()),
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Describe the forms that `read` takes."""
        texts = {"type": "object", "additionalProperties": {"type": "string"}}
        properties = {"file": {"type": "string"}, "columns": texts, "units": texts}
        file = {"type": "object", "properties": properties, "required": ["file"], "additionalProperties": False}
        lists = {
            "type": "object",
            "properties": {name: array_schema(unit) for name, unit in self.units.items()},
            "required": sorted(self.needed),
            "additionalProperties": False,
        }
        return {"anyOf": [{"type": "string", "examples": ["table.ecsv"]}, file, lists]}

    def read(self, value: Any, files: Files | None = None) -> Table:
        """Return the table of a run file; ValueError with a reason for anything else."""
        if isinstance(value, Table):
            if value.is_read_by(self):
                return value
            value = {name: value[name] for name in value.names}
        if isinstance(value, str | Path):
            value = {"file": str(value)}
        if not isinstance(value, Mapping):
            raise ValueError(f'found {value!r}, expected a file such as "table.ecsv", or columns as lists')
        columns = self._from_file(value, files or Files()) if "file" in value else self._from_lists(value, files)
        if missing := sorted(self.needed - columns.keys()):
            raise ValueError(f"the column {missing[0]!r} is missing; expected {', '.join(self.units)}")
        lengths = {name: len(column) for name, column in columns.items()}
        if len(set(lengths.values())) > 1:
            shown = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise ValueError(f"the columns differ in length: {shown}")
        return Table(columns, self)

    def _mark(self, name: str) -> ArrayOf:
        between = self.ranges.get(name, (-np.inf, np.inf))
        return ArrayOf(
            self.units[name], self.signs.get(name, ANY), increasing=name == self.sorted_by, least=self.least,
            between=between, gaps=name in self.gaps,
        )  # fmt: skip

    def _from_lists(self, value: Mapping[str, Any], files: Files | None) -> dict[str, Array]:
        for name in value:
            self._check_name(name)
        plain = {name: value[name] for name in self.units if name in value}
        return {name: self._named(name, plain, files) for name in plain}

    def _check_name(self, name: str) -> None:
        if name not in self.units:
            raise ValueError(
                f"there is no column {name!r}.{nearest(name, [*self.units, 'file'])} Allowed: "
                f"{', '.join(self.units)}, or file."
            )

    def _named(self, name: str, plain: Mapping[str, Any], files: Files | None) -> Array:
        try:
            return self._mark(name).read(plain[name], files)
        except ValueError as error:
            exchanged = self._exchanged(name, lambda other: ArrayOf(self.units[other]).read(plain[other], files), plain)
            raise ValueError(f"column {name!r}: {error}{exchanged}") from None

    def _exchanged(self, name: str, read: Callable[[str], Array], there: Iterable[str]) -> str:
        """Ask whether a column with an interval was exchanged with another one, if both would then be right."""
        if name not in self.ranges:
            return ""
        for other in there:
            if other == name or self.units[other] != self.units[name]:
                continue
            try:
                self._mark(name).checked(read(other))
                self._mark(other).checked(read(name))
            except ValueError:
                continue
            low, high = self.ranges[name]
            within = f"All numbers of {other!r} are within {low:g} to {high:g}"
            return f". Are the columns {name!r} and {other!r} exchanged? {within}"
        return ""

    def _from_file(self, value: Mapping[str, Any], files: Files) -> dict[str, Array]:
        for key in value:
            if key not in KEYS:
                raise ValueError(f"a table has no key {key!r}.{nearest(key, KEYS)} Allowed: {', '.join(KEYS)}.")
        file, renamed, units = value["file"], value.get("columns", {}), value.get("units", {})
        if not isinstance(file, str):
            raise ValueError(f"found file = {file!r}, expected the name of a file in quotes")
        for key, names in (("columns", renamed), ("units", units)):
            if not isinstance(names, Mapping) or not all(isinstance(text, str) for text in names.values()):
                raise ValueError(f'found {key} = {names!r}, expected {key} = {{ NAME = "..." }}')
            for name in names:
                self._check_name(name)
        there = files.names(file)
        wanted = [name for name in self.units if name in self.needed or name in renamed or name in there]

        def read(name: str) -> Array:
            where = file, renamed.get(name, name), self.units[name], units.get(name), f"units = {{ {name}"
            return files.column(*where, gaps=name in self.gaps)

        columns = {}
        for name in wanted:
            column = read(name)
            try:
                columns[name] = self._mark(name).checked(column, lambda place: f"row {place[0] + 1}")
            except ValueError as error:
                called = renamed.get(name, name)
                stated = files.stated_unit(file, called) or spelled(units.get(name, ""))
                other = stated != self.units[name].name
                why = f", after conversion from the unit {stated!r}: is that the unit?" if stated and other else ""
                why = self._exchanged(name, read, wanted) or why
                raise ValueError(f"column {called!r} of {file!r}: {error}{why}") from None
        return columns


T = TypeVar("T")


def _mark(field: FieldInfo, kind: type[T]) -> T | None:
    """Return the mark of a kind in the metadata of a field, or of a part of a union such as ``X | None``."""
    optional = (item for part in get_args(field.annotation) for item in getattr(part, "__metadata__", ()))
    return next((item for item in (*field.metadata, *optional) if isinstance(item, kind)), None)


def array_of(field: FieldInfo) -> ArrayOf | None:
    """Return the mark of a field that holds an array, which may be left out; None for any other field."""
    return _mark(field, ArrayOf)


def columns_of(field: FieldInfo) -> Columns | None:
    """Return the declared columns of a field that holds a table, which may be left out; None for any other field."""
    return _mark(field, Columns)


def array_unit(field: FieldInfo) -> Unit | None:
    """Return the unit of a field that holds an array; None for any other field."""
    mark = array_of(field)
    return None if mark is None else mark.unit
