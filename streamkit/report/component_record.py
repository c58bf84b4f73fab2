"""The installed components and their parameters as plain values: programs read them, and texts are made of them."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterable
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from streamkit.components import ROLES, Registry
from streamkit.errors import StreamkitError, nearest
from streamkit.fields import DataFile, array_of, columns_of
from streamkit.runfile import as_written
from streamkit.units import datum_unit, unit_of

_SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


def component_records(registry: Registry, role: str | None = None, kind: str | None = None) -> list[dict[str, Any]]:
    """Return every component, those of one role, or one, each with its parameters.

    A `StreamkitError` names the nearest if there is no such role or component.
    """
    if role is not None:
        check_name(registry, "plugins", role, ROLES)
    if role is not None and kind is not None:
        registry.find(role, kind, f"plugins {role}")
    return [
        {
            "role": each,
            "kind": entry.cls.kind,
            "supplier": entry.supplier,
            "description": inspect.getdoc(entry.cls) or "",
            "reference": entry.cls.reference,
            "parameters": field_records(entry.cls, entry.cls.model_fields),
        }
        for each in ROLES
        if role in {None, each}
        for name, entry in sorted(registry.entries[each].items())
        if kind in {None, name}
    ]


def field_records(cls: type[BaseModel], names: Iterable[str]) -> list[dict[str, Any]]:
    """Return name, unit, default as a run file writes it (None if required), bounds and description of some fields."""
    return [
        {
            "name": name,
            "unit": _unit(field),
            "required": field.is_required(),
            "default": None if field.is_required() else as_written(field.get_default(call_default_factory=True)),
            "allowed": _allowed(field),
            "description": field.description or "",
        }
        for name, field in ((name, cls.model_fields[name]) for name in names)
    ]


def check_name(registry: Registry, command: str, name: str, names: Iterable[str]) -> None:
    """Raise StreamkitError for an unknown name: the message has its role, or the nearest name."""
    if name in names:
        return
    homes = [role for role, kinds in registry.entries.items() if name in kinds]
    if homes:
        raise StreamkitError(f"{command}: {name!r} is a {homes[0]}: use 'streamkit {command} {homes[0]} {name}'.")
    role, _, kind = name.partition(".")
    if kind in registry.entries.get(role, ()):
        raise StreamkitError(f"{command}: found {name!r}; use 'streamkit {command} {role} {kind}'.")
    raise StreamkitError(f"{command}: nothing is called {name!r}.{nearest(name, names)} Known: {', '.join(names)}.")


def _unit(field: FieldInfo) -> str:
    """Return the unit of a field, the units of its columns, or a dash."""
    table, array = columns_of(field), array_of(field)
    if table is not None:
        return ", ".join(f"{name} {unit.name}".rstrip() for name, unit in table.units.items())
    unit = array.unit if array is not None else unit_of(field)
    return (unit.name if unit else datum_unit(field)) or "-"


def _allowed(field: FieldInfo) -> str:
    """Return the values that a field may have, in words."""
    if get_origin(field.annotation) is Literal:
        return " or ".join(as_written(choice) for choice in get_args(field.annotation))
    if field.annotation is bool:
        return "true or false"
    if datum_unit(field):
        return "[value, error]"
    if columns_of(field) is not None:
        return "file or columns"
    if (array := array_of(field)) is not None:
        return f"list or file, each {array.sign}".removesuffix(", each ")
    if field.annotation is DataFile:
        return "file"
    bounds = {name: getattr(item, name) for item in field.metadata for name in _SIGNS if hasattr(item, name)}
    if bounds.get("ge", math.inf) <= bounds.get("gt", -math.inf):  # a Speed that must not be zero
        del bounds["ge"]
    if "ge" in bounds and bounds["ge"] == bounds.get("le"):
        return f"{bounds['ge']:g}"
    return ", ".join(f"{_SIGNS[name]} {value:g}" for name, value in bounds.items()) or "-"
