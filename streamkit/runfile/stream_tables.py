"""The tables of several streams: from the run file or from files of their own, with what all streams share."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from streamkit.errors import SpecError, nearest
from streamkit.runfile.document import read_toml
from streamkit.runfile.inputs import ONLY
from streamkit.runfile.progenitor import OTHER_NAMES
from streamkit.runfile.settings import RunFile

DEFAULTS = "stream_defaults"  # the section of what all streams share
SECTIONS = ("progenitor", "stripping", "observable")  # the sections of each stream where there are several
# Fields that may stand once, above the sections of a stream, and the sections that take them.
ABOVE = {"frame": ("progenitor", "observable"), "table": ("observable",)}
KEYS = (*SECTIONS, *ABOVE)

Table = dict[str, Any]
Place = tuple[str, ...]  # of a section or a field below its stream: ("observable", "kernel")
# The fields that a section may have, by its name, its own table, and the table with the defaults. None if unknown.
FieldsOf = Callable[[str, Mapping[str, Any], Mapping[str, Any]], Sequence[str] | None]


class StreamTables:
    """The streams of a run file, each as one table with the defaults of all streams.

    Attributes
    ----------
    tables
        The table of each stream by name, with sections as its values.
    files
        The files of the streams that have a file of their own, as messages name them.
    errors
        Sentences about streams and files that are not what a run file allows; each begins with its path.
    """

    def __init__(self) -> None:
        self.tables: dict[str, Table] = {}
        self.files: dict[str, str] = {}
        self.errors: list[str] = []
        self._shared: dict[str, set[Place]] = {}  # the fields of each stream that come from the defaults
        self._above: dict[str, dict[Place, str]] = {}  # the fields that stand above the sections of a stream

    def __bool__(self) -> bool:
        return bool(self.tables or self.errors)

    def read(self, raw: Mapping[str, Any], run_file: str, folder: Path) -> None:
        """Take the streams of a run file, and those of the files that it names, by paths relative to a folder."""
        names = [*raw.get("stream", {}), *(Path(file).stem for file in raw.get("streams", []))]
        self.errors += [
            f"{key}: found beside the named streams {', '.join(names)}; expected one stream, or only named ones, each "
            f"with a [stream.NAME.{key}] of its own, or [{DEFAULTS}.{key}] for all"
            for key in SECTIONS
            if key in raw and names
        ]
        for name, table in raw.get("stream", {}).items():
            if name in SECTIONS:
                self.errors.append(f"stream.{name}: the name of the stream is missing; expected [stream.NAME.{name}]")
            elif self._is_name(name, f"stream.{name}"):
                self._take(name, table, f"stream.{name}", f"[stream.{name}.progenitor]")
        for i, file in enumerate(raw.get("streams", [])):
            name, where = Path(file).stem, f"streams[{i}]"
            if not self._is_name(name, f"{where}, {file!r}"):
                continue
            if name in self.tables:
                other = self.files.get(name, f"[stream.{name}]")
                self.errors.append(f"{where}: {file!r} is a second stream called {name!r}, beside {other}")
                continue
            shown = str(Path(run_file).parent / file)
            try:
                table = read_toml(folder / file)
            except SpecError as error:
                self.errors.append(f"{where}: {error}")
                continue
            self.files[name] = shown
            self._take(name, table, f"stream.{name}", "[progenitor]")
        if DEFAULTS in raw:
            if not self.tables and not self.errors:
                self.errors.append(f"{DEFAULTS}: there is no stream to share it; expected [stream.NAME] or streams")
            self._check_keys(raw[DEFAULTS], DEFAULTS)

    def _is_name(self, name: str, where: str) -> bool:
        reasons = {
            f"a stream may not be called {ONLY!r}, the name of a stream without one": name == ONLY,
            "the name of a stream may not contain a dot": "." in name,
            "the name of the stream is missing": not name,
        }
        self.errors += [f"{where}: {reason}" for reason, applies in reasons.items() if applies]
        return not any(reasons.values())

    def _take(self, name: str, table: Any, path: str, example: str) -> None:
        if not isinstance(table, dict):
            self.errors.append(f"{path}: found {table!r}, expected sections such as {example}")
            return
        self._check_keys(table, path)
        self.tables[name] = copy.deepcopy(table)

    def _check_keys(self, table: Mapping[str, Any], path: str) -> None:
        for key in (key for key in table if key not in KEYS):
            if key in RunFile.model_fields:
                top = "the run file that has the streams, to its top level"
                self.errors.append(f"{path}.{key}: all streams share it; move it into {top}, or leave it out")
            else:
                self.errors.append(
                    f"{path}.{key}: a stream has no such section.{nearest(key, KEYS)} Allowed: {', '.join(KEYS)}."
                )

    def fill(self, defaults: Mapping[str, Any], fields_of: FieldsOf) -> None:
        """Give every stream the defaults that fit it; a default that fits no stream is an error.

        A stream's own value replaces a default as a whole. A default does not fit where the kind of the stream's
        section has no such field, or where the stream has its progenitor's place in other coordinates.
        """
        own = self.tables
        filled = {name: _filled(table, defaults) for name, table in own.items()}
        unfit = {
            name: {
                place
                for place in shared
                if place[0] not in ABOVE
                and (known := fields_of(place[0], _at(own[name], place[:-1]), _at(table, place[:-1]))) is not None
                and place[-1] not in known
            }
            for name, (table, shared, _) in filled.items()
        }
        # a default that no stream's section knows stays in all of them: the check of the section says what is wrong
        unknown = set.intersection(*unfit.values()) if unfit else set()
        self.tables = {}
        for name, (table, shared, _) in filled.items():
            for place in unfit[name] - unknown:
                del _at(table, place[:-1])[place[-1]]
            self.tables[name], self._shared[name] = table, shared - (unfit[name] - unknown)
            self._above[name] = {}
        for field in ABOVE:
            takers = {name: _takers(table, field, fields_of) for name, table in self.tables.items() if field in table}
            for name, places in takers.items():
                if places or (field,) not in self._shared[name] or not any(takers.values()):
                    self._move(name, field, places)
                else:  # a default that does not fit this stream
                    del self.tables[name][field]
        misplaced = set.intersection(*(skipped for _, _, skipped in filled.values())) if filled else set()
        self.errors += [
            f"{DEFAULTS}.{section}: fits no stream: each stream has one {section} where the default has several with "
            "names, or several where the default is one"
            for section in sorted({place[0] for place in misplaced})
        ]

    def _move(self, name: str, field: str, takers: Sequence[Place]) -> None:
        """Move a field that stands above the sections of a stream to those that take it."""
        table = self.tables[name]
        value = table.pop(field)
        if not takers:
            self.errors.append(
                f"stream.{name}.{field}: no section of the stream has such a field; expected one in "
                f"{' or '.join(ABOVE[field])}, by the kind or the coordinates there"
            )
        for place in takers:
            section = _at(table, place)
            if field not in section:
                section[field] = copy.deepcopy(value)
                self._above[name][*place, field] = field

    def above(self, name: str, place: Place) -> str:
        """Return the field above the sections of a stream that gave a field; an empty text if it has its own value."""
        return self._above.get(name, {}).get(place, "")

    def is_shared(self, name: str, place: Place, everywhere: bool) -> bool:
        """Return whether the value of a field comes from the defaults.

        For a section or a field that is missing: whether all fields of the section come from the defaults, and every
        stream has the same error ``everywhere``.
        """
        above, shared = self._above.get(name, {}), self._shared.get(name, set())
        place = (above[place],) if place in above else place
        if place in shared:
            return True
        section = place if place in {leaf[:-1] for leaf in shared} else place[:-1]
        fields = {leaf for leaf in _leaves(self.tables.get(name, {})) if leaf[:-1] == section} - above.keys()
        return everywhere and bool(section) and bool(fields) and place not in fields and fields <= shared


def _takers(table: Table, field: str, fields_of: FieldsOf) -> list[Place]:
    """Return the sections of a stream that have a field which stands above them."""
    return [
        (key, *part)
        for key in ABOVE[field]
        for part, section in _parts(table.get(key))
        if field in (fields_of(key, section, section) or ())
    ]


def _at(table: Mapping[str, Any], path: Sequence[str]) -> dict[str, Any]:
    """Return the table at a path; an empty one if there is none."""
    for key in path:
        inner = table.get(key)
        table = inner if isinstance(inner, dict) else {}
    return table  # type: ignore[return-value]  # it is a dict wherever it is changed


def _parts(section: Any) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
    """Yield a section itself, or the named sections in it."""
    if not isinstance(section, dict):
        return
    named = {name: inner for name, inner in section.items() if _is_named(inner)}
    yield from (((name,), inner) for name, inner in named.items()) if named else (((), section),)


def _is_named(value: Any) -> bool:
    return isinstance(value, dict) and "kind" in value


def _leaves(table: Mapping[str, Any]) -> Iterator[Place]:
    """Yield the place of every field of a stream."""
    for key, section in table.items():
        if not isinstance(section, dict) or key not in SECTIONS:
            yield (key,)
            continue
        for field, value in section.items():
            yield from ((key, field, inner) for inner in value) if _is_named(value) else [(key, field)]


def _filled(own: Table, defaults: Mapping[str, Any]) -> tuple[Table, set[Place], set[Place]]:
    """Return a stream's table with all defaults, the places that they fill, and those where they cannot stand."""
    table = copy.deepcopy(own)
    shared, skipped = set(), set()
    for leaf in _leaves({key: defaults[key] for key in KEYS if key in defaults}):
        *above, field = leaf
        section = table.get(leaf[0], {})
        if above and not isinstance(section, dict):
            continue
        if above and section and _has_parts(section, defaults[leaf[0]]) is not (len(leaf) == 3):
            skipped.add(leaf)
            continue
        place = table
        for key in above:
            place = place.setdefault(key, {})
        if OTHER_NAMES.get(field, field) not in {OTHER_NAMES.get(name, name) for name in place}:
            place[field] = copy.deepcopy(_at(defaults, above)[field])
            shared.add(leaf)
    return table, shared, skipped


def _has_parts(section: Mapping[str, Any], default: Mapping[str, Any]) -> bool:
    """Return whether a section holds named ones; those without a kind have the name of a default."""
    return any(isinstance(value, dict) and _is_named(default.get(name, {}) | value) for name, value in section.items())
