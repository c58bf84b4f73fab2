"""From the mapping of a run file to validated sections; all errors are collected."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from streamkit.components import Component, Registry, Sampler, load_registry
from streamkit.errors import PluginError, SpecError, nearest
from streamkit.fields import Files
from streamkit.runfile.body_table import TABLE, read_body_table
from streamkit.runfile.cross_checks import drag_unknown, massless, no_part_of_a_host, own_keys, unfit_for_lookback
from streamkit.runfile.document import TOO_DEEP
from streamkit.runfile.encounter import ENCOUNTER, read_encounter
from streamkit.runfile.encounter_checks import misplaced
from streamkit.runfile.factors import OF_A_STREAM
from streamkit.runfile.host_checks import not_as_assumed, not_there
from streamkit.runfile.inputs import ONLY
from streamkit.runfile.priors import PRIORS
from streamkit.runfile.progenitor import BODY_WAYS, OTHER_NAMES, WAYS, Sun, choose_coordinates
from streamkit.runfile.section import Section, read_section
from streamkit.runfile.sections import Sections, StreamSections
from streamkit.runfile.sentences import shortened, should
from streamkit.runfile.settings import VERSION, Engine, Likelihood, RunFile
from streamkit.runfile.stream_errors import where_written
from streamkit.runfile.stream_tables import DEFAULTS, StreamTables

DEFAULT_KIND = {"integrator": "adaptive", "observable": "apocentres", "sampler": "emcee"}
HOST_ALONE = ("growth", "centre")  # fields of a potential that a progenitor or a body does not have
_EXPECTED = {
    "version": f"{VERSION}",
    "seed": "a whole number, zero or more",
    "plugins": 'a list of Python files, such as ["my_halo.py"]',
    "streams": 'a list of files of streams, such as ["gd1.toml", "pal5.toml"]',
}


def resolve(
    source: Mapping[str, Any],
    name: str,
    registry: Registry | None,
    files: Files,
    components: Sequence[type[Component]] = (),
) -> tuple[dict[str, Any], str, Registry, Sections]:
    """Validate the mapping of a run file; return the resolved document, its name, registry and sections.

    The paths of plugin files and data files are relative to the folder of ``files``, and stay as they are written.
    Without a registry, installed plugins are loaded when they are needed, beside the plugin files and the classes in
    ``components``. Raises SpecError with all errors, one per line.
    """
    try:
        reader = _Reader(name, _plain_values(source), files)
    except RecursionError:
        raise SpecError(f"{name}: {TOO_DEEP}") from None
    reader.head()
    plugins = reader.raw.get("plugins", [])
    if registry is None:
        try:
            paths = ((files.folder / file).resolve() for file in plugins)
            registry = load_registry(paths, classes=components, lazy=True)
        except ValueError as error:
            raise SpecError(f"{name}: plugins: no path of a file: {error}") from None
        except SpecError as error:
            raise SpecError(f"{name}: {error}") from None
        except PluginError as error:
            raise PluginError(f"{name}: {error}") from error.__cause__
    sections = reader.sections(registry)
    document = _document(reader.raw, plugins, sections, reader.preset)
    reader.errors += not_as_assumed(sections, document)
    reader.stop()
    return document, name, reader.registry, sections


class _Reader:
    """Collects the errors of one run file, to report all of them together.

    A section that could not be read is None; `stop` raises before it is used.
    """

    def __init__(self, name: str, raw: dict[str, Any], files: Files) -> None:
        self.name, self.raw, self.files = name, raw, files
        self.errors: list[str] = []
        self.preset: dict[str, str] = {}  # the name of a published model, where the run file has one
        self.stream_tables = StreamTables()

    def refuse(self, error: str) -> Any:
        """Collect an error; return None in place of the section."""
        self.errors.append(error)

    def stop(self) -> None:
        """Raise SpecError if there are errors."""
        if self.errors:
            errors = where_written(self.errors, self.stream_tables, self.name)
            raise SpecError("\n".join(map(shortened, errors)))

    def head(self) -> None:
        """Check the top-level keys and values."""
        version = self.raw.get("version", VERSION)
        if not self.raw:
            self.refuse("the run file is empty; it needs at least the sections potential, progenitor and stripping")
        elif type(version) is int and version > VERSION:
            self.refuse(f"this run file is of version {version}, this streamkit reads {VERSION}: upgrade streamkit")
        self.stop()
        try:
            RunFile.model_validate(self.raw)
        except ValidationError as error:
            wrong = {str(item["loc"][0]): item for item in error.errors() if item["type"] != "missing"}
            self.errors += [self._head_error(key, item) for key, item in wrong.items()]
        self.stop()

    def _head_error(self, key: str, item: Any) -> str:
        keys = list(RunFile.model_fields)
        if key not in keys:
            return f"{key}: no section or key of a run file.{nearest(key, keys)} Allowed: {', '.join(keys)}."
        if item["type"] == "value_error":
            return f"{key}: {should(item['msg'])}"
        return f"{key}: found {self.raw[key]!r}, expected {_EXPECTED.get(key, f'a section, [{key}]')}"

    def sections(self, registry: Registry) -> Sections:
        """Validate every section."""
        self.registry = registry
        self.expand_preset()
        sun = self.plain("sun", Sun)
        potentials = self.potentials()
        bodies = self.each("body", "body", lambda path, table: self.placed(path, table, BODY_WAYS))
        streams = self.streams()
        data = self.each("data", "datum", lambda path, table: self.component(path, "data", table))
        integrator = self.component("integrator", "integrator", self.raw.get("integrator", {}))
        likelihood = self.plain("likelihood", Likelihood)
        sampler, engine = self.sampler(self.raw.get("sampler", {})), self.plain("engine", Engine)
        self.stop()
        self.errors += drag_unknown(potentials.values(), integrator.cls, self.registry.entries["integrator"])
        self.errors += unfit_for_lookback(potentials.values(), integrator, streams.values())
        sections = Sections(
            self.raw.get("seed", 0), sun, potentials, bodies, streams, data, integrator, likelihood, sampler, engine
        )  # fmt: skip
        self.errors += [*not_there(sections), *misplaced(sections)]
        for name in sections.sampler.priors:
            self.refuse(f"sampler.{name}: takes no prior: give a plain value")
        free = sum(len(section.priors) for section in sections.all)
        if free and (reason := sections.sampler.centre.reject_dimension(free)):
            self.refuse(f"sampler.{reason}")
        self.stop()
        return sections

    def plain(self, path: str, cls: type[Any]) -> Any:
        """Validate a section without a kind."""
        return read_section(path, cls, self.raw.get(path, {}), self.errors, f"[{path}]")

    def kind(self, role: str, path: str, table: dict[str, Any]) -> Any:
        """Look up the class that a table names."""
        kind = table.get("kind", DEFAULT_KIND.get(role))
        self.registry = self.registry.having(role, kind)
        if kind is None:
            kinds = ", ".join(sorted(self.registry.entries[role]))
            return self.refuse(f"{path}: 'kind' is missing; it names the {role}. Installed: {kinds}.")
        try:
            return self.registry.find(role, kind, f"{path}.kind")
        except SpecError as error:
            return self.refuse(str(error))

    def component(self, path: str, role: str, table: Any) -> Any:
        """Validate the section of a component."""
        if table is None:
            return self.refuse(f"the section [{path}] is missing")
        if not isinstance(table, dict):
            return self.refuse(f"{path}: found {table!r}, expected a section, [{path}]")
        cls = self.kind(role, path, table)
        if cls is None:
            return None
        fields = {key: value for key, value in table.items() if key != "kind"}
        try:
            cls = cls.for_section(fields)
        except ValueError as error:
            return self.refuse(f"{path}: {error}")
        return read_section(path, cls, fields, self.errors, f"the {role} {cls.kind!r}", (), self.files)

    def sampler(self, table: dict[str, Any]) -> Any:
        """Validate the sampler; an error for a field of another sampler names that sampler."""
        before = len(self.errors)
        section = self.component("sampler", "sampler", table)
        for i in range(before, len(self.errors)):
            name = self.errors[i].partition(":")[0].removeprefix("sampler.")
            owners = [
                kind for kind, entry in self.registry.entries["sampler"].items() if name in entry.cls.model_fields
            ]
            if owners and "has no field" in self.errors[i]:
                self.errors[i] += f" {name!r} is a field of the sampler {owners[0]!r}."
        return section

    def expand_preset(self) -> None:
        """Replace the name of a published model by its named potentials."""
        table = self.raw.get("potential", {})
        if "preset" not in table:
            return
        name, sections = table["preset"], {k: v for k, v in table.items() if k != "preset"}
        self.registry = self.registry.having_preset(name)
        presets = self.registry.presets
        plain = [key for key, value in sections.items() if not isinstance(value, dict)]
        if not isinstance(name, str) or name not in presets:
            self.refuse(
                f"potential.preset: no model is called {name!r}.{nearest(str(name), presets)} "
                f"Installed: {', '.join(presets)}."
            )
            sections = {}
        elif plain:
            self.refuse(
                f"potential.{plain[0]}: found {sections[plain[0]]!r} beside a preset, expected a section "
                f"[potential.NAME]: {name} has {', '.join(presets[name].sections)}"
            )
        else:
            sections = presets[name].merged_with(sections)
        self.stop()
        self.preset = {"preset": name}
        self.raw["potential"] = sections

    def potentials(self) -> Any:
        """Validate the host: one potential, or several by name."""
        table = self.raw.get("potential", {})
        named = [
            key
            for key, value in table.items()
            if isinstance(value, dict) and ("kind" in value or not ("kind" in table or PRIORS.keys() & value.keys()))
        ]
        if not named:
            return {"potential": self.component("potential", "potential", self.raw.get("potential"))}
        return self.named("potential", "potential", table, named)

    def named(self, path: str, role: str, table: dict[str, Any], named: list[str]) -> Any:
        """Validate several components that add up, each in a section with its name."""
        several = f"{role}s"
        if "kind" in table:
            return self.refuse(
                f"{path}: found a kind of its own and the named {several} {', '.join(named)}; expected one "
                f"{role} in [{path}], or only named ones, each in its own [{path}.NAME]"
            )
        out: dict[str, Section[Any]] = {}
        for key, value in table.items():
            where = f"{path}.{key}"
            if not isinstance(value, dict):
                self.refuse(
                    f"{where}: found {value!r} beside the named {several} {', '.join(named)}; expected a section "
                    f"[{where}] with a kind"
                )
            elif not self.dotted(where, key, role):
                out[key] = self.component(where, role, value)
        return out

    def dotted(self, path: str, name: str, what: str) -> bool:
        """Refuse a name with a dot: paths are made of names and dots."""
        if "." in name:
            article = "an" if what[0] in "aeiou" else "a"
            self.refuse(f"{path}: the name of {article} {what} may not contain a dot")
        return "." in name

    def streams(self) -> Any:
        """Validate the streams: the one that the run file does not name, or several by name."""
        tables = self.stream_tables
        tables.read(self.raw, self.name, self.files.folder)
        if not tables:
            of_host_alone = self.raw.get("data") and not self.raw.keys() & set(OF_A_STREAM)
            return {} if of_host_alone else {ONLY: self.stream("", self.raw)}
        if tables.errors:  # a misspelt section would be missing in every stream
            return self.errors.extend(tables.errors)
        tables.fill(self.raw.pop(DEFAULTS, {}), self.fields_of)
        self.raw.pop("streams", None)
        self.raw["stream"] = tables.tables
        self.errors += tables.errors
        return {name: self.stream(f"stream.{name}.", table) for name, table in tables.tables.items()}

    def fields_of(self, section: str, own: Mapping[str, Any], table: Mapping[str, Any]) -> list[str] | None:
        """Return the fields that a section of a stream may have; None if its kind is not known.

        ``table`` has the kind. The stream's ``own`` table decides in which coordinates the progenitor is given.
        """
        role = "potential" if section == "progenitor" else section
        kind = table.get("kind", DEFAULT_KIND.get(role))
        self.registry = self.registry.having(role, kind)
        try:
            cls = self.registry.find(role, kind, section)
            cls = cls.for_section({key: value for key, value in table.items() if key in cls.model_fields})
        except (SpecError, ValueError):
            return None
        if section != "progenitor":
            return ["kind", *cls.model_fields]
        names = [name for name in cls.model_fields if name not in HOST_ALONE]
        try:
            ways: Sequence[Any] = [choose_coordinates(own.keys() - {*names}, names)]
        except ValueError:
            ways = WAYS
        return ["kind", *names, *OTHER_NAMES, *(name for way in ways for name in way.model_fields)]

    def stream(self, prefix: str, table: dict[str, Any]) -> StreamSections:
        """Validate the sections of one stream."""
        satellite, phase = self.placed(f"{prefix}progenitor", table.get("progenitor"), WAYS)
        stripping = self.component(f"{prefix}stripping", "stripping", table.get("stripping"))
        return StreamSections(satellite, phase, stripping, self.observables(f"{prefix}observable", table))

    def observables(self, path: str, table: dict[str, Any]) -> Any:
        """Validate the observables of a stream: none, one, or several by name."""
        if "observable" not in table:
            return {}
        given = table["observable"]
        named = (
            [key for key, value in given.items() if isinstance(value, dict) and "kind" in value]
            if isinstance(given, dict)
            else []
        )
        if named:
            return self.named(path, "observable", given, named)
        return {"observable": self.component(path, "observable", given)}

    def each(self, section: str, what: str, read: Callable[[str, Any], Any]) -> Any:
        """Validate the data or the bodies: each has a section with its name, which ``read`` validates by its path."""
        table = self.raw.get(section, {})
        if "kind" in table:
            return self.refuse(f"{section}: found a kind, expected a section [{section}.NAME] for each")
        names = [name for name in table if not self.dotted(f"{section}.{name}", name, what)]
        return {name: read(f"{section}.{name}", table[name]) for name in names}

    def placed(self, path: str, table: Any, ways: Any) -> tuple[Any, Any]:
        """Validate the progenitor or a body: its potential, and its position and velocity today."""
        if table is None:
            return self.refuse(f"the section [{path}] is missing"), None
        if not isinstance(table, dict):
            return self.refuse(f"{path}: found {table!r}, expected a section [{path}] with a kind"), None
        for other, name in OTHER_NAMES.items():
            if {other, name} <= table.keys():
                return self.refuse(f"{path}: found {name} and {other}, two names of one number: give one"), None
        renamed = {OTHER_NAMES.get(key, key): value for key, value in table.items()}
        table.clear()  # in place: the resolved run file keeps the order of the keys
        table.update(renamed)
        progenitor, cls = ways is WAYS, self.kind("potential", path, table)
        if cls is None:
            return None, None
        if TABLE in table and not progenitor and TABLE not in cls.model_fields:
            return read_body_table(path, cls, table, self.errors, self.files)
        try:
            cls = cls.for_section(own_keys(table, ways))
        except ValueError as error:
            return self.refuse(f"{path}: {error}"), None
        if reason := no_part_of_a_host(path, cls):
            return self.refuse(reason), None
        names = tuple(name for name in cls.model_fields if name not in HOST_ALONE)
        fields = {key: value for key, value in table.items() if key in names}
        rest = {key: value for key, value in table.items() if key not in ("kind", *names)}
        before = len(self.errors)
        potential = read_section(path, cls, fields, self.errors, f"the potential {cls.kind!r}", (), self.files, False)
        if reason := massless(path, cls, potential, progenitor):
            self.errors[before:] = [reason]  # its fields do not matter then
            return None, None
        if not progenitor and ENCOUNTER in rest:
            return potential, read_encounter(path, rest, self.errors)
        try:
            way = choose_coordinates(rest, names, ways)
        except ValueError as error:
            return potential, self.refuse(f"{path}: {error}")
        called = f"the {'progenitor' if progenitor else 'body'} ({cls.kind}, {way.title})"
        return potential, read_section(path, way, rest, self.errors, called, names)


def _plain_values(value: Any) -> Any:
    """Copy the mapping with plain Python containers and numbers; quantities stay."""
    if isinstance(value, Mapping):
        return {str(key): _plain_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain_values(item) for item in value]
    if isinstance(value, np.ndarray) and hasattr(value, "unit") and value.shape:
        return [f"{number!r} {value.unit}" for number in np.asarray(value, dtype=float).tolist()]
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and not hasattr(value, "unit")):
        return value.tolist()
    return str(value) if isinstance(value, Path) else value


def _document(raw: dict[str, Any], plugins: list[str], sections: Sections, preset: dict[str, str]) -> dict[str, Any]:
    """Fill in every default; keys of the run file keep their order and come first."""
    tables: dict[str, dict[str, Any]] = {}
    for section in sections.all:
        table = tables.setdefault(section.path, {})
        if issubclass(section.cls, Component):
            table["kind"] = section.cls.kind
        table.update(section.document())
        if issubclass(section.cls, Sampler):  # its own settings stand before those of all samplers
            table = tables[section.path] = dict(sorted(table.items(), key=lambda item: item[0] in Sampler.model_fields))
    filled: dict[str, Any] = {}
    for path, table in tables.items():
        *above, name = path.split(".")
        given = reduce(lambda inner, key: inner.get(key, {}), (*above, name), raw)
        place = reduce(lambda inner, key: inner.setdefault(key, {}), above, filled)
        place[name] = {key: table[key] for key in dict.fromkeys(("kind", *given, *table)) if key in table}
    filled["potential"] = preset | filled["potential"]
    document: dict[str, Any] = {"version": VERSION, "seed": sections.seed} | ({"plugins": plugins} if plugins else {})
    if "engine" not in raw:  # the samples do not depend on it
        del filled["engine"]
    return document | {key: filled[key] for key in dict.fromkeys((*raw, *filled)) if key in filled}
