"""From the mapping in a run file to validated sections: the class of each, and every error collected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from streamkit.components import Component, Integrator, Observable, Potential, Registry, Stripping, load_registry
from streamkit.errors import PluginError, SpecError, nearest
from streamkit.spec.priors import KINDS
from streamkit.spec.progenitor import PhaseSpace, Sun, choose_coordinates
from streamkit.spec.section import Section, read_section
from streamkit.spec.sentences import unknown_field
from streamkit.spec.settings import Likelihood, Sampler

VERSION = 1
"""The version of the run file that this streamkit writes and reads."""

COMPONENTS = ("potential", "progenitor", "stripping", "integrator", "observable")
SECTIONS = ("sun", *COMPONENTS, "likelihood", "sampler")
KEYS = ("version", "seed", "plugins", *SECTIONS)
DEFAULT_KIND = {"integrator": "adaptive", "observable": "apocentres"}

M = TypeVar("M", bound=BaseModel)


@dataclass(frozen=True)
class Parts:
    """The validated sections of a run file."""

    seed: int
    sun: Section[Sun]
    potentials: dict[str, Section[Potential]]
    satellite: Section[Potential]
    phase: Section[PhaseSpace]
    stripping: Section[Stripping]
    integrator: Section[Integrator]
    observable: Section[Observable] | None
    likelihood: Likelihood
    sampler: Sampler

    @property
    def sections(self) -> list[Section[Any]]:
        """Those whose fields can be set, in the default order."""
        middle: list[Section[Any]] = [self.satellite, self.phase, self.stripping, self.integrator]
        last: list[Section[Any]] = [self.observable] if self.observable else []
        plain = [_plain("likelihood", self.likelihood), _plain("sampler", self.sampler)]
        return [self.sun, *self.potentials.values(), *middle, *last, *plain]


def _plain(path: str, instance: BaseModel) -> Section[Any]:
    return Section(path, type(instance), {}, {}, instance)


def resolve(
    source: Mapping[str, Any], name: str, registry: Registry | None, folder: Path
) -> tuple[dict[str, Any], str, Registry, Parts]:
    """Validate the mapping of a run file; return the resolved document, its name, registry and sections.

    The paths of plugin files are relative to ``folder``, and stay as they are written.

    Raises
    ------
    SpecError
        With every error on a line of its own.
    """
    reader = _Reader(name, _plain_values(source))
    files = reader.head()
    if registry is None:
        try:
            registry = load_registry((folder / file).resolve() for file in files)
        except SpecError as error:
            raise SpecError(f"{name}: {error}") from None
        except PluginError as error:
            raise PluginError(f"{name}: {error}") from error.__cause__
    parts = reader.parts(registry)
    return _document(reader.raw, files, parts), name, registry, parts


class _Reader:
    """Collects the errors of one run file, so that all of them are told at once."""

    def __init__(self, name: str, raw: dict[str, Any]) -> None:
        self.name, self.raw = name, raw
        self.errors: list[str] = []

    def head(self) -> list[str]:
        """Check what stands outside the sections; return the plugin files as written."""
        raw, say = self.raw, self.errors.append
        if not raw:
            say("the run file is empty; it needs at least the sections potential, progenitor and stripping")
            self.stop()
        version = raw.get("version", VERSION)
        if type(version) is int and version > VERSION:
            say(f"this run file is of version {version}, this streamkit reads {VERSION}: upgrade streamkit")
            self.stop()
        if type(version) is not int or version < 1:
            say(f"version: found {version!r}, expected {VERSION}")
        seed = raw.get("seed", 0)
        if type(seed) is not int or seed < 0:
            say(f"seed: found {seed!r}, expected a whole number, zero or more")
        for key, value in raw.items():
            if key not in KEYS:
                say(f"{key}: no section or key of a run file.{nearest(key, KEYS)} Allowed: {', '.join(KEYS)}.")
            elif key in SECTIONS and not isinstance(value, dict):
                say(f"{key}: found {value!r}, expected a section, [{key}]")
        files: Any = raw.get("plugins", [])
        if not isinstance(files, list) or not all(isinstance(file, str) for file in files):
            say(f'plugins: found {files!r}, expected a list of Python files, such as ["my_halo.py"]')
        else:
            names = [Path(file).name for file in files]
            for name in sorted({name for name in names if names.count(name) > 1}):
                say(f"plugins: found two files called {name!r}, expected one of each name")
        self.stop()
        return list(files)

    def stop(self) -> None:
        """Raise what was collected."""
        if self.errors:
            raise SpecError("\n".join(f"{self.name}: {error}" for error in self.errors))

    def parts(self, registry: Registry) -> Parts:
        """Validate every section."""
        self.registry = registry
        sun = self.plain("sun", Sun)
        potentials = self.potentials()
        satellite, phase = self.progenitor()
        stripping = self.component("stripping", "stripping")
        integrator = self.component("integrator", "integrator", self.raw.get("integrator", {}))
        observable = self.component("observable", "observable") if "observable" in self.raw else None
        likelihood, sampler = self.plain("likelihood", Likelihood), self.plain("sampler", Sampler)
        self.stop()
        assert sun is not None  # noqa: S101  stop() has raised otherwise; so for the others
        assert satellite is not None  # noqa: S101
        assert stripping is not None  # noqa: S101
        assert integrator is not None  # noqa: S101
        assert phase is not None  # noqa: S101
        assert likelihood is not None  # noqa: S101
        assert sampler is not None  # noqa: S101
        parts = Parts(
            self.raw.get("seed", 0), sun, potentials, satellite, phase, stripping, integrator, observable,
            likelihood.centre, sampler.centre,
        )  # fmt: skip
        free = sum(len(section.priors) for section in parts.sections)
        if sampler.centre.walkers < 2 * free:
            self.errors.append(
                f"sampler.walkers: found {sampler.centre.walkers}, expected at least {2 * free}, "
                f"twice the number of free parameters"
            )
        self.stop()
        return parts

    def plain(self, path: str, cls: type[M]) -> Section[M] | None:
        """Validate a section without a kind."""
        return read_section(path, cls, self.raw.get(path, {}), self.errors, f"[{path}]")

    def kind(self, role: str, path: str, table: dict[str, Any]) -> type[Any] | None:
        """Look up the class that a table names."""
        kind = table.get("kind", DEFAULT_KIND.get(path))
        if kind is None:
            known = ", ".join(sorted(self.registry.entries[role]))
            self.errors.append(f"{path}: 'kind' is missing; it names the {role}. Installed: {known}.")
            return None
        try:
            return self.registry.find(role, kind, f"{path}.kind")
        except SpecError as error:
            self.errors.append(str(error))
            return None

    def component(self, path: str, role: str, table: dict[str, Any] | None = None) -> Section[Any] | None:
        """Validate a section whose class its kind names."""
        if table is None:
            table = self.raw.get(path)
        if table is None:
            self.errors.append(f"the section [{path}] is missing")
            return None
        cls = self.kind(role, path, table)
        if cls is None:
            return None
        fields = {key: value for key, value in table.items() if key != "kind"}
        return read_section(path, cls, fields, self.errors, f"the {role} {cls.kind!r}")

    def potentials(self) -> dict[str, Section[Potential]]:
        """Validate the host: one potential, or several by name."""
        table = self.raw.get("potential")
        tables = {k: v for k, v in (table or {}).items() if isinstance(v, dict)}
        named = {k: v for k, v in tables.items() if "kind" in v}
        if not named and table is not None and "kind" not in table:
            named = {k: v for k, v in tables.items() if not KINDS.keys() & v.keys()}
        if table is None or "kind" in table or not named:
            if named:
                self.errors.append(
                    f"potential: found a kind of its own and the named potentials {', '.join(named)}; "
                    "expected one potential in [potential], or only named ones, each in its own "
                    "[potential.NAME]"
                )
                return {}
            single = self.component("potential", "potential")
            return {"potential": single} if single else {}
        out: dict[str, Section[Potential]] = {}
        for key, value in table.items():
            path = f"potential.{key}"
            if not isinstance(value, dict):
                self.errors.append(
                    f"{path}: found {value!r} beside the named potentials {', '.join(named)}; expected "
                    f"a section [{path}] with a kind"
                )
            elif "." in key:
                self.errors.append(f"{path}: the name of a potential may not contain a dot")
            elif section := self.component(path, "potential", value):
                out[key] = section
        return out

    def progenitor(self) -> tuple[Section[Potential] | None, Section[PhaseSpace] | None]:
        """Validate the progenitor: its own potential, and its place today."""
        table = self.raw.get("progenitor")
        if table is None:
            self.errors.append("the section [progenitor] is missing")
            return None, None
        cls = self.kind("potential", "progenitor", table)
        if cls is None:
            return None, None
        unit = cls.parameters().get("mass")
        if unit is None or unit.name != "Msun":
            self.errors.append(
                f"progenitor.kind: the potential {cls.kind!r} has no field 'mass' in Msun, which the tidal "
                "radius of a progenitor needs; plummer has one"
            )
            return None, None
        own = {key: value for key, value in table.items() if key in cls.model_fields}
        rest = {key: value for key, value in table.items() if key not in own and key != "kind"}
        satellite = read_section("progenitor", cls, own, self.errors, f"the potential {cls.kind!r}")
        try:
            way = choose_coordinates(rest, cls.model_fields)
        except ValueError as error:
            self.errors.append(f"progenitor: {error}")
            return satellite, None
        for key in [key for key in rest if key not in way.model_fields]:
            called = f"the progenitor ({cls.kind}, {way.title})"
            self.errors.append(unknown_field(f"progenitor.{key}", key, way, called, tuple(cls.model_fields)))
            del rest[key]
        return satellite, read_section("progenitor", way, rest, self.errors)


def _plain_values(value: Any) -> Any:
    """Copy the mapping with plain Python containers and numbers; quantities stay."""
    if isinstance(value, Mapping):
        return {str(key): _plain_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain_values(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return str(value) if isinstance(value, Path) else value


def _document(raw: dict[str, Any], files: list[str], parts: Parts) -> dict[str, Any]:
    """Fill in every default; what the run file gave keeps its order and comes first."""
    filled: dict[str, dict[str, Any]] = {}
    for section in parts.sections:
        top, *name = section.path.split(".", 1)
        table = filled.setdefault(top, {})
        if name:
            table = table.setdefault(name[0], {})
        if issubclass(section.cls, Component):
            table["kind"] = section.cls.kind
        table.update(section.document())
    document: dict[str, Any] = {"version": VERSION, "seed": parts.seed}
    if files:
        document["plugins"] = files
    order = [key for key in raw if key in filled] + [key for key in filled if key not in raw]
    return document | {key: _ordered(filled[key], raw.get(key, {})) for key in order}


def _ordered(table: dict[str, Any], raw: dict[str, Any]) -> dict[str, Any]:
    keys = [key for key in raw if key in table] + [key for key in table if key not in raw]
    keys.sort(key=lambda key: key != "kind")
    nested = isinstance(table.get("kind", {}), dict)
    return {
        key: _ordered(table[key], raw[key])
        if nested and isinstance(table[key], dict) and "kind" in table[key] and isinstance(raw.get(key), dict)
        else table[key]
        for key in keys
    }
