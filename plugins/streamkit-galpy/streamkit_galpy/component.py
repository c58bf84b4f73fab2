"""The component: one kind, whose fields are the parameters of the galpy potential that its section names."""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from inspect import Parameter as Argument
from inspect import Signature
from typing import Annotated, Any, Literal

from pydantic import Field

from streamkit import GYR, Length, Number, NumberTensor, OutOfDomain, Potential, Speed, Unit
from streamkit_galpy import catalogue
from streamkit_galpy.evaluate import Evaluator

TO_ENGINE = {"deg": math.pi / 180, "Gyr": GYR}
# Units of fields that differ from the engine's: the factor, and the engine's unit by astropy's name.
IN_ENGINE = {"deg": "rad", "Gyr": "kpc s / km"}
REFUSED = ValueError, TypeError, OSError, RuntimeError  # exceptions of galpy for parameters that it does not accept


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
        return _again, (type(self) is Galpy, {name: value for name, value in values if value is not None})


class Galpy(_Galpy):
    """A potential of galpy, by its galpy name; its other fields are galpy's own parameters of that potential."""

    kind = "galpy"
    example = {"name": "MWPotential2014"}
    reference = "Bovy 2015, ApJS 216, 29"

    name: str = Field(description="galpy's name of the potential, such as NFWPotential or MWPotential2014.")
    ro: Length = Field(default=8.0, description="galpy's unit of length.")
    vo: Speed = Field(default=220.0, gt=0, description="galpy's unit of speed.")

    @staticmethod
    def prepare(name: Any, ro: Any, vo: Any) -> dict[str, Any]:
        """Build the potential with galpy's defaults."""
        return {"model": _build(name, {}, ro, vo)}


def _parameters(name: str, section: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the name and the type of each of galpy's parameters that is needed or given.

    Raises ValueError for one that galpy does not have.
    """
    if name in catalogue.models():
        signature: Mapping[str, inspect.Parameter] = {}
    else:
        signature = catalogue.signature_of(name)
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


SHARED = ("expansion", "tolerance", "growth", "orientation", "centre")  # fields of every potential that is not compiled


def _type_of(name: str, key: str, value: Any, default: Any) -> str:
    """Return the unit of a number, or one of the words ``number``, ``array``, ``switch`` and ``text``."""
    unit = catalogue.units_of(name).get(key)
    if isinstance(value, list) and unit is None:
        return "array"
    if callable(default) or key in ("pot", "orbit", "s", "RZPot", "Sigma"):
        raise ValueError(f"{key}: galpy's {name} takes a Python object for {key!r}, which a run file cannot hold")
    if isinstance(default, bool) and key != "normalize":
        return "switch"
    return "text" if isinstance(default, str) else unit or "number"


@cache
def _class_of(name: str, parameters: tuple[tuple[str, str], ...]) -> type[Potential]:
    """Make the class with these fields, and ro and vo."""
    ro, vo = catalogue.model_scales(name)
    plain = Galpy.model_fields
    fields: dict[str, tuple[Any, Any]] = {
        "name": (Literal[name], Field(description=plain["name"].description)),
        "ro": (Length, Field(default=ro, description=plain["ro"].description)),
        "vo": (Speed, Field(default=vo, gt=0, description=plain["vo"].description)),
    }
    kinds: dict[str, Any] = {"number": Number, "array": NumberTensor, "switch": bool, "text": str}
    for key, kind in parameters:
        unit = Annotated[float, Unit(kind, TO_ENGINE.get(kind, 1.0))]
        fields[key] = kinds.get(kind, unit), Field(description=f"galpy's {key}.")
    units = {key: IN_ENGINE.get(kind, kind) for key, kind in parameters if kind not in kinds}

    def prepare(**values: Any) -> dict[str, Any]:
        given = {key: value for key, value in values.items() if key not in plain}
        return {"model": _build(name, given, values["ro"], values["vo"], units)}

    prepare.__signature__ = Signature([Argument(key, Argument.KEYWORD_ONLY) for key in fields])  # type: ignore[attr-defined]
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
    if name in catalogue.models():
        return Evaluator.of(catalogue.model(name), ro, vo)
    import astropy.units as u  # slow to import

    signature = catalogue.signature_of(name)
    given = {key: _number(value, signature[key].default) for key, value in values.items()}
    given |= {key: value * u.Unit(units[key]) for key, value in given.items() if key in units}
    try:
        return Evaluator.of(catalogue.classes()[name](**given, ro=ro, vo=vo), ro, vo)
    except REFUSED as error:
        raise OutOfDomain(f"galpy's {name} refuses its parameters: {error}") from None


def _number(value: Any, default: Any) -> Any:
    """Return a whole number where galpy has one: orders of expansions, numbers of arms."""
    whole = isinstance(default, int) and not isinstance(default, bool) and isinstance(value, float)
    return int(value) if whole and value.is_integer() else value


def _again(plain: bool, values: Mapping[str, Any]) -> Potential:
    return (Galpy if plain else Galpy.for_section(values))(**values)
