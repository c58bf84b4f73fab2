"""Checks of a class of potential where it is written, and the arguments that its `prepare` gives."""

from __future__ import annotations

import dis
import inspect
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from pydantic import Field
from pydantic.fields import FieldInfo

from streamkit.errors import PluginError, blamed, nearest
from streamkit.stream import Array, read_only

MOST_DIMENSIONS = 3  # most dimensions of an array that compiled code gets
OF_ALL = "growth", "orientation", "centre"  # the fields of every potential, which its methods do not get
HOST = "host"  # what `prepare` calls the rest of the host
MOVING = "x", "y", "z", "vx", "vy", "vz", "t"  # the first arguments of `drag`


def check_signature(cls: Any, prepares: bool) -> None:
    """Check the signatures of a class of potential, which ``prepares`` the arguments of its force itself or does not.

    Raises PluginError for a field or an argument that cannot be.
    """
    where = f"{cls.__module__}.{cls.__name__}"
    for name in OF_ALL:
        if name in inspect.get_annotations(cls):
            raise PluginError(f"{where}: the field {name!r} belongs to every potential: call yours something else")
    force, head = cls._force_method, cls._place_arguments
    arguments = cls.force_arguments()
    fields = [name for name in cls.model_fields if name not in OF_ALL]
    measured = [*cls.measured()]
    if not prepares:
        if arguments != (*head, *measured):
            raise PluginError(
                f"{where}.{force}: the arguments must be ({', '.join((*head, *measured))}), that is {', '.join(head)} "
                f"and then the fields by name; found ({', '.join(arguments)})"
            )
        if odd := [name for name in fields if name not in measured]:
            raise PluginError(
                f"{where}: every field of a potential must be a number with a unit or an array of them (Mass, Length, "
                f"LengthArray, ...), unless the class defines `prepare`, which gets all fields; {', '.join(odd)} is not"
            )
    else:
        for name in inspect.signature(cls.prepare).parameters:
            if name not in fields and name != HOST:
                raise PluginError(
                    f"{where}.prepare: the arguments are fields by name; found {name!r}.{nearest(name, fields)} "
                    f"Fields: {', '.join(fields)}"
                )
        for method in (force, cls._energy_method) if cls.has_energy() else (force,):
            given = tuple(inspect.signature(getattr(cls, method)).parameters)
            if given[: len(head)] != head or given != arguments:
                raise PluginError(
                    f"{where}: {force} and {cls._energy_method} must have the same arguments: {', '.join(head)} and "
                    f"then what `prepare` gives, or fields, by name; found ({', '.join(given)})"
                )
    if cls.has_drag():
        given, expected = tuple(inspect.signature(cls.drag).parameters), (*MOVING, *arguments[len(head) :])
        if given != expected:
            raise PluginError(
                f"{where}.drag: the arguments must be ({', '.join(expected)}), that is position, velocity, time and "
                f"then those of `{force}`; found ({', '.join(given)})"
            )
    for name in (force, "drag"):
        if cls.compiled and any(step.opname == "RAISE_VARARGS" for step in dis.get_instructions(getattr(cls, name))):
            raise PluginError(
                f"{where}.{name}: compiled code cannot raise or assert, the exception "
                "would be lost: return NaN where there is no force, bound the fields, or set `compiled = False`"
            )


def add_evaluation(cls: Any) -> None:
    """Give a potential that is not compiled the fields of its evaluation, after the author's."""
    chosen = "auto" if cls.evaluation == "expansion" else "none"
    said = (
        "Form of the expansion that replaces the potential: spherical, axisymmetric, general, or auto, the simplest "
        "that its symmetries allow; none calls the potential itself, slowly."
    )
    limit = "Largest relative error of the acceleration by the expansion, from 0.1 to 500 kpc."
    fields: dict[str, tuple[Any, Any]] = {
        "expansion": (Literal["auto", "spherical", "axisymmetric", "general", "none"], Field(chosen, description=said)),
        "tolerance": (float, Field(1e-4, ge=1e-8, le=0.1, description=limit)),
    }
    for name, (annotation, default) in fields.items():
        if name in cls.model_fields:
            raise PluginError(f"{cls.__module__}.{cls.__name__}: no field of a potential may be called {name!r}")
        cls.__pydantic_fields__[name] = FieldInfo.from_annotated_attribute(annotation, default)
        cls.__annotations__[name] = annotation
    cls.model_rebuild(force=True)


def prepared_arguments(cls: Any, fields: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the arguments of the force after t of a class with `prepare`, which gets these fields by name."""
    with blamed(f"potential {cls.kind}"):
        result = cls.prepare(**{name: fields[name] for name in inspect.signature(cls.prepare).parameters})
    prepared = result._asdict() if hasattr(result, "_asdict") else result
    where = f"{cls.__module__}.{cls.__name__}"
    if not isinstance(prepared, Mapping):
        raise PluginError(f"{where}.prepare: found {prepared!r}, expected a mapping or a named tuple")
    arguments = {**fields, **prepared}
    values = []
    for name in cls.force_arguments()[len(cls._place_arguments) :]:
        if name not in arguments:
            raise PluginError(
                f"{where}.{cls._force_method}: the argument {name!r} is no field, and `prepare` does not give it."
                f"{nearest(name, arguments)} It gives {', '.join(prepared) or 'nothing'}."
            )
        values.append(_plain(arguments[name], f"{where}.prepare: {name!r}") if cls.compiled else arguments[name])
    return tuple(values)


def _plain(value: Any, what: str) -> float | Array:
    """Return a float, or a read-only array of floats in C order."""
    try:
        array = np.ascontiguousarray(value, dtype=float) if np.ndim(value) else float(value)
    except (TypeError, ValueError):
        raise PluginError(
            f"{what}: found {value!r}, expected a number or an array; or set `compiled = False`"
        ) from None
    if np.ndim(array) > MOST_DIMENSIONS:
        raise PluginError(f"{what}: found an array of {np.ndim(array)} dimensions, expected at most {MOST_DIMENSIONS}")
    return read_only(array) if np.ndim(array) else array
