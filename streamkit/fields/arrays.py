"""Array types for fields: ``[8, 12]``, ``["8 kpc", 12]``, ``"[8, 12] kpc"`` or a column of a file in the run file."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np
from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from streamkit.errors import nearest
from streamkit.fields.files import Files
from streamkit.stream import Array
from streamkit.units import LARGEST, UNITS, Unit

KEYS = ("file", "column", "unit")
ANY, NOT_NEGATIVE, POSITIVE = "", "zero or more", "positive"


@dataclass(frozen=True)
class ArrayOf:
    """Marks a field that holds an array of numbers in a unit, and reads it. The array is read-only."""

    unit: Unit  # the unit of the field
    sign: str = ANY  # condition on every number: positive, zero or more, or none
    increasing: bool = False  # whether the numbers must increase
    least: int = 1  # fewest numbers
    ndim: int | None = 1  # number of dimensions; None for any
    between: tuple[float, float] = (-np.inf, np.inf)  # the smallest and the largest allowed number, in the unit
    gaps: bool = False  # whether numbers may be missing: NaN

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Read with `read`, write as a list of numbers."""
        return core_schema.with_info_plain_validator_function(
            lambda value, info: self.read(value, info.context),
            serialization=core_schema.plain_serializer_function_ser_schema(lambda a: np.asarray(a).tolist()),
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Describe the forms that `read` takes."""
        return array_schema(self.unit)

    def read(self, value: Any, files: Files | None = None) -> Array:
        """Return the array of a run file in the unit; ValueError with a reason for anything else."""
        if isinstance(value, np.ndarray) and not hasattr(value, "unit"):
            array = np.array(value, dtype=float) if value.flags.writeable else np.asarray(value, dtype=float)
        elif isinstance(value, Mapping):
            array = self._from_file(value, files or Files())
        elif isinstance(value, str) and not value.lstrip().startswith("["):
            array = self._from_file({"file": value}, files or Files())
        else:
            array = self._from_list(value)
        return self.checked(array)

    def _from_file(self, table: Mapping[str, Any], files: Files) -> Array:
        for key in table:
            if key not in KEYS:
                raise ValueError(f"an array has no key {key!r}.{nearest(key, KEYS)} Allowed: {', '.join(KEYS)}.")
        name, column = table.get("file"), table.get("column")
        if not isinstance(name, str) or not isinstance(column, str | None):
            raise ValueError(f'found {dict(table)!r}, expected {{ file = "NAME.ecsv", column = "NAME" }}')
        if name.endswith(".npy"):
            if column is not None:
                raise ValueError(f"{name!r} holds one array without columns, found column = {column!r}")
            array = files.array(name)
            return array if "unit" not in table else array * float(self.unit.parse(f"1 {table['unit']}"))
        if column is None:
            raise ValueError(f'which column of {name!r}? Expected {{ file = "{name}", column = "NAME" }}')
        return files.column(name, column, self.unit, table.get("unit"))

    def _from_list(self, value: Any) -> Array:
        """Read a list of numbers and quantities, nested for more dimensions, or a list with one unit as text."""
        if isinstance(value, str):
            numbers, _, unit = value.rpartition("]")
            try:
                numbers, unit = json.loads(numbers + "]"), unit.strip()
            except ValueError:
                raise ValueError(f'expected a list with a unit such as "[8, 12] {self.unit.name}"') from None
            factor = float(self.unit.parse(f"1 {unit}")) if unit else 1.0
            return factor * self._from_list(numbers)
        if hasattr(value, "unit") and np.ndim(value):  # a quantity of astropy's
            value = [f"{number!r} {value.unit}" for number in np.asarray(value, dtype=float).tolist()]
        if not isinstance(value, Sequence):
            raise ValueError(f"found {value!r}, expected a list of numbers in {self.unit.label}, or a file")
        try:
            return np.array(self._numbers(value), dtype=float)
        except (TypeError, ValueError) as error:
            shape = "inhomogeneous" in str(error)
            raise ValueError("the lists inside the list are not of one length" if shape else str(error)) from None

    def _numbers(self, value: Any) -> Any:
        if isinstance(value, list | tuple):
            return [self._numbers(item) for item in value]
        return float(self.unit.parse(value))

    def checked(self, array: Array, entry: Callable[[tuple[int, ...]], str] | None = None) -> Array:
        """Return a read-only array in C order; ValueError if it breaks a condition.

        ``entry`` names the number at an index, in place of ``entry [1]``.
        """
        if self.ndim is not None and array.ndim != self.ndim:
            raise ValueError(f"found an array of shape {array.shape}, expected {self.ndim} dimension(s)")
        if array.size < self.least:
            raise ValueError(f"found {array.size} number(s), expected at least {self.least}")
        require = partial(self._require, array=array, entry=entry or _entry, missing=self.gaps & np.isnan(array))
        require(np.isfinite(array), wanted="a finite number")
        require(np.abs(array) <= LARGEST, wanted=f"a number below {LARGEST:g}")
        if self.sign:
            require(array >= (1 / LARGEST if self.sign == POSITIVE else 0.0), wanted=self.sign)
        low, high = self.between
        if not (low == -np.inf and high == np.inf):
            wanted = f"{low:g} or more" if high == np.inf else f"{low:g} to {high:g}"
            require((array >= low) & (array <= high), wanted=wanted)
        if self.increasing:
            rises = np.concatenate([[True], np.diff(array) > 0])
            require(rises, wanted="larger than the one before: sort them")
        array = np.ascontiguousarray(array)
        array.flags.writeable = False
        return array

    def _require(
        self, good: Any, array: Array, wanted: str, entry: Callable[[tuple[int, ...]], str], missing: Any
    ) -> None:
        good = good | missing
        if not np.all(good):
            place = tuple(int(i) for i in np.unravel_index(int(np.argmin(good)), array.shape))
            raise ValueError(f"{entry(place)} is {array[place]:g} {self.unit.name}".rstrip() + f", expected {wanted}")


def _entry(place: tuple[int, ...]) -> str:
    return "entry " + "".join(f"[{i}]" for i in place)


@dataclass(frozen=True)
class Increasing:
    """Requires increasing numbers in an array field: ``Annotated[LengthArray, Increasing(least=4)]``."""

    least: int = 2
    """Fewest numbers."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check the result of the array type before it."""
        check = ArrayOf(UNITS["Number"], increasing=True, least=self.least)
        return core_schema.no_info_after_validator_function(check.checked, handler(source))


def array_schema(unit: Unit) -> dict[str, Any]:
    """Return the JSON Schema of an array as a run file writes it."""
    entry = {"anyOf": [{"type": "number"}, {"type": "string"}, {"type": "array"}, {"type": "object"}]}
    example = f"[8, 12] {unit.name}".rstrip()
    text = {"type": "string", "examples": [example, "table.npy"]}
    properties = {key: {"type": "string"} for key in KEYS}
    table = {"type": "object", "properties": properties, "required": ["file"], "additionalProperties": False}
    return {"anyOf": [{"type": "array", "items": entry}, text, table]}


LengthArray = Annotated[Array, ArrayOf(UNITS["Length"], POSITIVE)]  # positive lengths in kpc, (n,)
CoordinateArray = Annotated[Array, ArrayOf(UNITS["Length"])]  # positions along an axis in kpc, of either sign, (n,)
MassArray = Annotated[Array, ArrayOf(UNITS["Mass"], POSITIVE)]  # positive masses in Msun, (n,)
SpeedArray = Annotated[Array, ArrayOf(UNITS["Speed"], NOT_NEGATIVE)]  # speeds in km/s, zero or more, (n,)
VelocityArray = Annotated[Array, ArrayOf(UNITS["Speed"])]  # velocities in km/s, of either sign, (n,)
DurationArray = Annotated[Array, ArrayOf(UNITS["Duration"], POSITIVE)]  # positive durations in Gyr, (n,)
TimeArray = Annotated[Array, ArrayOf(UNITS["Duration"])]  # times in Gyr, 0 today and negative in the past, (n,)
AngleArray = Annotated[Array, ArrayOf(UNITS["Angle"])]  # angles in degrees, (n,)
ProperMotionArray = Annotated[Array, ArrayOf(UNITS["ProperMotion"])]  # proper motions in mas/yr, (n,)
NumberArray = Annotated[Array, ArrayOf(UNITS["Number"])]  # dimensionless numbers, (n,)
# Dimensionless numbers in an array of any number of dimensions.
NumberTensor = Annotated[Array, ArrayOf(UNITS["Number"], ndim=None)]
