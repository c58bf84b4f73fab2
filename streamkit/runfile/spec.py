"""The run file: read, validated with the installed components, and bound to parameter values."""

from __future__ import annotations

import copy
import functools
import hashlib
import inspect
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from streamkit.components import Component, Potential, Registry, Sampler
from streamkit.errors import PluginError, SpecError, nearest
from streamkit.fields import Files
from streamkit.runfile.document import moved, paths_in, read_toml, to_toml
from streamkit.runfile.factors import Factor, factors_of, part
from streamkit.runfile.inputs import ONLY, ModelInputs, StreamInputs
from streamkit.runfile.priors import Prior
from streamkit.runfile.progenitor import OTHER_NAMES, Place
from streamkit.runfile.reader import DEFAULT_KIND, resolve
from streamkit.runfile.section import Section, at_default, lacked
from streamkit.runfile.sections import Sections
from streamkit.runfile.settings import Engine, Likelihood
from streamkit.stream import Array
from streamkit.units import Unit, symbol_of, unit_of


@dataclass(frozen=True, eq=False, repr=False)
class Spec:
    """A validated run file.

    It pickles as its document, and unpickling looks up the components again; classes given in Python pickle by
    reference.

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

    def __repr__(self) -> str:
        streams = "" if self.streams == (ONLY,) else f" with the streams {', '.join(self.streams)}"
        return f"<Spec of {Path(self.source).name}{streams}; free: {', '.join(self.names) or 'none'}>"

    def __reduce__(self) -> tuple[Any, ...]:
        hidden = [cls.__qualname__ for cls in self.given if "<locals>" in cls.__qualname__]
        if hidden:
            raise PluginError(
                f"{', '.join(hidden)}: a class defined inside a function cannot be sent to an executor's processes. "
                "Define it at the top level of a module, or in a file that the run file names under plugins; or give "
                "`workers` a number."
            )
        return _make, (self.document, self.source, None, self.folder, self.given, self.files)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Spec) and all(
            getattr(self, name) == getattr(other, name) for name in ("document", "names", "files")
        )

    def __hash__(self) -> int:
        return hash(self.digest())

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

    @cached_property
    def priors(self) -> tuple[Prior, ...]:
        """The priors of the free parameters."""
        return tuple(prior for _, prior, _ in self._fields.values() if prior is not None)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """The units of the free parameters, as astropy reads them; '' for none."""
        return tuple(self._fields[name][0].name for name in self.names)

    @cached_property
    def symbols(self) -> tuple[str, ...]:
        """The symbols of the free parameters in TeX, or their paths where a field has none."""
        return tuple(self._fields[name][2] for name in self.names)

    def centre(self) -> Array:
        """(d,) The centres of the priors."""
        return np.array([prior.centre for prior in self.priors])

    def bind(self, theta: Array | Mapping[str, Any] | None = None, stream: str | None = None) -> StreamInputs:
        """Return the components of one stream at the given parameters.

        Parameters
        ----------
        theta
            (d,) values in the order of `names`, or some of them by name (numbers or quantities; the others
            take the centre of their prior), or None for all centres.
        stream
            The name of the stream; may be left out where there is one.

        Raises OutOfDomain if a value breaks the constraint of its field; a wrong name or number of values is a
        `SpecError`.
        """
        name = self.stream_name(stream)
        return self.bind_all(theta).streams[name]

    @property
    def streams(self) -> tuple[str, ...]:
        """The names of the streams; a single one without a name is called ``stream``."""
        return tuple(self.sections.streams)

    def stream_name(self, given: str | None = None) -> str:
        """Return the name of a stream, which may be left out where there is one; a `SpecError` lists the names."""
        if given is None and len(self.streams) == 1:
            return self.streams[0]
        if given not in self.streams:
            problem = "no name of a stream" if given is None else f"no stream is called {given!r}"
            guess = "" if given is None else nearest(given, self.streams)
            raise SpecError(f"{self.source}: {problem}.{guess} Streams: {', '.join(self.streams)}.")
        return given

    def bind_all(self, theta: Array | Mapping[str, Any] | None = None) -> ModelInputs:
        """Return all streams at the given parameters, and what they share; ``theta`` and errors as for `bind`."""
        return self.sections.bound(self._values(theta))

    def host(self, theta: Array | Mapping[str, Any] | None = None) -> dict[str, Potential]:
        """Return the potentials of the host alone, for a small part of the cost of `bind_all`; arguments as there."""
        return self.sections.host(self._values(theta))

    def _values(self, theta: Array | Mapping[str, Any] | None) -> dict[str, float]:
        theta = {} if theta is None else theta
        if not isinstance(theta, Mapping):
            numbers = np.asarray(theta, dtype=float)
            if numbers.shape != (len(self.names),):
                raise SpecError(
                    f"{self.source}: found parameters of shape {numbers.shape}, expected "
                    f"({len(self.names)},): {', '.join(self.names)}"
                )
            return dict(zip(self.names, numbers.tolist(), strict=True))
        values = dict(zip(self.names, self.centre().tolist(), strict=True))
        for name, value in self.by_path(theta).items():
            if name not in values:
                fixed = " It is fixed in the run file: use with_values." if name in self._fields else ""
                raise SpecError(
                    f"{self.source}: {name!r} is no free parameter.{fixed or nearest(name, self.names)} "
                    f"Free: {', '.join(self.names) or 'none'}."
                )
            try:
                values[name] = float(self._fields[name][0].parse(value))
            except (ValueError, TypeError) as error:
                raise SpecError(f"{self.source}: {name}: {error}") from None
        return values

    def path_of(self, path: str) -> str:
        """Return the path by the name of its field in the resolved run file: ``progenitor.v_los``."""
        section, _, name = path.rpartition(".")
        places = {each.path for each in self.sections.all if issubclass(each.cls, Place)}
        return f"{section}.{OTHER_NAMES[name]}" if section in places and name in OTHER_NAMES else path

    def by_path(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return values by `path_of` their names. Raises SpecError for two names of one field."""
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
        return factors_of(self.names, self.streams, self.sections.data)

    def only(self, *streams: str, data: bool = True, observables: bool = True) -> Spec:
        """Return the spec with these of its streams alone, with ``data`` of the host or without; SpecError for a name.

        Its digest does not change when the run file gets another stream: other streams and their files are left out.
        Without ``observables`` the data of the host alone are left.
        """
        document = part(self.document, [self.stream_name(each) for each in streams or self.streams], data, observables)
        return _make(document, self.source, self.registry, self.folder, self.given, self.files)

    def with_particles(self, most: int) -> Spec:
        """Return the spec with at most so many particles in each stream."""
        now = {name: stream.stripping.centre.particles for name, stream in self.sections.streams.items()}
        return self.with_values(
            {f"{self.prefix(name)}stripping.particles": min(count, most) for name, count in now.items()}
        )

    def with_values(self, values: Mapping[str, Any]) -> Spec:
        """Return the spec with some fields replaced, validated as in the file.

        Parameters
        ----------
        values
            Path -> number, quantity, prior or other value: ``{"progenitor.mass": "6.4e8 Msun"}``. A new ``kind`` keeps
            the fields that it has too, unless at the old one's default. Raises SpecError for a value not allowed.
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
            table = functools.reduce(lambda inner, key: inner.setdefault(key, {}), tables, document)
            table[int(name) if isinstance(table, list) else name] = value
        return _make(document, self.source, self.registry, self.folder, self.given, self.files)

    def dropped_by(self, values: Mapping[str, Any]) -> list[str]:
        """Return the paths of the fields that the run file sets and that a new ``kind`` in ``values`` lacks."""
        values = self.by_path(values)
        return [f"{each.path}.{name}" for each in self.sections.all for name in lacked(each, values, self.registry)]

    def with_sampler(self, kind: str) -> Spec:
        """Return the spec with another sampler, with its default settings; SpecError if there is none of this kind."""
        if kind == self.sampler.kind:
            return self
        document = {**copy.deepcopy(self.document), "sampler": {"kind": kind}}
        return _make(document, self.source, self.registry, self.folder, self.given, self.files)

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
            raise SpecError(f"{self.source}: there is no field {path!r}.{nearest(path, paths)}")

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


def load(
    source: str | Path | Mapping[str, Any],
    registry: Registry | None = None,
    components: Iterable[type[Component]] = (),
) -> Spec:
    """Read and validate a run file, or a mapping of the same form.

    Parameters
    ----------
    source
        Path of a TOML file, or the mapping it would give; numbers may then be astropy quantities too.
    registry
        The components to validate with; by default the installed ones, the file's own ``plugins`` and ``components``.
    components
        Component classes as they are, from a notebook or a script. The hash of their code, and of the functions and
        constants that it names in their module, is in the digest of the run.

    Raises SpecError: Lists every error, one per line: file, path, what was found, what is allowed, the nearest name.
    Raises PluginError if a plugin is broken.
    """
    if isinstance(source, Mapping):
        return _make(source, "run mapping", registry, Path.cwd(), components)
    if not isinstance(source, str | Path):
        raise SpecError(f"found {source!r}, expected a spec, the path of a run file, or a mapping of the same form")
    path = Path(source)
    return _make(read_toml(path), str(path), registry, path.parent.absolute(), components)


# A spec, or its source: itself, the path of a run file, or a mapping of the same form.
Source: TypeAlias = Spec | str | Path | Mapping[str, Any]


def as_spec(source: Source, components: Iterable[type[Component]] = ()) -> Spec:
    """Return a spec as it is, and read whatever else `load` takes; a spec with other components is read again."""
    if not isinstance(source, Spec):
        return load(source, components=components)
    given = tuple(components)
    return _make(source.document, source.source, None, source.folder, given) if given else source


def _make(
    source: Mapping[str, Any],
    name: str,
    registry: Registry | None,
    folder: Path,
    components: Iterable[type[Component]] = (),
    digests: Mapping[str, str] | None = None,
) -> Spec:
    """Read a mapping; SpecError for a data file with another digest than in ``digests``."""
    if inspect.isclass(components) or not isinstance(components, Iterable):
        raise PluginError(f"components: found {components!r}, expected a list of classes, such as [MyPotential]")
    given, files = tuple(components), Files(folder, digests or {})
    document, name, registry, sections = resolve(source, name, registry, files, given)
    return Spec(document, name, registry, sections, folder, files.read, given)
