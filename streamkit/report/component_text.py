"""What is installed, as text: components by role, and one component's parameters."""

from __future__ import annotations

import inspect
from typing import Literal, get_args, get_origin

from pydantic.fields import FieldInfo

from streamkit.components import ROLES, Component, Registry
from streamkit.errors import StreamkitError, nearest
from streamkit.report.text import columns, paragraph
from streamkit.spec import as_written
from streamkit.units import unit_of

_SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


def listing(registry: Registry, role: str | None = None, kind: str | None = None) -> str:
    """Describe every component, those of one role, or one of them in full.

    Raises
    ------
    StreamkitError
        If there is no such role or component; names the nearest.
    """
    if role is None:
        parts = [f"{name}\n{_kinds(registry, name)}" for name in ROLES]
        return "\n\n".join([*parts, *_failed(registry)])
    if role not in ROLES:
        raise StreamkitError(_unknown_role(registry, role))
    if kind is not None:
        return _describe(registry.find(role, kind, f"plugins {role}"), registry)
    return "\n\n".join([f"{role}\n{_kinds(registry, role, fields=True)}", *_failed(registry)])


def _unknown_role(registry: Registry, role: str) -> str:
    homes = [name for name, known in registry.entries.items() if role in known]
    if homes:
        return f"plugins: {role!r} is a {homes[0]}: ask for 'streamkit plugins {homes[0]} {role}'."
    known = ", ".join(ROLES)
    return f"plugins: no kind of component is called {role!r}.{nearest(role, ROLES)} Known: {known}."


def _kinds(registry: Registry, role: str, *, fields: bool = False) -> str:
    rows = []
    for kind, entry in sorted(registry.entries[role].items()):
        rows.append((kind, entry.supplier, _summary(entry.cls)))
        if fields:
            own = [name for name in entry.cls.model_fields if name not in ROLES[role].model_fields]
            rows.append(("", "", f"parameters: {', '.join(own) or 'none of its own'}"))
    shared = ", ".join(ROLES[role].model_fields) if fields else ""
    below = f"\n\n{paragraph(shared, 'parameters of all: ', '  ')}" if shared else ""
    return (columns(rows) or "  none") + below


def _summary(cls: type[Component]) -> str:
    """Return the first paragraph of the docstring, without reST's quotes."""
    return (inspect.getdoc(cls) or "").split("\n\n")[0].replace("``", "").replace("\n", " ")


def _failed(registry: Registry) -> list[str]:
    if not registry.failed:
        return []
    return ["failed to load\n" + "\n".join(paragraph(line, "  ", "    ") for line in registry.failed)]


def _describe(cls: type[Component], registry: Registry) -> str:
    """Docstring, reference and one row per parameter: name, unit, default, bounds, description."""
    head = [f"{cls.role} {cls.kind}, from {registry.supplier(cls)}", ""]
    text = (inspect.getdoc(cls) or "").replace("``", "")
    head.append("\n\n".join(paragraph(" ".join(part.split())) for part in text.split("\n\n")))
    if cls.reference:
        head += ["", f"Reference: {cls.reference}"]
    if not cls.model_fields:
        return "\n".join([*head, "", "No parameters."])
    return "\n".join([*head, "", _parameters(cls)])


def _parameters(cls: type[Component]) -> str:
    """One row per parameter, the description beside it, or below where a row would be too long."""
    head = ("parameter", "unit", "default", "allowed", "")
    fields = cls.model_fields.items()
    rows = [(name, _unit(f), _default(f), _allowed(f), f.description or "") for name, f in fields]
    beside = columns([head, *rows])
    if len(beside.splitlines()) == len(rows) + 1:
        return beside
    below = columns([head[:-1], *(row[:-1] for row in rows)]).splitlines()
    lines = [below[0]]
    for line, row in zip(below[1:], rows, strict=True):
        lines += [line, *([paragraph(row[-1], " " * 6)] if row[-1] else [])]
    return "\n".join(lines)


def _unit(field: FieldInfo) -> str:
    unit = unit_of(field)
    return (unit.name.replace(" ", "") or "-") if unit else "-"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    return as_written(field.get_default(call_default_factory=True))


def _allowed(field: FieldInfo) -> str:
    if get_origin(field.annotation) is Literal:
        return " or ".join(as_written(choice) for choice in get_args(field.annotation))
    if field.annotation is bool:
        return "true or false"
    bound: dict[str, float] = {}
    for item in field.metadata:
        for name in ("gt", "ge", "lt", "le"):
            if getattr(item, name, None) is not None:
                bound[name] = getattr(item, name)
    if "gt" in bound and bound.get("ge", -float("inf")) <= bound["gt"]:
        bound.pop("ge", None)
    return ", ".join(f"{_SIGNS[name]} {value:g}" for name, value in bound.items()) or "-"
