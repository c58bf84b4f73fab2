"""A number of a host that changes in time, ``{ times = [...], values = [...] }``: each value a number or a prior."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, create_model

from streamkit.fields import KNOTS, InTime, array_of, times_of
from streamkit.runfile.priors import Prior, PriorTable, parse
from streamkit.units import Unit, unit_of

ANGLES = "orientation"  # the one list of a potential whose entries may change in time


@dataclass(frozen=True)
class Knots:
    """The knots of a field as a run file has them."""

    centre: InTime  # with the priors at their centres
    priors: dict[int, Prior]  # by the number of the knot
    unit: Unit
    table: Mapping[str, Any]  # as it was given

    def at(self, name: str, free: Mapping[str, float]) -> InTime:
        """Return the curve of the field ``name`` at values of the free parameters, by paths in the section."""
        if not self.priors:
            return self.centre
        paths = self.paths(name)
        values = (free.get(path, value) for path, value in zip(paths, self.centre.values, strict=True))
        return replace(self.centre, values=tuple(values))

    def paths(self, name: str) -> list[str]:
        """Return the path of each value in the section: ``v0.values.1``."""
        return [f"{name}.values.{i}" for i in range(len(self.centre.values))]

    def document(self) -> dict[str, Any]:
        """Return the table for the resolved run file: as it was given, with priors in the field's unit."""
        values = list(self.table["values"])
        for i, prior in self.priors.items():
            values[i] = prior.document(self.unit)
        return {"times": list(self.table["times"]), "values": values}


def without_knots(
    path: str, cls: type[BaseModel], table: Mapping[str, Any], in_time: bool, errors: list[str]
) -> tuple[dict[str, Any], dict[str, Knots]]:
    """Put today's values in the place of knots; return the table and the knots by field, angles as ``orientation.2``.

    Errors are collected; numbers of a section that may not change ``in_time`` are one.
    """
    plain, knots = dict(table), dict[str, Knots]()
    for name, value in table.items():
        field = cls.model_fields.get(name)
        if field is None:
            continue
        if (unit := unit_of(field)) is not None and is_knots(value):
            plain[name] = _today(f"{path}.{name}", name, value, unit, in_time, knots, errors)
        elif name == ANGLES and (mark := array_of(field)) is not None and isinstance(value, list):
            plain[name] = [
                _today(f"{path}.{name}.{i}", f"{name}.{i}", item, mark.unit, in_time, knots, errors)
                if is_knots(item)
                else item
                for i, item in enumerate(value)
            ]
    return plain, knots


def is_knots(value: Any) -> bool:
    """Return whether a value of a run file is meant as knots."""
    return isinstance(value, Mapping) and bool(value.keys() & set(KNOTS))


def _today(
    path: str, name: str, table: Mapping[str, Any], unit: Unit, in_time: bool, knots: dict[str, Knots],
    errors: list[str],
) -> float:  # fmt: skip
    """Add the knots of a number by its name; return its value today."""
    try:
        if not in_time:
            raise ValueError("only a number of a host's potential may change in time: give one number or a prior")
        knots[name] = _read(table, unit)
        return knots[name].centre.at(0.0)
    except ValueError as error:
        errors.append(f"{path}: {error}")
        return 1.0  # no further error about this field


def _read(table: Mapping[str, Any], unit: Unit) -> Knots:
    times, values, priors = times_of(table), [], {}
    for i, item in enumerate(table["values"]):
        try:
            if isinstance(item, Mapping):
                priors[i] = parse(item, unit)
            values.append(priors[i].centre if i in priors else float(unit.parse(item)))
            if not math.isfinite(values[-1]):
                raise ValueError(f"found {values[-1]:g}, expected a finite number")
        except (ValueError, TypeError) as error:
            raise ValueError(f"values[{i}]: {error}") from None
    return Knots(InTime(times, tuple(values)), priors, unit, table)


_NUMBERS = Field(min_length=2, description="At each of the times: a number, a quantity or a prior.")
_TIMES = Field(min_length=2, description="Increasing, in Gyr; 0 is today.")
# Knots as a run file writes them, for the JSON Schema.
KnotsTable: Any = create_model(
    "in_time",
    __config__=ConfigDict(extra="forbid"),
    __doc__="A number that changes in time: a monotone cubic through knots.",
    times=(list[float | str], _TIMES),
    values=(list[float | str | PriorTable], _NUMBERS),  # type: ignore[valid-type]  # made at run time
)
