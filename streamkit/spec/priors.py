"""Priors on the numeric fields of a run file: densities, quantiles, and their form in the file."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields
from typing import Any, ClassVar

import numpy as np
from scipy.special import ndtr, ndtri

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

    @property
    def width(self) -> float:
        """Half the central 68 % interval: one standard deviation of a normal."""
        low, high = self.ppf(ndtr(np.array([-1.0, 1.0])))
        return float(0.5 * (high - low))

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
        return f"{value!r} {unit.name.replace(' ', '')}"
    return value if math.isfinite(value) else repr(value)


def _ordered(low: float, high: float) -> None:
    if not (math.isfinite(low) and math.isfinite(high)):
        raise ValueError(f"the ends must be finite, found {low:g} and {high:g}")
    if low >= high:
        raise ValueError(f"the lower end must lie below the upper one, found {low:g} and {high:g}")


def _positive_sd(mean: float, sd: float) -> None:
    if not (math.isfinite(mean) and math.isfinite(sd) and sd > 0):
        raise ValueError(f"mean and sd must be finite and sd > 0, found mean {mean:g} and sd {sd:g}")


@dataclass(frozen=True)
class Uniform(Prior):
    """Constant between two ends."""

    name: ClassVar[str] = "uniform"
    low: float
    high: float

    def __post_init__(self) -> None:
        _ordered(self.low, self.high)

    def lnpdf(self, x: float) -> float:
        """Return -ln(high - low) inside."""
        return -math.log(self.high - self.low) if self.low <= x <= self.high else -math.inf

    def ppf(self, u: Array) -> Array:
        """Return low + u (high - low)."""
        return np.asarray(self.low + u * (self.high - self.low))

    @property
    def support(self) -> tuple[float, float]:
        """The two ends."""
        return self.low, self.high


@dataclass(frozen=True)
class LogUniform(Prior):
    """Constant in the logarithm between two positive ends."""

    name: ClassVar[str] = "log_uniform"
    low: float
    high: float

    def __post_init__(self) -> None:
        _ordered(self.low, self.high)
        if self.low <= 0:
            raise ValueError(f"the lower end must be positive, found {self.low:g}")

    def lnpdf(self, x: float) -> float:
        """Return -ln(x ln(high / low)) inside."""
        return -math.log(x * math.log(self.high / self.low)) if self.low <= x <= self.high else -math.inf

    def ppf(self, u: Array) -> Array:
        """Return low (high / low)^u."""
        return np.asarray(self.low * (self.high / self.low) ** u)

    @property
    def support(self) -> tuple[float, float]:
        """The two ends."""
        return self.low, self.high


@dataclass(frozen=True)
class Normal(Prior):
    """Gaussian."""

    name: ClassVar[str] = "normal"
    mean: float
    sd: float

    def __post_init__(self) -> None:
        _positive_sd(self.mean, self.sd)

    def lnpdf(self, x: float) -> float:
        """Return the Gaussian log density."""
        return -0.5 * ((x - self.mean) / self.sd) ** 2 - _LN_SQRT_2PI - math.log(self.sd)

    def ppf(self, u: Array) -> Array:
        """Return mean + sd times the normal quantile."""
        return np.asarray(self.mean + self.sd * ndtri(u))

    @property
    def support(self) -> tuple[float, float]:
        """Everything."""
        return -math.inf, math.inf


@dataclass(frozen=True)
class TruncatedNormal(Prior):
    """Gaussian cut to a range; an end may be infinite."""

    name: ClassVar[str] = "truncated_normal"
    mean: float
    sd: float
    low: float
    high: float

    def __post_init__(self) -> None:
        _positive_sd(self.mean, self.sd)
        if not self.low < self.high:
            raise ValueError(f"the lower end must lie below the upper one, found {self.low:g} and {self.high:g}")
        if self._mass <= 0:
            raise ValueError(f"[{self.low:g}, {self.high:g}] holds none of the Gaussian's probability")

    @property
    def _tails(self) -> tuple[float, float, float]:
        """Sign and normal probabilities below the two ends, mirrored into the lower tail: exact far out."""
        a, b = (self.low - self.mean) / self.sd, (self.high - self.mean) / self.sd
        sign = -1.0 if a > 0 else 1.0
        return sign, float(ndtr(sign * a)), float(ndtr(sign * b))

    @property
    def _mass(self) -> float:
        sign, below_low, below_high = self._tails
        return sign * (below_high - below_low)

    def lnpdf(self, x: float) -> float:
        """Return the Gaussian log density over the probability inside."""
        if not self.low <= x <= self.high:
            return -math.inf
        return -0.5 * ((x - self.mean) / self.sd) ** 2 - _LN_SQRT_2PI - math.log(self.sd * self._mass)

    def ppf(self, u: Array) -> Array:
        """Return the quantile within the range."""
        sign, below_low, below_high = self._tails
        x = self.mean + self.sd * sign * ndtri(below_low + u * (below_high - below_low))
        return np.asarray(np.clip(x, self.low, self.high))

    @property
    def support(self) -> tuple[float, float]:
        """The two ends."""
        return self.low, self.high


KINDS: dict[str, type[Prior]] = {kind.name: kind for kind in (Uniform, LogUniform, Normal, TruncatedNormal)}


def usage(kind: type[Prior]) -> str:
    """Return how the run file spells a prior: ``{ uniform = [low, high] }``."""
    return f"{{ {kind.name} = [{', '.join(field.name for field in fields(kind))}] }}"


def parse(table: Mapping[str, Any], unit: Unit) -> Prior:
    """Read a prior as the run file writes it.

    Parameters
    ----------
    table
        One key, the name of the prior, with its numbers or quantities in a list.
    unit
        The unit of the field.

    Raises
    ------
    ValueError
        Says what was found, what is allowed, and the nearest name.
    """
    if len(table) != 1:
        found = ", ".join(map(repr, table)) or "nothing"
        raise ValueError(f"a prior has one name, found {found}; allowed: {', '.join(map(usage, KINDS.values()))}")
    ((name, numbers),) = table.items()
    if name not in KINDS:
        raise ValueError(
            f"no prior is called {name!r}.{nearest(str(name), KINDS)} Allowed: {', '.join(map(usage, KINDS.values()))}"
        )
    kind = KINDS[name]
    if not isinstance(numbers, list | tuple) or len(numbers) != len(fields(kind)):
        raise ValueError(f"found {name} = {numbers!r}, expected {usage(kind)}")
    try:
        return kind(*(float(unit.parse(number)) for number in numbers))
    except (ValueError, TypeError) as error:
        raise ValueError(f"{name} = {numbers!r}: {error}; expected {usage(kind)}") from None
