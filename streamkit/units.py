"""Units: kpc, km/s and Msun inside; annotated float types that carry a unit and parse ``"8 kpc"``.

Inside the engine time is measured in kpc/(km/s) and angles in radians. Fields of components hold the units of
the run file (Gyr and degrees); `Component.in_engine_units` converts once, where a field enters the engine.
"""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, get_args

import numpy as np
from pydantic import BeforeValidator, Field, GetCoreSchemaHandler
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

G = 4.300917270e-6  # gravitational constant in kpc (km/s)^2 / Msun

GYR = 3.15576e16 / 3.0856775814913673e16  # one Gyr in kpc/(km/s)

KMS_PER_MASYR_KPC = 4.740470463533349  # tangential velocity in km/s of 1 mas/yr at 1 kpc

CENTRE = 1e-30  # kpc^2, added to squared radii: a force at the very centre is zero and not 0/0


# The largest absolute value of a number in a run file, and the inverse of the smallest: products stay finite.
LARGEST = 1e60


def _sized(value: float) -> float:
    """Return a number as it is; a `ValueError` if it is too large or small in size to be computed with."""
    try:
        size = abs(float(value))
    except OverflowError:
        raise ValueError(f"expected a number below {LARGEST:g}, found a larger integer") from None
    if LARGEST < size < math.inf or 0 < size < 1 / LARGEST:
        raise ValueError(f"expected 0 or a number between {1 / LARGEST:g} and {LARGEST:g} in size, found {value:g}")
    return value


def spelled(unit: object) -> str:
    """Return a unit as run files and documents write it: "km/s" where astropy has "km / s"."""
    return str(unit).replace(" / ", "/")


@dataclass(frozen=True)
class Unit:
    """The unit of a field in the run file, and the factor that takes it to the engine's units.

    As the mark of a field, ``Annotated[float, Unit("Msun/kpc3")]``, it makes a physical number of it: a quantity in
    any unit of that dimension is read, and so is a prior. The types below are such numbers.

    Attributes
    ----------
    name
        The unit by a name that astropy reads, as `spelled`; empty for a dimensionless number.
    to_internal
        Its size in the units of the engine: kpc, km/s, Msun, radians, kpc/(km/s).
    """

    name: str
    to_internal: float = 1.0

    def __post_init__(self) -> None:
        """Spell the name."""
        object.__setattr__(self, "name", spelled(self.name))

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Read quantities with `parse`."""
        return core_schema.no_info_before_validator_function(self.parse, handler(source))

    def parse(self, value: Any) -> Any:
        """Turn ``"8 kpc"`` or an astropy Quantity into a number in this unit; leave numbers alone.

        Text that is no quantity, or one of another dimension, is a `ValueError`.
        """
        if isinstance(value, bool):
            raise ValueError(f"expected {self.number} or a quantity, found {value!r}")
        if isinstance(value, int | float):
            return _sized(value)
        return self._parse_text(value) if isinstance(value, str) else self._parse(value)

    @lru_cache(maxsize=4096)  # noqa: B019  units are few and stay; a resolved run file is read again for every change
    def _parse_text(self, text: str) -> float:
        return self._parse(text)

    def _parse(self, value: Any) -> float:
        from astropy import units as u  # slow to import, and bare numbers do not need it

        target = u.dimensionless_unscaled if not self.name else u.Unit(self.name)
        try:
            # numbers that are too large are refused below; astropy warns of km/s/kpc, the usual unit of pattern speeds
            with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore", category=u.UnitsWarning):
                quantity = u.Quantity(value)
        except (TypeError, ValueError):
            raise ValueError(
                f"expected {self.number} or a quantity such as {self.example!r}, found {value!r}"
            ) from None
        if quantity.shape:
            raise ValueError(f"expected one number, found an array of shape {quantity.shape}")
        if isinstance(value, str) and quantity.unit == u.dimensionless_unscaled and self.name:
            return _sized(float(quantity.value))
        try:
            with np.errstate(all="ignore"):
                number = float(quantity.to_value(target))
        except u.UnitConversionError:
            unit = f"a quantity in {self.name} or a unit like it" if self.name else "a number without a unit"
            raise ValueError(f"expected {unit}, found {str(value)!r}") from None
        return _sized(number)

    @property
    def label(self) -> str:
        """The unit's name, or 'no unit'."""
        return self.name or "no unit"

    @property
    def number(self) -> str:
        """A number in this unit, for messages."""
        return f"a number in {self.name}" if self.name else "a number"

    @property
    def example(self) -> str:
        """A quantity in this unit, for messages."""
        return f"8 {self.name}" if self.name else "8"


# The types a component's numeric fields are declared with. Each is spelled out, so that mypy reads it as float.
_MASS, _LENGTH, _SPEED = Unit("Msun"), Unit("kpc"), Unit("km/s")
_TIME, _ANGLE, _PM, _NUMBER = Unit("Gyr", GYR), Unit("deg", math.pi / 180.0), Unit("mas/yr"), Unit("")
# The units of fields by the name of a type.
UNITS = {
    "Mass": _MASS, "Length": _LENGTH, "Speed": _SPEED, "Duration": _TIME, "Angle": _ANGLE, "ProperMotion": _PM,
    "Number": _NUMBER,
}  # fmt: skip


def unit_called(name: str) -> Unit:
    """Return a unit by the name that astropy reads; ValueError if there is none."""
    for unit in UNITS.values():
        if unit.name == spelled(name):
            return unit
    from astropy import units as u  # slow to import, and the usual units do not need it

    return Unit(u.Unit(name).to_string())


