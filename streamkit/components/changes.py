"""What of a potential changes in time: its fields, the pieces for the engine, and which fields may."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field, field_validator

from streamkit import engine
from streamkit.components.orientation import ANGLES, Oriented
from streamkit.fields import Columns, InTime, Table
from streamkit.units import GYR


class Changing(Oriented):
    """The part of a potential that changes in time. Its methods get the numbers of each time, and need not know."""

    rates: ClassVar[Mapping[str, str]] = {}
    """Fields that are the rate of another one, such as ``{"pattern_speed": "angle"}``, whose force has ``angle +
    pattern_speed * t``: a rate that changes in time is integrated."""

    growth: Annotated[Table, Columns(t="Gyr", factor="").increasing("t")] | None = Field(
        default=None,
        repr=False,
        description="Factor on the force as a table of time (t = 0 is today, where it must be 1): linear between the "
        "rows, constant before the first and after the last. The parameters are those of today.",
    )

    @field_validator("growth")
    @classmethod
    def _as_it_is_today(cls, growth: Table | None) -> Table | None:
        if growth is not None:
            if abs(now := float(np.interp(0.0, growth["t"], growth["factor"])) - 1.0) > 1e-9:
                raise ValueError(f"the factor today (t = 0) is {now + 1.0:g}, expected 1: divide all factors by it")
            if (low := float(growth["factor"].min())) < 0:
                raise ValueError(f"found the factor {low:g}, expected zero or more")
        return growth

    def changes(self) -> engine.Changes:
        """Return the arguments of the force that change in time, and the factor on it, in engine units."""
        return _changes_of(self)

    def changing(self, in_time: Mapping[str, InTime]) -> Self:
        """Return a copy whose fields of these names change in time; ValueError with a sentence if one cannot."""
        _check(self, in_time)
        copy = self.model_copy()
        copy._in_time = dict(in_time)
        return copy

    def __eq__(self, other: object) -> bool:
        """Return whether two potentials have the same class, equal values, and the same changes in time."""
        same = super().__eq__(other)
        return same if same is not True else self._in_time == getattr(other, "_in_time", None)

    __hash__ = Oriented.__hash__


def _changes_of(potential: Any) -> engine.Changes:
    """Return the arguments of the force that change in time, and the factor on it, in engine units."""
    if not potential.in_time and potential.growth is None:  # of most: the signature takes as long as all else
        return ()
    names, units, out = _arguments(type(potential)), potential.parameters(), []
    for name, knots in potential.in_time.items():
        if name.startswith(ANGLES):  # a part of its motion
            continue
        factor, number = units[name].to_internal, names.index(potential.rates.get(name, name))
        if name in potential.rates:
            pieces = knots.integral(GYR, factor)
            pieces[:, 1] += potential.in_engine_units()[number]
        else:
            pieces = knots.pieces(GYR, factor)
        out.append((number, pieces))
    if (growth := potential.growth) is not None:
        out.append((engine.FACTOR, engine.linear(growth["t"] * GYR, growth["factor"])))
    return tuple(out)


def _check(potential: Any, in_time: Mapping[str, InTime]) -> None:
    """Raise ValueError with a sentence for a field that cannot change in time."""
    rates = potential.rates
    for name in in_time:
        what = f"{name} of the potential {potential.kind!r}"
        if name.startswith(ANGLES):
            if potential.has_drag():
                raise ValueError(f"{what} cannot change in time: a part of its force depends on velocity")
            continue
        if not potential.compiled and getattr(potential, "expansion", "none") != "none":
            raise ValueError(
                f"{what} cannot change in time: an expansion is made once. Give growth, a factor on the force in time; "
                'or expansion = "none", which is slow'
            )
        if rates.get(name, name) not in _arguments(type(potential)):
            raise ValueError(f"{what} cannot change in time: what follows from it is computed once. Give growth")
        if rates.get(name) in in_time:
            raise ValueError(f"{what} is the rate of {rates[name]}, which changes in time too: give one of them")


def _arguments(cls: Any) -> tuple[str, ...]:
    """Return the names of the arguments after t in the order of the loop; '' for those that `prepare` decides."""
    taken = inspect.signature(cls.prepare).parameters
    return tuple("" if name in taken else name for name in cls.force_arguments()[len(cls._place_arguments) :])
