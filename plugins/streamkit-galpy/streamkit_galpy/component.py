"""The component: one kind, whose fields are the parameters of the galpy potential that its section names."""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from inspect import Parameter as Argument
from inspect import Signature
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from streamkit import GYR, Array, Duration, Length, Number, NumberTensor, OutOfDomain, Potential, Speed, TimeArray, Unit
from streamkit_galpy import catalogue
from streamkit_galpy.evaluate import Evaluator

TO_ENGINE = {"deg": math.pi / 180, "Gyr": GYR}
# Units of fields that differ from the engine's: the factor, and the engine's unit by astropy's name.
IN_ENGINE = {"deg": "rad", "Gyr": "kpc s / km"}
REFUSED = ValueError, TypeError, OSError, RuntimeError  # exceptions of galpy for parameters that it does not accept
MOST_TIMES = 500  # at which a potential that changes is expanded
OBJECTS = ("pot", "orbit", "s", "RZPot", "Sigma", "baryonpot", "zvec")  # parameters that are Python objects
FUNCTIONS = {"TimeDependentAmplitudeWrapperPotential": "A"}  # and functions of time
INSTEAD = {
    "TimeDependentAmplitudeWrapperPotential": "streamkit has growth, a table of factors in time",
    "MovingObjectPotential": "streamkit has centre, a place in time, and [body.NAME]",
}


class _Galpy(Potential):
    """Evaluates a galpy potential."""

    compiled = False
    evaluation = "expansion"

    @classmethod
    def for_section(cls, section: Mapping[str, Any]) -> type[Potential]:
        """Return the class with the parameters of the galpy potential that the section gives, and those it needs."""
        name = section.get("name")
        if not isinstance(name, str):  # the field says what is wrong
            return cls
        catalogue.check_name(name)
        return _class_of(name, tuple(_parameters(name, section)))

    @model_validator(mode="after")
    def _not_too_many(self) -> Self:
        times = self.known_times()
        if times is not None and len(times) > MOST_TIMES:
            raise ValueError(f"found {len(times)} times to expand it at, expected at most {MOST_TIMES}: raise step")
        return self

    def known_times(self) -> Array | None:
        """Return the times at which it is expanded: from `since` to today, or of its table, `step` or less apart."""
        table = next((getattr(self, name) for name in TABLES if getattr(self, name, None) is not None), None)
        first, last = (self.since, 0.0) if table is None else (float(table[0]), float(table[-1]))  # type: ignore[attr-defined]
        if first >= last:
            return None
        count = int(min(np.ceil((last - first) / self.step), MOST_TIMES + 1))  # type: ignore[attr-defined]
        times = np.linspace(first, last, count + 1)
        return times if table is None else np.unique(np.round(np.concatenate([times, table]), 9))

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, model: Any) -> Any:
        """Return galpy's acceleration."""
        return model.acceleration(x, y, z, t)

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, model: Any) -> Any:
        """Return galpy's potential."""
        return model.potential(x, y, z, t)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the values: a class made for a section is made again."""
        values = ((name, getattr(self, name)) for name in type(self).model_fields)
        given = {name: value for name, value in values if value is not None}
        return _again, (type(self) is Galpy, given, dict(self.in_time))


TABLES = ("tgrid", f"{catalogue.WRAPPED}tgrid")  # fields with the times of a table
Past = Annotated[float, Unit("Gyr", GYR)]


class Galpy(_Galpy):
    """A potential of galpy, by its galpy name; its other fields are galpy's own parameters of that potential."""

    kind = "galpy"
    example = {"name": "MWPotential2014"}
    reference = "Bovy 2015, ApJS 216, 29"

    name: str = Field(description="galpy's name of the potential, such as NFWPotential or MWPotential2014.")
    ro: Length = Field(default=8.0, description="galpy's unit of length.")
    vo: Speed = Field(default=220.0, gt=0, description="galpy's unit of speed.")
    since: Past = Field(
        default=0.0, le=0, description="If it changes: the time from which on it is expanded; 0 is today."
    )
    step: Duration = Field(default=0.05, description="If it changes: the longest time between two expansions.")

    @staticmethod
    def prepare(name: Any, ro: Any, vo: Any) -> dict[str, Any]:
        """Build the potential with galpy's defaults."""
        return {"model": _build(name, {}, ro, vo)}


