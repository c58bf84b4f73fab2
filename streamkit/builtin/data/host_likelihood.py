"""The likelihood of a stream as a function of its host alone, which `streamkit export --host-likelihood` writes."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

import streamkit as sk

FORM = "host likelihood 1"  # the form of the file that this version reads and writes
EXAMPLE = Path(__file__).with_name("host_likelihood.ecsv")
BEYOND = 0.25  # a host is at the edge of the domain if one so many sd of the stream alone away is outside
NEAREST, KNOWN = 3, 2  # of so many rows about a place in the domain so many must have a likelihood
VALUE, ERROR = "ln_likelihood", "error"  # the columns besides the parameters of the host


class Surface(NamedTuple):
    """What the file holds, in the coordinates y of its domain: the numbers of the host, or their logarithms.

    Attributes
    ----------
    stream
        The name of the stream.
    units
        The units of the d numbers, by their paths in the run file.
    is_log
        (d,) whether a coordinate is the logarithm of its number.
    centre, whiten
        (d,) and (d, d): x = (y - centre) @ whiten has the mean 0 and the covariance 1 for the stream alone.
    reach, low, high
        The domain: |x| at most, and the ends (d,) of the coordinates.
    is_known
        (n,) whether most rows nearest to x (n, d) have a likelihood: where most have none, the domain has a hole.
    at
        ln likelihood (n,) at x (n, d).
    assumes
        What else the host of the stream's fit was, by path.
    """

    stream: str
    units: Mapping[str, str]
    is_log: sk.BoolArray
    centre: sk.Array
    whiten: sk.Array
    reach: float
    low: sk.Array
    high: sk.Array
    is_known: Any
    at: Any
    assumes: Mapping[str, Any]

    @property
    def errors(self) -> sk.Array:
        """(d,) Standard deviations of the coordinates for the stream alone."""
        return np.asarray(np.sqrt(np.sum(np.linalg.inv(self.whiten) ** 2, axis=0)))

    def coordinates(self, numbers: Mapping[str, float]) -> sk.Array:
        """(d,) Coordinates of a host with these numbers; NaN for the logarithm of a number that is not positive."""
        values = np.array([numbers[path] for path in self.units])
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(self.is_log, np.log(values), values)

    def has(self, y: sk.Array) -> sk.BoolArray:
        """(n,) Return whether coordinates y (n, d) are inside the domain."""
        x = (y - self.centre) @ self.whiten
        within = ((self.low <= y) & (y <= self.high)).all(axis=1)
        return np.asarray(within & (np.sum(x**2, axis=1) <= self.reach**2) & self.is_known(x), dtype=bool)

    def ln_likelihood(self, y: sk.Array) -> sk.Array:
        """(n,) ln likelihood at coordinates y (n, d); beyond the domain it falls, for emulators that ask there."""
        x = (y - self.centre) @ self.whiten
        r = np.sqrt(np.sum(x**2, axis=1))
        inside = x * np.minimum(1.0, self.reach / np.maximum(r, 1e-300))[:, None]
        return np.asarray(self.at(inside) - 0.5 * np.maximum(r**2 - self.reach**2, 0.0))


class HostLikelihood(sk.HostData):
    """The likelihood of a stream for any host, its own parameters integrated out: a file in place of the stream.

    The file is one of ``streamkit export DIR --host-likelihood``. The host of the run file has the potentials, the
    bodies and the Sun of the fit that it comes from. Hosts outside the domain of the file are rejected.
    """

    kind = "host_likelihood"
    likelihood_details = ()
    example: ClassVar[dict[str, Any]] = {
        "table": sk.DataFile(EXAMPLE, hashlib.sha256(EXAMPLE.read_bytes()).hexdigest())
    }
    example_host: ClassVar[dict[str, float]] = {"potential.v0": 225.0, "potential.rs": 15.0}

    table: sk.DataFile = Field(description="File with the likelihood, as `streamkit export` writes it (ECSV).")

    @model_validator(mode="after")
    def _is_readable(self) -> Self:
        self.surface  # noqa: B018  a file that cannot be used is refused where it is named
        return self

    @cached_property
    def surface(self) -> Surface:
        """What the file holds; ValueError for a file that is none of a host's likelihood."""
        return read_surface(self.table.path.name, self.table.read_text())

    def reads(self) -> Mapping[str, str]:
        """Return the free parameters of the host in the stream's fit."""
        return self.surface.units

    def assumes(self) -> Mapping[str, Any]:
        """Return what else the host of the stream's fit was."""
        return self.surface.assumes

    def data(self) -> tuple[sk.Array, sk.Array]:
        """Return means and standard deviations of the host's coordinates for the stream alone."""
        return self.surface.centre, self.surface.errors

    def predict(self, host: sk.HostView) -> sk.Prediction:
        """Return the host's coordinates; none outside the domain of the file."""
        y = self.surface.coordinates(host.numbers)
        names = tuple(self.surface.units)
        if self.surface.has(y[None])[0]:
            return sk.Prediction(names, y, np.zeros(len(y)))
        why_not = f"the host is outside the domain of the likelihood of {self.surface.stream}"
        return sk.Prediction(names, np.full(len(y), np.nan), np.zeros(len(y)), why_not)

    def ln_likelihood(self, prediction: sk.Prediction, add_noise: bool) -> float | sk.Array | None:
        """Return the ln likelihood of the file, at one host or at many."""
        found = self.surface.ln_likelihood(np.atleast_2d(prediction.mean))
        return float(found[0]) if np.ndim(prediction.mean) == 1 else found

    def at_edge(self, prediction: sk.Prediction) -> bool:
        """Return whether a host that differs by `BEYOND` along an axis is outside the domain of the file."""
        steps = BEYOND * np.linalg.inv(self.surface.whiten)
        return not self.surface.has(prediction.mean + np.concatenate([steps, -steps])).all()

    def mock(self, prediction: sk.Prediction, rng: np.random.Generator) -> dict[str, Any]:
        """Raise StreamkitError: the data of the stream, from which mock data would be drawn, are not in the file."""
        raise sk.StreamkitError(
            f"a {self.kind} cannot be drawn anew: the file has the likelihood of the data of {self.surface.stream}, "
            "and not these data. Give the stream itself, with its observable, in place of the file"
        )

    def residuals(self, prediction: sk.Prediction, add_noise: bool) -> sk.Array | None:
        """(d,) Return how far the host is from that of the stream alone, in its standard deviations, uncorrelated."""
        return np.asarray((self.surface.centre - prediction.mean) @ self.surface.whiten)


