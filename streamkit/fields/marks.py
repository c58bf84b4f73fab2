"""The mark with which a pydantic field was declared: that of an array, or of a table."""

from __future__ import annotations

from typing import TypeVar, get_args

from pydantic.fields import FieldInfo

from streamkit.fields.arrays import ArrayOf
from streamkit.fields.table import Columns
from streamkit.units import Unit

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