def _parameters(name: str, section: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the name and the type of each of galpy's parameters that is needed or given.

    Raises ValueError for one that galpy does not have.
    """
    if catalogue.is_wrapper(name):
        inner = {k.removeprefix(WRAPPED): v for k, v in section.items() if k.startswith(WRAPPED)}
        own = {k: v for k, v in section.items() if not k.startswith(WRAPPED)}
        return [*_own(name, own), ("pot_name", "text"), *_of_wrapped(name, inner)]
    return _own(name, section)


def _of_wrapped(name: str, inner: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the parameters of the potential in a wrapper, from its section."""
    wrapped = inner.get("name")
    if not isinstance(wrapped, str):
        raise ValueError(
            f'pot_name: missing; galpy\'s {name} is made of another potential: pot_name = "NFWPotential", and its '
            "parameters as pot_amp, pot_a ..."
        )
    try:
        catalogue.check_name(wrapped)
        if catalogue.is_wrapper(wrapped):
            raise ValueError("found a wrapper in a wrapper, expected another potential of galpy")
    except ValueError as error:
        raise ValueError(f"pot_name: {error}") from None
    try:
        return [(f"{WRAPPED}{key}", kind) for key, kind in _own(wrapped, inner)]
    except ValueError as error:
        raise ValueError(f"{WRAPPED}{error}") from None


def _own(name: str, section: Mapping[str, Any]) -> list[tuple[str, str]]:
    if name in FUNCTIONS or name == "MovingObjectPotential":
        what = FUNCTIONS.get(name, "orbit")
        raise ValueError(
            f"{what}: galpy's {name} takes a Python object for {what!r}, which a run file cannot hold: {INSTEAD[name]}"
        )
    signature: Mapping[str, inspect.Parameter] = {}
    if name not in catalogue.models():
        made_of = ("pot",) if catalogue.is_wrapper(name) else ()
        signature = {k: p for k, p in catalogue.signature_of(name).items() if k not in made_of}
    parameters = []
    for key in dict.fromkeys([*(k for k, p in signature.items() if p.default is p.empty), *section]):
        if key in Galpy.model_fields or key in SHARED:
            continue
        if key not in signature:
            matches = get_close_matches(key, signature, 1)
            hint = f" Did you mean {matches[0]!r}?" if matches else ""
            allowed = ", ".join(["ro", "vo", *signature])
            raise ValueError(f"{key}: galpy's {name} has no parameter {key!r}.{hint} It has {allowed}.")
        parameters.append((key, _type_of(name, key, section.get(key), signature[key].default)))
    return parameters


WRAPPED = catalogue.WRAPPED
SHARED = ("expansion", "tolerance", "growth", "orientation", "centre")  # fields of every potential that is not compiled


def _type_of(name: str, key: str, value: Any, default: Any) -> str:
    """Return the unit of a number, or one of the words ``number``, ``array``, ``switch`` and ``text``."""
    unit = catalogue.units_of(name).get(key)
    if key == "tgrid":
        return "times"
    if (isinstance(value, list | np.ndarray) and unit is None) or isinstance(default, np.ndarray) or key == "Asin":
        return "array"
    if callable(default) or key in OBJECTS:
        raise ValueError(f"{key}: galpy's {name} takes a Python object for {key!r}, which a run file cannot hold")
    if isinstance(default, bool) and key != "normalize":
        return "switch"
    return "text" if isinstance(default, str) else unit or "number"


@cache
def _class_of(name: str, parameters: tuple[tuple[str, str], ...]) -> type[Potential]:
    """Make the class with these fields, and ro and vo."""
    ro, vo = catalogue.model_scales(name)
    keys = tuple(key for key, _ in parameters)
    plain = Galpy.model_fields
    fields: dict[str, tuple[Any, Any]] = {
        "name": (Literal[name], Field(description=plain["name"].description)),
        "ro": (Length, Field(default=ro, description=plain["ro"].description)),
        "vo": (Speed, Field(default=vo, gt=0, description=plain["vo"].description)),
        "since": (Past, Field(default=0.0, le=0, description=plain["since"].description)),
        "step": (Duration, Field(default=plain["step"].default, description=plain["step"].description)),
    }
    kinds: dict[str, Any] = {"number": Number, "array": NumberTensor, "times": TimeArray, "switch": bool, "text": str}
    for key, kind in parameters:
        unit = Annotated[float, Unit(kind, TO_ENGINE.get(kind, 1.0))]
        fields[key] = kinds.get(kind, unit), Field(description=f"galpy's {key}.")
    units = {key: IN_ENGINE.get(kind, kind) for key, kind in parameters if kind not in kinds}

    def prepare(**values: Any) -> dict[str, Any]:
        given = {key: values[key] for key in keys}
        return {"model": _build(name, given, values["ro"], values["vo"], units)}

    prepare.__signature__ = Signature([Argument(key, Argument.KEYWORD_ONLY) for key in ("name", "ro", "vo", *keys)])  # type: ignore[attr-defined]
    about = {
        "__module__": __name__,
        "__doc__": f"galpy's {name}.",
        "__annotations__": {key: kind for key, (kind, _) in fields.items()},
        "kind": Galpy.kind,
        "reference": Galpy.reference,
        "prepare": staticmethod(prepare),
    }
    return type(Potential)(name, (_Galpy,), about | {key: field for key, (_, field) in fields.items()})


def _build(name: str, values: Mapping[str, Any], ro: float, vo: float, units: Mapping[str, str] = {}) -> Evaluator:
    """Build galpy's potential from values in engine units."""
    source = _source(name, values, ro, vo, units)
    try:
        return Evaluator.of(source, ro, vo)
    except REFUSED as error:
        raise OutOfDomain(f"galpy's {name} refuses its parameters: {error}") from None


def _source(name: str, values: Mapping[str, Any], ro: float, vo: float, units: Mapping[str, str]) -> Any:
    """Build galpy's object; that of a wrapper with the potential in it."""
    if name in catalogue.models():
        return catalogue.model(name)
    import astropy.units as u  # slow to import

    own = {key: value for key, value in values.items() if not key.startswith(WRAPPED)}
    signature = catalogue.signature_of(name)
    given = {key: _number(value, signature[key].default) for key, value in own.items()}
    given |= {key: value * u.Unit(units[key]) for key, value in given.items() if key in units}
    if "tgrid" in given:  # galpy's constructors take it in natural units alone
        given["tgrid"] = given["tgrid"] * vo / ro
    if catalogue.is_wrapper(name):
        of = len(WRAPPED)
        inner = {key[of:]: value for key, value in values.items() if key.startswith(WRAPPED)}
        within = {key[of:]: unit for key, unit in units.items() if key.startswith(WRAPPED)}
        given["pot"] = _source(inner.pop("name"), inner, ro, vo, within)
    try:
        return catalogue.classes()[name](**given, ro=ro, vo=vo)
    except REFUSED as error:
        raise OutOfDomain(f"galpy's {name} refuses its parameters: {error}") from None


def _number(value: Any, default: Any) -> Any:
    """Return a whole number where galpy has one: orders of expansions, numbers of arms."""
    whole = isinstance(default, int) and not isinstance(default, bool) and isinstance(value, float)
    return int(value) if whole and value.is_integer() else value


def _again(plain: bool, values: Mapping[str, Any], in_time: Mapping[str, Any]) -> Potential:
    made = (Galpy if plain else Galpy.for_section(values))(**values)
    return made.changing(in_time) if in_time else made
