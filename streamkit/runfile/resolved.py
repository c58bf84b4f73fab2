"""A validated run file as a document: its settings, its numbers by their paths, changed copies, its text and digest."""

from __future__ import annotations

import copy
import functools
import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from streamkit.components import Component, Registry, Sampler
from streamkit.errors import SpecError, nearest
from streamkit.runfile.document import moved, paths_in, to_toml
from streamkit.runfile.factors import Factor, factors_of, part, parts_of
from streamkit.runfile.inputs import ONLY
from streamkit.runfile.priors import Prior
from streamkit.runfile.progenitor import OTHER_NAMES, Place
from streamkit.runfile.reader import DEFAULT_KIND
from streamkit.runfile.section import Section, at_default, lacked
from streamkit.runfile.sections import Sections
from streamkit.runfile.settings import Engine, Likelihood
from streamkit.runfile.stream_tables import DEFAULTS
from streamkit.units import Unit, symbol_of, unit_of

EVERY = "stream.*."  # how the path of a field in all streams begins


@dataclass(frozen=True, eq=False, repr=False)
class Resolved(ABC):
    """A validated run file as a document. `Spec` adds its free parameters, and binds it to their values.

    Attributes
    ----------
    document
        The run file with every default filled in and quantities as text, for TOML and JSON.
    source
        Name of the file, for messages.
    registry
        The components it was validated with.
    sections
        The validated sections.
    folder
        The folder that the paths of its plugin files and data files are relative to.
    files
        The data files by their names in the run file, with the SHA-256 of their contents.
    given
        Component classes that were given in Python.
    """

    document: dict[str, Any]
    source: str
    registry: Registry
    sections: Sections
    folder: Path
    files: Mapping[str, str]
    given: tuple[type[Component], ...] = ()

    @abstractmethod
    def _changed(self, document: dict[str, Any]) -> Self:
        """Return the run file with another document, validated again."""

    @property
    def seed(self) -> int:
        """The seed of every random draw of the model."""
        return self.sections.seed

    @property
    def sampler(self) -> Sampler:
        """The sampler with its settings."""
        return self.sections.sampler.centre

    @property
    def likelihood(self) -> Likelihood:
        """The settings of the likelihood."""
        return self.sections.likelihood.centre

    @property
    def engine(self) -> Engine:
        """Where a run makes its calls."""
        return self.sections.engine.centre

    @cached_property
    def _fields(self) -> dict[str, tuple[Unit, Prior | None, str]]:
        """Unit, prior and symbol of every physical number by its path, in the order of the run file."""
        fields = {}
        for section in self.sections.all:
            owner = self._owner(section)
            for name, field in section.cls.model_fields.items():
                if (unit := unit_of(field)) is not None:
                    path = f"{section.path}.{name}"
                    fields[path] = unit, section.priors.get(name), symbol_of(name, field, owner) or path
            for name, unit in section.entries().items():
                fields[f"{section.path}.{name}"] = unit, section.priors.get(name), f"{section.path}.{name}"
        return {path: fields[path] for path in paths_in(self.document) if path in fields}

    def _owner(self, section: Section[Any]) -> str:
        """Return the index that the symbols of a section's fields get: the name of their owner."""
        top, _, name = section.path.partition(".")
        stream = name.partition(".")[0] if top == "stream" else ""
        satellite = any(section is stream.satellite for stream in self.sections.streams.values())
        return ",".join(filter(None, ("sat" if satellite else "", stream))) if stream or satellite else name

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Free parameters as paths into the run file, in its order."""
        return tuple(path for path, (_, prior, _) in self._fields.items() if prior is not None)

    @property
    def streams(self) -> tuple[str, ...]:
        """The names of the streams; a single one without a name is called ``stream``."""
        return tuple(self.sections.streams)

    def stream_name(self, given: str | None = None) -> str:
        """Return the name of a stream, which may be left out where there is one; a `SpecError` lists the names."""
        if given is None and len(self.streams) == 1:
            return self.streams[0]
        if given not in self.streams:
            if not self.streams:
                raise SpecError(f"{self.source}: there is no stream: the run file has data on the host alone")
            problem = "no name of a stream" if given is None else f"no stream is called {given!r}"
            guess = "" if given is None else nearest(given, self.streams)
            raise SpecError(f"{self.source}: {problem}.{guess} Streams: {', '.join(self.streams)}.")
        return given

    def path_of(self, path: str) -> str:
        """Return the path by the name of its field in the resolved run file: ``progenitor.v_los``."""
        section, _, name = path.rpartition(".")
        places = {each.path for each in self.sections.all if issubclass(each.cls, Place)}
        return f"{section}.{OTHER_NAMES[name]}" if section in places and name in OTHER_NAMES else path

    def by_path(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return values by `path_of` their names; those of ``stream.*.`` for every stream that has no value of its own.

        Raises SpecError for two names of one field.
        """
        every = [path for path in values if path.startswith(EVERY)]
        own = {path: value for path, value in values.items() if path not in every}
        values = {f"stream.{name}.{path.removeprefix(EVERY)}": values[path] for path in every for name in self.streams}
        values |= own
        paths = {path: self.path_of(path) for path in values}
        for path, name in paths.items():
            if name != path and name in values:
                raise SpecError(f"{self.source}: found {name} and {path}, two names of one number: give one")
        return {paths[path]: value for path, value in values.items()}

    def prefix(self, stream: str | None = None) -> str:
        """Return the prefix of the paths of a stream's sections: ``stream.gd1.``; empty for a stream without a name."""
        name = self.stream_name(stream)
        return f"stream.{name}." if name != ONLY else ""

    @cached_property
    def factors(self) -> tuple[Factor, ...]:
        """The parts of the likelihood that depend on the host and on parameters of their own: streams, host's data."""
        return factors_of(self.names, self.streams, self.sections.data, self.sections.met)

    @cached_property
    def parts(self) -> tuple[Factor, ...]:
        """Each stream, of one or of several, and the data of the host, with the parameters that decide them."""
        return parts_of(self.names, self.streams, self.sections.data, self.sections.met)

    def only(self, *streams: str, data: bool = True, observables: bool = True) -> Self:
        """Return the spec with these of its streams alone, with ``data`` of the host or without; SpecError for a name.

        Its digest does not change when the run file gets another stream: other streams and their files are left out.
        Without ``observables`` the data of the host alone are left.
        """
        document = part(self.document, [self.stream_name(each) for each in streams or self.streams], data, observables)
        return self._changed(document)

    def with_particles(self, most: int) -> Self:
        """Return the spec with at most so many particles in each stream."""
        now = {name: stream.stripping.centre.particles for name, stream in self.sections.streams.items()}
        return self.with_values(
            {f"{self.prefix(name)}stripping.particles": min(count, most) for name, count in now.items()}
        )

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """Return the spec with some fields replaced, validated as in the file.

        Parameters
        ----------
        values
            Path -> number, quantity, prior or other value: ``{"progenitor.mass": "6.4e8 Msun"}``. A path such as
            ``stream.*.stripping.particles`` sets the field in all streams. A new ``kind`` keeps the fields that it has
            too, unless at the old one's default. Raises SpecError for a value not allowed.
        """
        document = copy.deepcopy(self.document)
        values = self.by_path(values)
        for path in values:
            self._check_path(path, values)
        for section in [each for each in self.sections.all if f"{each.path}.kind" in values]:
            table = functools.reduce(lambda inner, key: inner.get(key, {}), section.path.split("."), document)
            for name in [*at_default(section), *lacked(section, values, self.registry)]:
                table.pop(name, None)  # there may be no section [engine]
        for path, value in values.items():
            *tables, name = path.split(".")
            table = functools.reduce(_inner, tables, document)
            table[int(name) if isinstance(table, list) else name] = value
        return self._changed(document)

    def dropped_by(self, values: Mapping[str, Any]) -> list[str]:
        """Return the paths of the fields that the run file sets and that a new ``kind`` in ``values`` lacks."""
        values = self.by_path(values)
        return [f"{each.path}.{name}" for each in self.sections.all for name in lacked(each, values, self.registry)]

    def with_sampler(self, kind: str) -> Self:
        """Return the spec with another sampler, with its default settings; SpecError if there is none of this kind."""
        if kind == self.sampler.kind:
            return self
        document = {**copy.deepcopy(self.document), "sampler": {"kind": kind}}
        return self._changed(document)

    def with_host(self, potential: Mapping[str, Any]) -> Self:
        """Return the spec with another section ``potential``; SpecError if it is not valid."""
        return self._changed({**copy.deepcopy(self.document), "potential": copy.deepcopy(dict(potential))})

    def _check_path(self, path: str, values: Mapping[str, Any]) -> None:
        parent = path.rpartition(".")[0]
        without = [
            self.prefix(name) + "observable" for name, stream in self.sections.streams.items() if not stream.observables
        ]
        tables = [section.path for section in self.sections.all] + without
        paths = [f"{s.path}.{name}" for s in self.sections.all for name in s.cls.model_fields]
        paths += [f"{s.path}.{name}" for s in self.sections.all for name in s.entries()]
        paths += ["seed", *(f"{table}.kind" for table in tables)]
        renewed = f"{parent}.kind" in values or parent in without
        if path not in paths and not (renewed and parent in tables):
            shared = path.partition(".")
            hint = f" For all streams: {EVERY}{shared[2]}." if shared[0] == DEFAULTS else nearest(path, paths)
            hint = hint or f" Sections: {', '.join(dict.fromkeys(tables))}."
            raise SpecError(f"{self.source}: there is no field {path!r}.{hint}")

    def components(self) -> list[tuple[str, type[Component], str]]:
        """Return path, class and supplier of every component in use."""
        used = [s for s in self.sections.all if issubclass(s.cls, Component)]
        return [(section.path, section.cls, self.registry.supplier(section.cls)) for section in used]

    def digest(self, suppliers: Mapping[str, str] | None = None, sampler: bool = True) -> str:
        """Return the SHA-256 of all that determines a run: the document without limits and engine, and the suppliers.

        Without ``sampler`` it is that of all that determines the posterior: calls of other samplers are the same.

        Data files count by their contents. Components at the paths in ``suppliers`` count as supplied by these: so a
        later version finds the digest that an earlier one noted.
        """
        document = self.with_files_at({name: f"sha256:{digest}" for name, digest in self.files.items()})
        physics = {k: v for k, v in document.items() if k not in ("plugins", "engine")}
        physics["potential"] = {k: v for k, v in physics["potential"].items() if k != "preset"}  # all numbers are there
        physics["sampler"] = {k: v for k, v in physics["sampler"].items() if k not in self.sampler.resumable_fields()}
        noted = suppliers or {}
        components = [[path, cls.kind, noted.get(path, supplier)] for path, cls, supplier in self.components()]
        if self.sampler.kind == DEFAULT_KIND["sampler"]:
            # Run directories from before there were other samplers do not name this one: their digests stay valid.
            del physics["sampler"]["kind"]
            components = [each for each in components if each[0] != "sampler"]
        if not sampler:
            del physics["sampler"]
            components = [each for each in components if each[0] != "sampler"]
        text = json.dumps([physics, self.names, components], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def with_files_at(self, places: Mapping[str, str]) -> dict[str, Any]:
        """Return the document with other paths of its data files, by those that the run file has."""
        kept = {key: value for key, value in self.document.items() if key == "plugins" or not self.files}
        return {key: kept.get(key, moved(value, places)) for key, value in self.document.items()}

    def toml(self) -> str:
        """Return the resolved run file as TOML."""
        head = [f"Resolved from {Path(self.source).name}: every default filled in."]
        used = [f"{path}: {cls.kind} ({supplier})" for path, cls, supplier in self.components()]
        return to_toml(self.document, "\n".join([*head, *used]))


def _inner(table: Any, key: str) -> Any:
    """Return what is at a key of a table, or at a number of a list; a new table if there is none."""
    return table[int(key)] if isinstance(table, list) else table.setdefault(key, {})
