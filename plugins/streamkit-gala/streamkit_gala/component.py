"""The component: one kind, whose fields are the parameters of the gala potential that its section names."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from inspect import Parameter as Argument
from inspect import Signature
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from streamkit import Angle, Length, Mass, Number, NumberTensor, Potential, Speed, Unit
from streamkit_gala.catalogue import Parameter, class_called, construct, parameters_of

# Types of fields by gala's physical types.
TYPES: Mapping[str, Any] = {
    "mass": Mass,
    "length": Length,
    "speed": Speed,
    "angle": Angle,
    "dimensionless": Number,
    "mass density": Annotated[float, Unit("Msun / kpc3"), Field(gt=0)],
}
EXPLAINED = {"version": "Which of gala's versions of the model: v1, v2 or latest.", "lmax": "Order of the expansion."}


class _Gala(Potential):
    """Evaluates a gala potential."""

    compiled = False
    evaluation = "expansion"

    @classmethod
    def for_section(cls, section: Mapping[str, Any]) -> type[Potential]:
        """Return the class with the parameters of the gala potential that the section names."""
        name = section.get("name")
        if not isinstance(name, str):  # the field says what is wrong
            return cls
        return _class_of(parameters_of(name, section), name)

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, model: Any) -> Any:
        """Return gala's acceleration.

        gala needs a writable array. It gets no times: these potentials are static, and gala 1.11 returns wrong
        gradients for an array of times.
        """
        return tuple(-model.gradient(np.array([x, y, z], dtype=float)).value)

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, model: Any) -> Any:
        """Return gala's potential."""
        energy = model.energy(np.array([x, y, z], dtype=float)).value
        return energy if np.ndim(x) else energy.reshape(())

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the values: a class made for a section is made again."""
        values = ((name, getattr(self, name)) for name in type(self).model_fields)
        return _again, (type(self) is Gala, {name: value for name, value in values if value is not None})


class Gala(_Gala):
    """A potential of gala, by its gala name; its other fields are gala's own parameters of that potential."""

    kind = "gala"
    example = {"name": "BovyMWPotential2014"}
    reference = "Price-Whelan 2017, JOSS 2, 388"

    name: str = Field(description="gala's name of the potential, such as NFWPotential or MilkyWayPotential.")

    @staticmethod
    def prepare(name: Any) -> dict[str, Any]:
        """Build the potential with gala's defaults."""
        return {"model": construct_model(parameters_of(name, {}), name, {})}


@cache
def _class_of(parameters: tuple[Parameter, ...], name: str) -> type[Potential]:
    """Make the class whose fields are these parameters."""
    fields = {"name": (Literal[name], Field(description=Gala.model_fields["name"].description))}
    fields |= {parameter.name: _field(parameter) for parameter in parameters}

    def prepare(**values: Any) -> dict[str, Any]:
        return {"model": construct_model(parameters, name, values)}

    prepare.__signature__ = Signature([Argument(key, Argument.KEYWORD_ONLY) for key in fields])  # type: ignore[attr-defined]
    body = {key: field for key, (_, field) in fields.items()}
    about = {
        "__module__": __name__,
        "__doc__": f"gala's {name}.",
        "__annotations__": {key: kind for key, (kind, _) in fields.items()},
        "kind": Gala.kind,
        "reference": Gala.reference,
        "prepare": staticmethod(prepare),
    }
    return type(Potential)(name, (_Gala,), about | body)


def _field(parameter: Parameter) -> tuple[Any, Any]:
    """Return type and pydantic field of a parameter."""
    default = ... if parameter.default is None else parameter.default
    if parameter.physical_type is None:
        kind, text = type(parameter.default), EXPLAINED.get(parameter.name, "A switch of gala's.")
    else:
        kind = NumberTensor if parameter.dimensions else TYPES[parameter.physical_type]
        text = f"gala's {'.'.join(parameter.keys)} ({parameter.physical_type})."
        default = math.degrees(default) if parameter.physical_type == "angle" and default is not ... else default
    return kind, Field(default=default, description=text)


def construct_model(parameters: tuple[Parameter, ...], name: str, values: Mapping[str, Any]) -> Any:
    """Build a gala potential from the values of the fields in engine units."""
    keys = {parameter.name: parameter.keys for parameter in parameters}
    return construct(class_called(name), {keys[key]: value for key, value in values.items() if key in keys})


def _again(plain: bool, values: Mapping[str, Any]) -> Potential:
    return (Gala if plain else Gala.for_section(values))(**values)
