"""The fields of a section that do not survive a new kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from streamkit.components import Component, Registry
from streamkit.errors import SpecError
from streamkit.runfile.section import Section


def at_default(section: Section[Any]) -> list[str]:
    """Return the fields that have the default of the present kind: the new kind has its own."""
    document = section.document()
    return [name for name, value in section.defaults().items() if document.get(name) == value]


def lacked(section: Section[Any], values: Mapping[str, Any], registry: Registry) -> list[str]:
    """Return the fields that the run file sets and that the kind in ``values`` lacks; none if no such kind exists."""
    kind = values.get(f"{section.path}.kind")
    if kind is None or not issubclass(section.cls, Component):
        return []
    prefix = f"{section.path}."
    given = {path.removeprefix(prefix): value for path, value in values.items() if path.startswith(prefix)}
    try:
        new = registry.find(section.cls.role, kind, f"{section.path}.kind")
        new = new.for_section({name: value for name, value in given.items() if name != "kind"})
    except (SpecError, ValueError):
        return []
    default = at_default(section)
    return [
        name
        for name in section.document()
        if name not in new.model_fields and name not in given and name not in default
    ]
