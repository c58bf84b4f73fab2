"""Errors of validation as sentences: where, what was found, what is allowed, the nearest name."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from streamkit.errors import nearest
from streamkit.units import unit_of


def unknown_field(where: str, name: str, cls: type[BaseModel], called: str, more: tuple[str, ...] = ()) -> str:
    """Return the sentence for a field that the class does not have."""
    fields = [*cls.model_fields, *more]
    return (
        f"{where}: {called or 'this section'} has no field {name!r}.{nearest(name, fields)} "
        f"Allowed: {', '.join(fields)}."
    )


def should(message: str) -> str:
    """Turn a message of pydantic into the end of a sentence: ``should be greater than 0``."""
    message = message.removeprefix("Value error, ").removeprefix("Assertion failed, ")
    return message.replace("Input should", "should", 1)


def sentence(path: str, cls: type[BaseModel], item: Any) -> str:
    """Turn one pydantic error into: where, what was found, what is allowed."""
    loc = item["loc"]
    where = path + "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc)
    field = cls.model_fields.get(str(loc[0])) if loc else None
    unit = unit_of(field) if field is not None else None
    description = (field.description or "" if field is not None else "").split(". ")[0].rstrip(".")
    about = f" ({description})" if description else ""
    if item["type"] == "missing" and len(loc) == 1:
        number = f"a number in {unit.label}, a quantity such as {unit.example!r}, or a prior" if unit else ""
        return f"{where}: missing{about}; expected {number or 'a value'}"
    message = should(item["msg"])
    found = item["input"]
    if item["type"] in ("value_error", "assertion_error"):
        shown = message if not loc or repr(found) in message else f"found {found!r}: {message}"
        return f"{where}: {shown}{about}"
    guess = nearest(found, item["ctx"]["expected"].split("'")[1::2]) if _is_choice(item) else ""
    measure = f" {unit.name}" if unit and unit.name and isinstance(found, int | float) else ""
    return f"{where}: found {found!r}{measure}, {message}{about}.{guess}"


def _is_choice(item: Any) -> bool:
    return item["type"] == "literal_error" and isinstance(item["input"], str)
