"""What data on the host read of a run file, and what they assume of its host: both must be there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from streamkit.components import HostData
from streamkit.errors import nearest
from streamkit.runfile.document import as_written
from streamkit.runfile.section import Section
from streamkit.runfile.sections import Sections
from streamkit.units import unit_of

TOPS = ("potential", "body", "sun")  # the sections of the host


def not_there(sections: Sections) -> list[str]:
    """Return a sentence for each number of the host that data read and the run file lacks, or has in another unit."""
    units = {
        f"{section.path}.{name}": unit.name
        for section in sections.of_host
        for name, field in section.cls.model_fields.items()
        if (unit := unit_of(field)) is not None and isinstance(getattr(section.centre, name), float)
        if name not in section.knots
    }
    return [error for datum in sections.data.values() for error in _unread(datum, units)]


def _unread(datum: Section[HostData], units: Mapping[str, str]) -> Iterator[str]:
    head = f"{datum.path}: the {datum.cls.kind} reads"
    for path, unit in datum.centre.reads().items():
        if path not in units:
            yield (f"{head} {path}, and the host has no such number.{nearest(path, units)} Allowed: {', '.join(units)}")
        elif units[path] != unit:
            yield f"{head} {path} in {unit or 'no unit'}; found a field in {units[path] or 'no unit'}"


def not_as_assumed(sections: Sections, document: Mapping[str, Any]) -> list[str]:
    """Return a sentence for each value of a resolved run file's host that is not what its data assume."""
    return [error for datum in sections.data.values() for error in _assumed(datum, document)]


def _assumed(datum: Section[HostData], document: Mapping[str, Any]) -> Iterator[str]:
    assumed, read = datum.centre.assumes(), datum.centre.reads()
    there = host_values(document)
    head = f"{datum.path}: the {datum.cls.kind} assumes"
    for path, value in assumed.items():
        if path not in there:
            yield f"{head} {path} = {as_written(value)}, and the run file has no such value.{nearest(path, there)}"
        elif there[path] != value:
            yield f"{head} {path} = {as_written(value)}; found {as_written(there[path])}"
    known = {_section_of(path) for path in (*assumed, *read)}
    tops = {path.partition(".")[0] for path in assumed}
    for section in dict.fromkeys(map(_section_of, there)):
        if section.partition(".")[0] in tops and section not in known:
            yield f"{head} a host without [{section}]"


def host_values(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of the host in a resolved run file by their paths; a prior is one value."""
    found: dict[str, Any] = {}
    for top in TOPS:
        table = {key: value for key, value in document.get(top, {}).items() if key != "preset"}
        several = table and all(isinstance(value, Mapping) and "kind" in value for value in table.values())
        sections = {f"{top}.{name}": inner for name, inner in table.items()} if several else {top: table}
        found |= {f"{path}.{key}": value for path, inner in sections.items() for key, value in inner.items()}
    return found


def _section_of(path: str) -> str:
    return path.rpartition(".")[0]
