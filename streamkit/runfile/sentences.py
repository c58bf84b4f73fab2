"""Errors of validation as sentences: the path, the value found, the values allowed, the nearest name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from streamkit.errors import nearest
from streamkit.fields import array_of, columns_of
from streamkit.units import datum_unit, unit_of

LONGEST = 2000  # largest number of characters of a sentence about one error


def shortened(error: str) -> str:
    """Leave out the middle of a message with a very long value."""
    return error if len(error) <= LONGEST else f"{error[: LONGEST // 2]} ... {error[-LONGEST // 2 :]}"


def should(message: str) -> str:
    """Turn a message of pydantic into the end of a sentence: ``should be greater than 0``."""
    message = message.removeprefix("Value error, ").removeprefix("Assertion failed, ")
    return message.replace("Input should", "should", 1).replace("a valid tuple", "a list")


def alternatives_joined(cls: type[BaseModel], items: Iterable[Any]) -> list[Any]:
    """Return pydantic's errors, with a single error for a field that may have several types.

    Pydantic gives an error for each of the types, at a path that ends with pydantic's name of the type.
    """
    single, joined = [], dict[Any, Any]()
    for item in items:
        loc = item["loc"]
        field = cls.model_fields.get(str(loc[0])) if loc else None
        if field is None or len(loc) == 1 or not isinstance(loc[1], str) or not _has_several_types(field):
            single.append(item)
            continue
        place = (loc[0], *loc[2:])
        if before := joined.get(place):
            before["msg"] += f", or {item['msg'].removeprefix('Input should be ')}"
        else:
            joined[place] = {**item, "loc": place}
    return [*single, *joined.values()]


def _has_several_types(field: FieldInfo) -> bool:
    types = get_args(field.annotation) if get_origin(field.annotation) in (Union, UnionType) else ()
    return len([each for each in types if each is not NoneType]) > 1


def sentence(path: str, cls: type[BaseModel], item: Any, called: str, more: tuple[str, ...] = ()) -> str:
    """Turn one pydantic error into a sentence: the path, the value found, the values allowed.

    ``called`` is the name of the class in the sentence; ``more`` are further keys of the section.
    """
    loc, kind, value, message = item["loc"], item["type"], item["input"], should(item["msg"])
    where = path + "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc)
    field = cls.model_fields.get(str(loc[0])) if loc else None
    if loc and field is None:
        fields = [*cls.model_fields, *more]
        guess = nearest(str(loc[0]), fields)
        return f"{where}: {called} has no field {loc[0]!r}.{guess} Allowed: {', '.join(fields)}."
    unit = unit_of(field) if field is not None else None
    description = (field.description or "" if field is not None else "").split(". ")[0].rstrip(".")
    about = f" ({description})" if description else ""
    if kind == "missing" and len(loc) == 1:
        number = f"{unit.number}, a quantity such as {unit.example!r}, or a prior" if unit else ""
        array, table = (array_of(field), columns_of(field)) if field is not None else (None, None)
        data = f"numbers in {array.unit.label} as a list or from a file" if array else "a table" if table else ""
        if field is not None and (measured := datum_unit(field)):
            data = f"[value, error] in {measured}"
        return f"{where}: missing{about}; expected {number or data or 'a value'}"
    if kind in ("value_error", "assertion_error"):
        if isinstance(value, Mapping) or (field is not None and (array_of(field) or columns_of(field))):
            return f"{where}: {message}{'' if isinstance(value, Mapping) else about}"  # the message says what was found
        says_value = not loc or repr(value) in message
        return f"{where}: {message if says_value else f'found {value!r}: {message}'}{about}"
    choices = item["ctx"]["expected"].split("'")[1::2] if kind == "literal_error" and isinstance(value, str) else []
    measure = f" {unit.name}" if unit and unit.name and isinstance(value, int | float) else ""
    return f"{where}: found {value!r}{measure}, {message}{about}.{nearest(str(value), choices)}"
