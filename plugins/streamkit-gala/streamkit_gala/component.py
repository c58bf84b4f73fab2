"""The component: one kind, whose fields are the parameters of the gala potential that its section names."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from inspect import Parameter as Argument
from inspect import Signature
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from streamkit import (
    Angle,
    AngleArray,
    Array,
    Duration,
    Length,
    LengthArray,
    Mass,
    MassArray,
    Number,
    NumberTensor,
    OutOfDomain,
    Potential,
    Speed,
    SpeedArray,
    TimeArray,
    Unit,
)
from streamkit_gala.catalogue import IN_TIME, Parameter, class_called, construct, parameters_of

# Types of fields by gala's physical types.
TYPES: Mapping[str, Any] = {
    "mass": Mass,
    "length": Length,
    "speed": Speed,
    "angle": Angle,
    "dimensionless": Number,
    "mass density": Annotated[float, Unit("Msun / kpc3"), Field(gt=0)],
}
# Types of fields with a number for each time.
ARRAYS: Mapping[str, Any] = {
    "mass": MassArray,
    "length": LengthArray,
    "speed": SpeedArray,
    "angle": AngleArray,
    "time": TimeArray,
}
MOST_TIMES = 500  # at which a potential that changes is expanded
REFUSED = ValueError, TypeError, NotImplementedError  # exceptions of gala for parameters that it does not accept
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

    @model_validator(mode="after")
    def _one_for_each_time(self) -> Self:
        knots = getattr(self, "time_knots", None)
        if knots is None:
            return self
        if len(knots) < 2 or (np.diff(knots) <= 0).any():
            raise ValueError(f"time_knots: found {knots.tolist()}, expected two times or more that increase")
        for name, unit in type(self).measured().items():
            value = getattr(self, name)
            if name != "time_knots" and unit.name and np.ndim(value) == 1 and len(value) != len(knots):
                raise ValueError(f"{name}: found {len(value)} numbers, expected one for each of {len(knots)} times")
        if (times := self.known_times()) is not None and len(times) > MOST_TIMES:
            raise ValueError(f"found more than {MOST_TIMES} times to expand it at: raise step")
        return self

    def known_times(self) -> Array | None:
        """Return the times of the knots, and between them, `step` or less apart."""
        knots = getattr(self, "time_knots", None)
        if knots is None:
            return None
        count = int(min(np.ceil((knots[-1] - knots[0]) / self.step), MOST_TIMES + 1))  # type: ignore[attr-defined]
        times = np.union1d(np.linspace(knots[0], knots[-1], count + 1), knots)
        return np.asarray(times[np.append(np.diff(times) > 1e-9, True)])

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, model: Any) -> Any:
        """Return gala's acceleration.

        gala needs a writable array, and gets one time at once: gala 1.11 returns wrong gradients for an array of times.
        """
        q = np.array([x, y, z], dtype=float)
        if not isinstance(model, class_called(IN_TIME)):
            return tuple(-model.gradient(q).value)
        return tuple(-_at_each_time(lambda q, now: model.gradient(q, t=now).value, q, t))

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, model: Any) -> Any:
        """Return gala's potential."""
        q = np.array([x, y, z], dtype=float)
        if isinstance(model, class_called(IN_TIME)):
            return _at_each_time(lambda q, now: model.energy(q, t=now).value, q, t).reshape(np.shape(x))
        energy = model.energy(q).value
        return energy if np.ndim(x) else energy.reshape(())

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the values: a class made for a section is made again."""
        values = ((name, getattr(self, name)) for name in type(self).model_fields)
        given = {name: value for name, value in values if value is not None}
        return _again, (type(self) is Gala, given, dict(self.in_time))


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


def _at_each_time(function: Callable[[Any, float], Any], q: Any, t: Any) -> Any:
    """Return a function of positions (3, n) and one time, called for each of the times (n,), or for one."""
    if np.ndim(t) == 0:
        return function(q, float(t))
    at_times = {float(now): np.flatnonzero(t == now) for now in np.unique(t)}
    parts = [function(np.ascontiguousarray(q[:, i]), now) for now, i in at_times.items()]
    out = np.empty((*np.shape(parts[0])[:-1], q.shape[1]))
    for i, part in zip(at_times.values(), parts, strict=True):
        out[..., i] = part
    return out


@cache
def _class_of(parameters: tuple[Parameter, ...], name: str) -> type[Potential]:
    """Make the class whose fields are these parameters."""
    fields = {"name": (Literal[name], Field(description=Gala.model_fields["name"].description))}
    fields |= {parameter.name: _field(parameter) for parameter in parameters}
    if name == IN_TIME:
        fields["step"] = Duration, Field(default=0.05, description="The longest time between two expansions.")
    own = [key for key in fields if key != "step"]

    def prepare(**values: Any) -> dict[str, Any]:
        return {"model": construct_model(parameters, name, values)}

    prepare.__signature__ = Signature([Argument(key, Argument.KEYWORD_ONLY) for key in own])  # type: ignore[attr-defined]
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
        kind = TYPES.get(parameter.physical_type)
        kind = ARRAYS.get(parameter.physical_type, NumberTensor) if parameter.dimensions else kind
        text = f"gala's {'.'.join(parameter.keys)} ({parameter.physical_type})."
        default = math.degrees(default) if parameter.physical_type == "angle" and default is not ... else default
    return kind, Field(default=default, description=text)


def construct_model(parameters: tuple[Parameter, ...], name: str, values: Mapping[str, Any]) -> Any:
    """Build a gala potential from the values of the fields in engine units."""
    keys = {parameter.name: parameter.keys for parameter in parameters}
    given = {keys[key]: value for key, value in values.items() if key in keys}
    if name == IN_TIME:
        given["potential_cls",] = class_called(values["potential_cls"])
    try:
        return construct(class_called(name), given)
    except REFUSED as error:
        raise OutOfDomain(f"gala's {name} refuses its parameters: {error}") from None


def _again(plain: bool, values: Mapping[str, Any], in_time: Mapping[str, Any]) -> Potential:
    made = (Gala if plain else Gala.for_section(values))(**values)
    return made.changing(in_time) if in_time else made
