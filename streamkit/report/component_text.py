"""What is installed, as text: components by role, one component's parameters, the fields of a section."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterable
from typing import Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from streamkit.components import CONTRACT, ROLES, Component, Registry
from streamkit.errors import StreamkitError, nearest
from streamkit.fields import DataFile, array_of, columns_of
from streamkit.report.text import columns, paragraph
from streamkit.runfile import as_written
from streamkit.units import datum_unit, unit_of

_SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


def listing(registry: Registry, role: str | None = None, kind: str | None = None, asked: str = "plugins") -> str:
    """Describe every component, those of one role, or one of them in full.

    A `StreamkitError` that begins with the command ``asked`` names the nearest if there is no such role or component.
    """
    if role is None:
        parts = [f"{name}\n{_kinds(registry, name)}" for name in ROLES]
        return "\n\n".join([*parts, *_presets(registry), *_packages(registry), *_failed(registry)])
    check_name(registry, asked, role, ROLES)
    if kind is not None:
        return _describe(registry.find(role, kind, f"{asked} {role}"), registry)
    return "\n\n".join([f"{role}\n{_kinds(registry, role, fields=True)}", *_failed(registry)])


def check_name(registry: Registry, asked: str, name: str, known: Iterable[str]) -> None:
    """Refuse a name that the command ``asked`` does not know: say where it belongs, or the nearest."""
    if name in known:
        return
    homes = [role for role, kinds in registry.entries.items() if name in kinds]
    if homes:
        raise StreamkitError(f"{asked}: {name!r} is a {homes[0]}: ask for 'streamkit {asked} {homes[0]} {name}'.")
    raise StreamkitError(f"{asked}: nothing is called {name!r}.{nearest(name, known)} Known: {', '.join(known)}.")


def _kinds(registry: Registry, role: str, *, fields: bool = False) -> str:
    rows = []
    for kind, entry in sorted(registry.entries[role].items()):
        rows.append((kind, entry.supplier.partition(", ")[0], _summary(entry.cls)))
        if fields:
            own = [name for name in entry.cls.model_fields if name not in ROLES[role].model_fields]
            rows.append(("", "", f"parameters: {', '.join(own) or 'none of its own'}"))
    shared = ", ".join(ROLES[role].model_fields) if fields else ""
    below = f"\n\n{paragraph(shared, 'parameters of all: ', '  ')}" if shared else ""
    return (columns(rows) or "  none") + below


def _summary(cls: type[Component]) -> str:
    """Return the first paragraph of the docstring, without reST's quotes."""
    return (inspect.getdoc(cls) or "").split("\n\n")[0].replace("``", "").replace("\n", " ")


def _presets(registry: Registry) -> list[str]:
    rows = [(name, ", ".join(preset.sections), preset.reference) for name, preset in registry.presets.items()]
    return [f"presets of [potential]\n{columns(rows)}"] if rows else []


def _packages(registry: Registry) -> list[str]:
    """One row per plugin: supplier, entry point, number of components, the contract it was written for."""
    rows = [
        (
            plugin.supplier,
            f"entry point {plugin.name}" if plugin.name else "",
            f"{len(plugin.classes)} component{'s' * (len(plugin.classes) != 1)}",
            f"contract {plugin.contract}" if plugin.contract is not None else "states no contract",
        )
        for plugin in (*registry.plugins, *registry.local)
    ]
    return [f"packages, for contract {CONTRACT}\n{columns(rows)}"] if rows else []


def _failed(registry: Registry) -> list[str]:
    if not registry.failed:
        return []
    return ["failed to load\n" + "\n".join(paragraph(line, "  ", "    ") for line in registry.failed)]


def _describe(cls: type[Component], registry: Registry) -> str:
    """Docstring, reference and one row per parameter: name, unit, default, bounds, description."""
    head = [paragraph(registry.supplier(cls), f"{cls.role} {cls.kind}, from ", "  "), ""]
    text = (inspect.getdoc(cls) or "").replace("``", "")
    head.append("\n\n".join(paragraph(" ".join(part.split())) for part in text.split("\n\n")))
    if cls.reference:
        head += ["", paragraph(cls.reference, "Reference: ", "  ")]
    return "\n".join([*head, "", field_table(cls, cls.model_fields) if cls.model_fields else "No parameters."])


def field_table(cls: type[BaseModel], names: Iterable[str], called: str = "parameter") -> str:
    """One row per field: name, unit, default, bounds, and the description, below where a row would be too long."""
    fields = [(name, cls.model_fields[name]) for name in names]
    head = (called, "unit", "default", "allowed", "")
    rows = [(name, unit_name(f), default(f), allowed(f), f.description or "") for name, f in fields]
    beside = columns([head, *rows])
    if len(beside.splitlines()) == len(rows) + 1:
        return beside
    first, *lines = columns([row[:-1] for row in (head, *rows)]).splitlines()
    if len(lines) != len(rows):  # too wide for a line each
        wide = max(len(row[0]) for row in (head, *rows))
        first, *lines = (paragraph("  ".join(row[1:-1]), f"  {row[0]:{wide}}  ") for row in (head, *rows))
    below = (paragraph(row[-1], " " * 6) for row in rows)
    return "\n".join([first, *(f"{line}\n{text}" for line, text in zip(lines, below, strict=True))])


def unit_name(field: FieldInfo) -> str:
    """Return the unit of a field, the units of its columns, or a dash."""
    columns, array = columns_of(field), array_of(field)
    if columns is not None:
        return ", ".join(f"{name} {unit.name.replace(' ', '')}".rstrip() for name, unit in columns.units.items())
    unit = array.unit if array is not None else unit_of(field)
    return (unit.name if unit else datum_unit(field)).replace(" ", "") or "-"


def default(field: FieldInfo) -> str:
    """Return a field's default as a run file writes it."""
    if field.is_required():
        return "required"
    return as_written(field.get_default(call_default_factory=True))


def allowed(field: FieldInfo) -> str:
    """Return what a field may be."""
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
    return ", ".join(f"{_SIGNS[name]} {value:g}" for name, value in bounds.items()) or "-"
