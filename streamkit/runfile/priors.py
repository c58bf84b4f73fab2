"""Priors on the numeric fields of a run file: densities, quantiles, and their form in the file."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields
from functools import lru_cache
from typing import Any, ClassVar, Union

import numpy as np
from pydantic import ConfigDict, Field, create_model
from scipy.special import ndtr, ndtri
from typing_extensions import TypeAliasType

from streamkit.errors import nearest
from streamkit.stream import Array
from streamkit.units import Unit

_LN_SQRT_2PI = 0.5 * math.log(2.0 * math.pi)


@dataclass(frozen=True)
class Prior(ABC):
    """A normalised probability density of one parameter, in the unit of its field."""

    name: ClassVar[str]

    @abstractmethod
    def lnpdf(self, x: float) -> float:
        """Return the log density at x; -inf outside the support."""

    @abstractmethod
    def lnpdf_of_many(self, x: Array) -> Array:
        """(n,) Return the log densities at x (n,); -inf outside the support."""

    @abstractmethod
    def ppf(self, u: Array) -> Array:
        """Return the quantiles of u in [0, 1], of the same shape."""

    @property
    @abstractmethod
    def support(self) -> tuple[float, float]:
        """The range outside which the density is zero; may be infinite."""

    @property
    def centre(self) -> float:
        """The median: the middle, the geometric middle, or the mean."""
        return float(self.ppf(np.array(0.5)))

    def sample(self, rng: np.random.Generator, size: int) -> Array:
        """(size,) Independent draws."""
        return self.ppf(rng.random(size))

    def document(self, unit: Unit) -> dict[str, list[Any]]:
        """Return the prior as the run file writes it."""
        return {self.name: [quantity(float(value), unit) for value in astuple(self)]}

    def text(self, unit: str = "") -> str:
        """Return the prior as a table shows it."""
        numbers = ", ".join(f"{value:g}" for value in astuple(self))
        return f"{self.name}({numbers}) {unit}".rstrip()


def quantity(value: float, unit: Unit) -> float | str:
    """Write a value as the resolved run file does: ``"8.0 kpc"``, or the bare number if there is no unit."""
    if unit.name:
        return f"{value!r} {unit.name}"
    return value if math.isfinite(value) else repr(value)


@dataclass(frozen=True)
class Uniform(Prior):
    """Constant between two ends."""

    name: ClassVar[str] = "uniform"
    low: float
    high: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high)):
            raise ValueError(f"the ends must be finite, found {self.low:g} and {self.high:g}")
        if self.low >= self.high:
            raise ValueError(f"the lower end must lie below the upper one, found {self.low:g} and {self.high:g}")

    def lnpdf(self, x: float) -> float:
        """Return -ln(high - low) inside."""
        return -math.log(self.high - self.low) if self.low <= x <= self.high else -math.inf

    def lnpdf_of_many(self, x: Array) -> Array:
        """(n,) Return -ln(high - low) inside."""
        return np.where((self.low <= x) & (x <= self.high), -math.log(self.high - self.low), -np.inf)

    def ppf(self, u: Array) -> Array:
        """Return low + u (high - low)."""
        return np.asarray(self.low + u * (self.high - self.low))

    @property
    def support(self) -> tuple[float, float]:
        """The two ends."""
        return self.low, self.high


@dataclass(frozen=True)
class LogUniform(Uniform):
    """Constant in the logarithm between two positive ends."""

    name: ClassVar[str] = "log_uniform"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.low <= 0:
            raise ValueError(f"the lower end must be positive, found {self.low:g}")

    def lnpdf(self, x: float) -> float:
        """Return -ln(x ln(high / low)) inside."""
        return -math.log(x * math.log(self.high / self.low)) if self.low <= x <= self.high else -math.inf

    def lnpdf_of_many(self, x: Array) -> Array:
        """(n,) Return -ln(x ln(high / low)) inside."""
        inside = (self.low <= x) & (x <= self.high)
        return np.where(inside, -np.log(np.where(inside, x, 1.0) * math.log(self.high / self.low)), -np.inf)

    def ppf(self, u: Array) -> Array:
        """Return low (high / low)^u."""
        return np.asarray(self.low * (self.high / self.low) ** u)


@dataclass(frozen=True)
class Normal(Prior):
    """Gaussian."""

    name: ClassVar[str] = "normal"
    mean: float
    sd: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.mean) and math.isfinite(self.sd) and self.sd > 0):
            raise ValueError(f"mean and sd must be finite and sd > 0, found mean {self.mean:g} and sd {self.sd:g}")

    @property
    def support(self) -> tuple[float, float]:
        """Everything."""
        return -math.inf, math.inf

    def lnpdf(self, x: float) -> float:
        """Return the Gaussian log density over the probability inside the support."""
        sign, below_low, below_high = _tails(self)
        low, high = self.support
        if not low <= x <= high:
            return -math.inf
        mass = sign * (below_high - below_low)
        return -0.5 * ((x - self.mean) / self.sd) ** 2 - _LN_SQRT_2PI - math.log(self.sd * mass)

    def lnpdf_of_many(self, x: Array) -> Array:
        """(n,) Return the Gaussian log densities over the probability inside the support."""
        sign, below_low, below_high = _tails(self)
        low, high = self.support
        top = -_LN_SQRT_2PI - math.log(self.sd * sign * (below_high - below_low))
        return np.where((low <= x) & (x <= high), top - 0.5 * ((x - self.mean) / self.sd) ** 2, -np.inf)

    def ppf(self, u: Array) -> Array:
        """Return the quantile within the support."""
        sign, below_low, below_high = _tails(self)
        x = self.mean + self.sd * sign * ndtri(below_low + u * (below_high - below_low))
        return np.asarray(np.clip(x, *self.support))


@dataclass(frozen=True)
class TruncatedNormal(Normal):
    """Gaussian cut to a range; an end may be infinite."""

    name: ClassVar[str] = "truncated_normal"
    low: float
    high: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low < self.high:
            raise ValueError(f"the lower end must lie below the upper one, found {self.low:g} and {self.high:g}")
        _, below_low, below_high = _tails(self)
        if below_low == below_high:
            raise ValueError(f"[{self.low:g}, {self.high:g}] holds none of the Gaussian's probability")

    @property
    def support(self) -> tuple[float, float]:
        """The two ends."""
        return self.low, self.high


@lru_cache
def _tails(prior: Normal) -> tuple[float, float, float]:
    """Sign and normal probabilities below the ends, mirrored into the lower tail: exact far out."""
    a, b = ((end - prior.mean) / prior.sd for end in prior.support)
    sign = -1.0 if a > 0 else 1.0
    return sign, float(ndtr(sign * a)), float(ndtr(sign * b))


PRIORS: dict[str, type[Prior]] = {kind.name: kind for kind in (Uniform, LogUniform, Normal, TruncatedNormal)}


def _table(kind: type[Prior]) -> Any:
    names = [field.name for field in fields(kind)]
    numbers = Field(min_length=len(names), max_length=len(names), description=", ".join(names))
    table: Any = {kind.name: (list[float | str], numbers)}
    return create_model(f"prior/{kind.name}", __config__=ConfigDict(extra="forbid"), __doc__=kind.__doc__, **table)


# A prior as a run file writes it, for the JSON Schema.
PriorTable = TypeAliasType("PriorTable", Union[tuple(map(_table, PRIORS.values()))])  # type: ignore[valid-type]  # noqa: UP007


def usage(kind: type[Prior]) -> str:
    """Return how the run file spells a prior: ``{ uniform = [low, high] }``."""
    return f"{{ {kind.name} = [{', '.join(field.name for field in fields(kind))}] }}"


def parse(table: Mapping[str, Any], unit: Unit) -> Prior:
    """Read a prior of a field in this unit: its name, with its numbers or quantities in a list.

    Raises ValueError: Says what was found, what is allowed, and the nearest name.
    """
    allowed = ", ".join(map(usage, PRIORS.values()))
    if len(table) != 1:
        names = ", ".join(map(repr, table)) or "nothing"
        raise ValueError(f"a prior has one name, found {names}; allowed: {allowed}")
    ((name, numbers),) = table.items()
    if name not in PRIORS:
        raise ValueError(f"no prior is called {name!r}.{nearest(str(name), PRIORS)} Allowed: {allowed}")
    kind = PRIORS[name]
    if not isinstance(numbers, list | tuple) or len(numbers) != len(fields(kind)):
        raise ValueError(f"found {name} = {numbers!r}, expected {usage(kind)}")
    try:
        return kind(*(float(unit.parse(number)) for number in numbers))
    except (ValueError, TypeError) as error:
        raise ValueError(f"{name} = {numbers!r}: {error}; expected {usage(kind)}") from None