Mass = Annotated[float, _MASS, Field(gt=0)]  # a positive mass in Msun
Length = Annotated[float, _LENGTH, Field(gt=0)]  # a positive length in kpc
Coordinate = Annotated[float, _LENGTH]  # a position along an axis in kpc, of either sign
Speed = Annotated[float, _SPEED, Field(ge=0)]  # a speed in km/s, zero or more
Velocity = Annotated[float, _SPEED]  # a velocity component in km/s, of either sign
Duration = Annotated[float, _TIME, Field(gt=0)]  # a positive duration in Gyr
Angle = Annotated[float, _ANGLE]  # an angle in degrees
ProperMotion = Annotated[float, _PM]  # a proper motion in mas/yr
Number = Annotated[float, _NUMBER]  # a dimensionless number
PositiveNumber = Annotated[float, _NUMBER, Field(gt=0)]  # a positive dimensionless number


@dataclass(frozen=True)
class Symbol:
    r"""The symbol of a field in pictures, as TeX: ``Annotated[Length, Symbol(r"$r_{\rm s}$")]``."""

    tex: str


# Fields that many potentials have, with their symbols and descriptions: ``mass: TotalMass``.
TotalMass = Annotated[Mass, Symbol("$M$"), Field(description="Total mass.")]
ScaleRadius = Annotated[Length, Symbol(r"$r_{\rm s}$"), Field(description="Scale radius.")]
AxisRatio = Annotated[PositiveNumber, Symbol("$q$"), Field(description="Axis ratio z/x.")]


@dataclass(frozen=True)
class Datum:
    """Marks a field that holds a datum and its error, with their unit."""

    unit: str


def _measurement(unit: Unit) -> BeforeValidator:
    """Parse ``[value, error]``, each a number or a quantity in the unit."""

    def parse(value: Any) -> tuple[float, float]:
        if isinstance(value, str) or not hasattr(value, "__len__") or len(value) != 2:
            raise ValueError(f"expected [value, error] in {unit.label}, found {value!r}")
        datum, error = (float(unit.parse(item)) for item in value)
        if not error > 0:
            raise ValueError(f"the error must be positive, found {value[1]!r}")
        return datum, error

    return BeforeValidator(parse, json_schema_input_type=tuple[float | str, float | str])


# A measured length and its standard error in kpc.
LengthDatum = Annotated[tuple[float, float], _measurement(_LENGTH), Datum(_LENGTH.name)]
# A measured mass and its standard error in Msun.
MassDatum = Annotated[tuple[float, float], _measurement(_MASS), Datum(_MASS.name)]
# A measured number without a unit and its standard error.
NumberDatum = Annotated[tuple[float, float], _measurement(_NUMBER), Datum(_NUMBER.name)]
# A measured angle and its standard error in degrees.
AngleDatum = Annotated[tuple[float, float], _measurement(_ANGLE), Datum(_ANGLE.name)]
# A measured velocity and its standard error in km/s.
VelocityDatum = Annotated[tuple[float, float], _measurement(_SPEED), Datum(_SPEED.name)]


def unit_of(field: FieldInfo) -> Unit | None:
    """Return the unit a pydantic field was declared with, None for fields that are not physical numbers."""
    for item in field.metadata:
        if isinstance(item, Unit):
            return item
    return None


GREEK = frozenset((
    "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "kappa", "lambda", "mu", "nu", "xi", "pi",
    "rho", "sigma", "tau", "phi", "chi", "psi", "omega",
))  # fmt: skip
NAMED = {"mass": "$M$"}  # fields whose symbol is not their name


def symbol_of(name: str, field: FieldInfo, owner: str = "") -> str:
    """Return the symbol of a field with the name of its owner as an index (``sat``, ``halo``); '' without a symbol.

    A field without a declared symbol takes it from its name, if the name is a Latin or Greek letter with an index:
    ``r_s``, ``q1``, ``alpha``.
    """
    tex = next((item.tex for item in reversed(field.metadata) if isinstance(item, Symbol)), "")  # the outermost
    tex = tex or _symbol_of_name(name)
    if not tex or not owner:
        return tex
    mark, name = "^" if "_" in tex else "_", owner.replace("_", r"\_")
    return rf"{tex.removesuffix('$')}{mark}{{\rm {name}}}$"


def _symbol_of_name(name: str) -> str:
    r"""Return ``$r_{\rm s}$`` for ``r_s``, ``$q_{1}$`` for ``q1``, ``$\alpha$`` for ``alpha``; '' for words."""
    parts = re.fullmatch(r"([A-Za-z]+?)(?:_([A-Za-z]{1,4})|_?([0-9]+))?", name)
    if name in NAMED or parts is None:
        return NAMED.get(name, "")
    letter, word, number = parts.groups("")
    if len(letter) > 1 and letter not in GREEK:
        return ""
    shown = rf"\{letter}" if letter in GREEK else letter
    index = rf"\rm {word}" if word else number
    return f"${shown}_{{{index}}}$" if index else f"${shown}$"


def datum_unit(field: FieldInfo) -> str:
    """Return the unit of a field that holds a datum and its error, which may be left out; '' for any other field."""
    optional = (item for part in get_args(field.annotation) for item in getattr(part, "__metadata__", ()))
    return next((item.unit for item in (*field.metadata, *optional) if isinstance(item, Datum)), "")
