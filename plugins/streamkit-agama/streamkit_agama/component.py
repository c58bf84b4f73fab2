"""The component: one kind, with AGAMA's own parameters of a potential, or an INI file with a whole one."""

from __future__ import annotations

import re
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from inspect import Parameter as Argument
from inspect import Signature
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from streamkit import (
    DataFile,
    Length,
    Mass,
    Number,
    OutOfDomain,
    PositiveNumber,
    Potential,
    Speed,
    StreamkitError,
    Unit,
)

SURFACE, VOLUME = (Annotated[float, Unit(name)] for name in ("Msun / kpc2", "Msun / kpc3"))
# AGAMA's parameters (its reference, section 2.2.4) and their types. AGAMA itself ignores unknown parameters.
PARAMETERS: Mapping[str, Any] = {
    "mass": Mass,
    "scaleRadius": Length,
    "scaleHeight": Annotated[float, Unit("kpc")],  # negative for a sech^2 disc
    "outerCutoffRadius": Length,
    "innerCutoffRadius": Length,
    "surfaceDensity": SURFACE,
    "densityNorm": VOLUME,
    "v0": Speed,
    "Omega": Annotated[float, Unit("km / (s kpc)")],
    **dict.fromkeys(("alpha", "beta", "gamma", "cutoffStrength", "W0", "trunc"), Number),
    **dict.fromkeys(("sersicIndex", "axisRatioY", "axisRatioZ"), PositiveNumber),
    **dict.fromkeys(("rmin", "rmax", "Rmin", "Rmax", "zmin", "zmax"), Length),
    **dict.fromkeys(("lmax", "mmax", "gridSizeR", "gridSizeZ"), int),
    "density": str,
}
SHARED = ("expansion", "tolerance", "growth", "orientation", "centre")
# AGAMA's remark in a file of its `export`, below a potential whose parameters the export has left out.
INCOMPLETE = "other parameters are not stored"
# A line of an INI file that names another file.
ELSEWHERE = re.compile(r"^\s*(file|center|scale|rotation)\s*=\s*\S*[A-Za-z_/]\S*\s*$", re.IGNORECASE | re.MULTILINE)


class _Agama(Potential):
    """Evaluates an AGAMA potential."""

    compiled = False
    evaluation = "expansion"

    @classmethod
    def for_section(cls, section: Mapping[str, Any]) -> type[Potential]:
        """Return the class with those of AGAMA's parameters that the section gives."""
        if section.get("type") and set(section) <= {"type", *SHARED}:
            return Agama
        given = []
        for key in section:
            if key in ("type", "file", *SHARED):
                continue
            if key not in PARAMETERS:
                matches = get_close_matches(key, PARAMETERS, 1)
                hint = f" Did you mean {matches[0]!r}?" if matches else ""
                raise ValueError(f"{key}: AGAMA has no parameter {key!r}.{hint} It has {', '.join(PARAMETERS)}.")
            given.append(key)
        if ("type" in section) == ("file" in section):
            raise ValueError('expected either type = "NFW" or another of AGAMA\'s types, or file = "NAME.ini"')
        if "file" in section and given:
            raise ValueError(f"{given[0]}: not allowed beside file, which holds all parameters")
        return _class_of("file" in section, tuple(given))

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, model: Any) -> Any:
        """Return AGAMA's force."""
        return tuple(np.moveaxis(_at_times(model.force, x, y, z, t), -1, 0))

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, model: Any) -> Any:
        """Return AGAMA's potential."""
        return _at_times(model.potential, x, y, z, t)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the values: a class made for a section is made again."""
        values = ((name, getattr(self, name)) for name in type(self).model_fields)
        return _again, ({name: value for name, value in values if value is not None}, dict(self.in_time))


class Agama(_Agama):
    """A potential of AGAMA, by its type and parameters or from an INI file."""

    kind = "agama"
    example = {"type": "NFW"}
    reference = "Vasiliev 2019, MNRAS 482, 1525"

    type: str = Field(description="AGAMA's type of the potential, such as NFW, Spheroid or Multipole.")

    @staticmethod
    def prepare(type: Any) -> dict[str, Any]:  # noqa: A002  AGAMA's own name
        """Build the potential with AGAMA's defaults."""
        return {"model": _build({"type": type})}


@cache
def _class_of(from_file: bool, names: tuple[str, ...]) -> type[Potential]:
    """Make the class with these fields."""
    source: tuple[str, Any, str] = ("type", str, Agama.model_fields["type"].description or "")
    if from_file:
        source = "file", DataFile, "AGAMA's INI file, in kpc, km/s and Msun. It may not name further files."
    fields = {source[0]: (source[1], Field(description=source[2]))}
    fields |= {name: (PARAMETERS[name], Field(description=f"AGAMA's {name}.")) for name in names}

    def prepare(**values: Any) -> dict[str, Any]:
        return {"model": _build(values)}

    prepare.__signature__ = Signature([Argument(key, Argument.KEYWORD_ONLY) for key in fields])  # type: ignore[attr-defined]
    about = {
        "__module__": __name__,
        "__doc__": "A potential of AGAMA.",
        "__annotations__": {key: kind for key, (kind, _) in fields.items()},
        "kind": Agama.kind,
        "reference": Agama.reference,
        "prepare": staticmethod(prepare),
    }
    return type(Potential)("AgamaPotential", (_Agama,), about | {key: field for key, (_, field) in fields.items()})


def _build(values: Mapping[str, Any]) -> Any:
    """Build AGAMA's potential in kpc, km/s and Msun, in which its time is kpc/(km/s)."""
    try:
        import agama
    except ImportError as error:
        raise StreamkitError(
            f"AGAMA cannot be imported ({error}): pip install agama compiles it from its source on GitHub"
        ) from None
    arguments = dict(values)
    if "file" in arguments:
        file = arguments["file"]
        text = file.read_text()
        if other := ELSEWHERE.search(text):
            raise StreamkitError(
                f"{file.path}: {other[0].strip()!r} names another file, whose content would not belong to the run: "
                "put everything into this file"
            )
        if INCOMPLETE in text:
            raise StreamkitError(
                f"{file.path}: AGAMA's export has left out the parameters of a potential ({INCOMPLETE!r}), and AGAMA "
                "would take its defaults, such as a mass of 1: write the parameters into the file, or into sections"
            )
        arguments["file"] = str(file.path)
    agama.setUnits(length=1, velocity=1, mass=1)
    try:
        with agama.setNumThreads(1):  # see `_at_times`
            return agama.Potential(**arguments)
    except (ValueError, RuntimeError, TypeError) as error:
        raise OutOfDomain(f"AGAMA refuses the parameters of the potential: {error}") from None


def _at_times(function: Any, x: Any, y: Any, z: Any, t: Any) -> Any:
    """Call AGAMA with positions (n, 3), once for each time.

    AGAMA runs on one thread: the threads of OpenMP do not survive a fork, and a worker process would wait for them
    for ever. A fit uses the cores by its workers.
    """
    import agama

    positions = np.stack(np.broadcast_arrays(x, y, z), axis=-1).astype(float)
    times = np.unique(t)
    with agama.setNumThreads(1):
        if len(times) == 1:
            return np.asarray(function(positions, t=float(times[0])))
        when = np.broadcast_to(t, np.shape(x))
        first = np.asarray(function(positions, t=float(times[0])))
        values = np.empty_like(first)
        for time in times:
            values[when == time] = function(positions[when == time], t=float(time))
    return values


def _again(values: Mapping[str, Any], in_time: Mapping[str, Any]) -> Potential:
    made = Agama.for_section(values)(**values)
    return made.changing(in_time) if in_time else made
