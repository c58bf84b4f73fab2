"""The installed components as text: by role, one component's parameters, the fields of a section."""

from __future__ import annotations

import inspect
from collections.abc import Iterable

from pydantic import BaseModel

from streamkit.components import CONTRACT, ROLES, Component, Registry
from streamkit.report.component_record import check_name, field_records
from streamkit.report.text import columns, paragraph


def listing(registry: Registry, role: str | None = None, kind: str | None = None, command: str = "plugins") -> str:
    """Describe every component, those of one role, or one of them in full.

    Without such a role or component a `StreamkitError`, which begins with the ``command``, has the nearest name.
    """
    if role is None:
        parts = [f"{name}\n{_kinds(registry, name)}" for name in ROLES]
        return "\n\n".join([*parts, *_presets(registry), *_packages(registry), *_failed(registry)])
    check_name(registry, command, role, ROLES)
    if kind is not None:
        return _describe(registry.find(role, kind, f"{command} {role}"), registry)
    return "\n\n".join([f"{role}\n{_kinds(registry, role, fields=True)}", *_failed(registry)])


def _kinds(registry: Registry, role: str, *, fields: bool = False) -> str:
    rows = []
    for kind, entry in sorted(registry.entries[role].items()):
        rows.append((kind, entry.supplier.partition(", ")[0], _summary(entry.cls)))
        if fields:
            names = [name for name in entry.cls.model_fields if name not in ROLES[role].model_fields]
            rows.append(("", "", f"parameters: {', '.join(names) or 'none of its own'}"))
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
    head = (called, "unit", "default", "allowed", "")
    rows = [
        (field["name"], field["unit"], field["default"] or "required", field["allowed"], field["description"])
        for field in field_records(cls, names)
    ]
    beside = columns([head, *rows])
    if len(beside.splitlines()) == len(rows) + 1:
        return beside
    first, *lines = columns([row[:-1] for row in (head, *rows)]).splitlines()
    if len(lines) != len(rows):  # too wide for a line each
        wide = max(len(row[0]) for row in (head, *rows))
        first, *lines = (paragraph("  ".join(row[1:-1]), f"  {row[0]:{wide}}  ") for row in (head, *rows))
    below = (paragraph(row[-1], " " * 6) for row in rows)
    return "\n".join([first, *(f"{line}\n{text}" for line, text in zip(lines, below, strict=True))])
