"""What is installed, as plain values: components with their parameters."""

from __future__ import annotations

import inspect
from typing import Any

from streamkit.components import ROLES, Component, Registry
from streamkit.report.component_text import allowed, check_name, default, unit_name


def component_records(registry: Registry, role: str | None = None, kind: str | None = None) -> list[dict[str, Any]]:
    """Return every component, those of one role, or one, each with its parameters.

    A `StreamkitError` names the nearest if there is no such role or component.
    """
    if role is not None:
        check_name(registry, "plugins", role, ROLES)
    if role is not None and kind is not None:
        registry.find(role, kind, f"plugins {role}")
    return [
        _record(entry.cls, entry.supplier)
        for each in ROLES
        if role in {None, each}
        for name, entry in sorted(registry.entries[each].items())
        if kind in {None, name}
    ]


def _record(cls: type[Component], supplier: str) -> dict[str, Any]:
    parameters = [
        {
            "name": name,
            "unit": unit_name(field),
            "required": field.is_required(),
            "default": None if field.is_required() else default(field),
            "allowed": allowed(field),
            "description": field.description or "",
        }
        for name, field in cls.model_fields.items()
    ]
    said = {"description": inspect.getdoc(cls) or "", "reference": cls.reference, "parameters": parameters}
    return {"role": cls.role, "kind": cls.kind, "supplier": supplier} | said
