"""The run file: read, validated with the installed components, and bound to parameter values."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from streamkit.components import Component, HostData, Observable, Potential, Registry
from streamkit.errors import PluginError, SpecError, nearest
from streamkit.fields import Files
from streamkit.runfile.document import read_toml
from streamkit.runfile.inputs import ONLY, ModelInputs, StreamInputs
from streamkit.runfile.priors import Prior
from streamkit.runfile.reader import resolve
from streamkit.runfile.resolved import Resolved
from streamkit.stream import Array


class Spec(Resolved):
    """A validated run file with its free parameters: what `Resolved` has, bound to values of the parameters.

    It pickles as its document, and unpickling looks up the components again; classes given in Python pickle by
    reference.
    """

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

    def _changed(self, document: dict[str, Any]) -> Spec:
        return _make(document, self.source, self.registry, self.folder, self.given, self.files)

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

    def bind_all(self, theta: Array | Mapping[str, Any] | None = None) -> ModelInputs:
        """Return all streams at the given parameters, and what they share; ``theta`` and errors as for `bind`."""
        return self.sections.bound(self._values(theta))

    def host(self, theta: Array | Mapping[str, Any] | None = None) -> dict[str, Potential]:
        """Return the potentials of the host alone, for a small part of the cost of `bind_all`; arguments as there."""
        return self.sections.host(self._values(theta))

    def measurements(
        self, theta: Array | Mapping[str, Any] | None = None
    ) -> tuple[dict[str, dict[str, Observable]], dict[str, HostData]]:
        """Return the observables of each stream, and the data of the host, for a small part of the cost of `bind_all`.

        Arguments and errors as there.
        """
        return self.sections.measurements(self._values(theta))

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
            values[name] = self.number(name, value)
        return values

    def number(self, name: str, value: Any) -> float:
        """Return a number or a quantity in the unit of a free parameter; SpecError if it is none."""
        try:
            return float(self._fields[name][0].parse(value))
        except (ValueError, TypeError) as error:
            raise SpecError(f"{self.source}: {name}: {error}") from None


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