def read_surface(name: str, text: str) -> Surface:
    """Read the text of a file; ValueError with a sentence for another one."""
    from astropy.table import Table  # slow to import
    from scipy.spatial import KDTree

    head = f"{name!r} is no likelihood of a host as `streamkit export --host-likelihood` writes it"
    try:
        table = Table.read(text + "\n", format="ascii.ecsv")
    except Exception as error:  # the format has errors of its own
        raise ValueError(f"{head}: no table in the format ECSV ({' '.join(str(error).split())[:200]})") from None
    meta = table.meta
    if meta.get("streamkit") != FORM:
        raise ValueError(f"{head}: found streamkit = {meta.get('streamkit')!r}, expected {FORM!r}")
    try:
        paths = [each for each in table.colnames if each not in (VALUE, ERROR)]
        values = np.array([np.asarray(table[path], dtype=float) for path in paths]).T
        is_log: sk.BoolArray = np.array([path in meta["logarithms"] for path in paths])
        y = np.where(is_log, np.log(np.where(is_log, values, 1.0)), values)
        centre, whiten = (np.array(meta[key], dtype=float) for key in ("centre", "whiten"))
        low, high = (np.array([math.nan if end is None else end for end in meta[key]]) for key in ("low", "high"))
        units = {path: _unit_of(table[path]) for path in paths}
        x = (y - centre) @ whiten
        there: sk.BoolArray = np.isfinite(np.asarray(table[VALUE], dtype=float))
        at = _interpolator(x[there], np.asarray(table[VALUE])[there], np.asarray(table[ERROR])[there], meta)
        return Surface(
            str(meta["stream"]), units, is_log, centre, whiten, float(meta["reach"]),
            np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high),
            partial(_among_known, KDTree(x), there), at, dict(meta["assumes"]),
        )  # fmt: skip
    except (KeyError, TypeError, ValueError, np.linalg.LinAlgError) as error:
        raise ValueError(f"{head}: it is damaged ({type(error).__name__}: {error})") from None


def _among_known(rows: Any, there: sk.BoolArray, x: sk.Array) -> sk.BoolArray:
    """(n,) Return whether most rows nearest to x (n, d) have a likelihood."""
    return np.asarray(there[rows.query(x, NEAREST)[1]].sum(axis=1) >= KNOWN, dtype=bool)


def _unit_of(column: Any) -> str:
    """Return the unit of a column as run files have it: astropy writes solar masses in two ways."""
    return "" if column.unit is None else sk.Unit(str(column.unit)).name.replace("solMass", "Msun")


def _interpolator(x: sk.Array, values: sk.Array, errors: sk.Array, meta: Mapping[str, Any]) -> Any:
    """Return ln likelihood (n,) at x (n, d): the mean of a Gaussian process about a quadratic function."""
    from scipy.interpolate import RBFInterpolator  # slow to import

    smoothing = (errors / float(meta["amplitude"])) ** 2
    epsilon = 1 / (math.sqrt(2) * float(meta["width"]))
    return RBFInterpolator(x, values, smoothing=smoothing, kernel="gaussian", epsilon=epsilon, degree=2)
