"""The stars of a catalogue in the frame and window of a stream, checked, with the knots along it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

import streamkit as sk
from streamkit.builtin.observables.stars.knots import Knots, knots_between
from streamkit.builtin.observables.track.columns import COLUMNS, within
from streamkit.builtin.observables.track.members import ERRORS, MEMBERS, MOTIONS, members_of, which_columns
from streamkit.engine import SingleStars

DENSITY, RATIO = "background_density", "colour_ratio"
STARS = MEMBERS.optional(**{DENSITY: "", RATIO: ""}).positive(DENSITY, RATIO, "distance", *ERRORS)
# The two rows are the ends.
WINDOW = (
    sk.Columns(phi1="deg")
    .optional(**{name: column.unit for name, column in COLUMNS.items()})
    .between("phi2", -90, 90)
    .increasing("phi1")
)
FEWEST = 10  # stars
ROUNDING = 1e-6  # of the window: a star at its end may be beyond it in the last digits of a table
HOURS, TURN, QUARTER = 24.0, 2 * np.pi, 0.5 * np.pi


@dataclass(frozen=True, eq=False)
class Catalogue:
    """N stars, and K knots.

    Attributes
    ----------
    phi1
        (N,) degrees, within half a turn of the middle of the window.
    values, variances
        (N,) by column: what was measured and its squared error; NaN and 1 where a star has no value.
    covariance
        (N,) of the errors of the two proper motions, (mas/yr)^2; 0 without proper motions.
    ln_background
        (N,) ln density of field stars at the star's phi1, in the columns that it has; None if it is not known.
    ln_ratio
        (N,) ln of the density of the stream in colours and magnitudes over that of the field.
    knots
        The knots, and the weights from them to the stars.
    """

    phi1: sk.Array
    values: Mapping[str, sk.Array]
    variances: Mapping[str, sk.Array]
    covariance: sk.Array
    ln_background: sk.Array | None
    ln_ratio: sk.Array
    knots: Knots

    def __len__(self) -> int:
        return len(self.phi1)

    @cached_property
    def for_engine(self) -> SingleStars:
        """The same numbers in the arrays that the engine reads."""
        first, cubic = self.knots.cubic_from()
        linear = np.take_along_axis(self.knots.linear.toarray(), self.knots.left[:, None] + np.arange(2), axis=1)
        pair = [self.columns.index(name) for name in MOTIONS] if self.paired else [-1, -1]
        field = self.ln_background
        return SingleStars(
            self.knots.left, first, linear, cubic, np.stack(list(self.values.values()), axis=1),
            np.stack(list(self.variances.values()), axis=1), np.ascontiguousarray(self.covariance, dtype=float),
            np.zeros(len(self)) if field is None else np.ascontiguousarray(field, dtype=float),
            np.ascontiguousarray(self.ln_ratio, dtype=float), np.array(pair), field is not None,
        )  # fmt: skip

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns that are compared."""
        return tuple(self.values)

    @property
    def paired(self) -> bool:
        """Whether both proper motions are compared, with their covariance."""
        return set(MOTIONS) <= set(self.values)


@lru_cache(maxsize=8)  # a free parameter makes the observable anew at each call, with the same stars
def catalogue_of(
    table: sk.Table, matrix: tuple[tuple[float, ...], ...], window: sk.Table, compared: Sequence[str] | None, count: int
) -> Catalogue:
    """Return the stars in the frame of a matrix from ICRS; ValueError says which star is not allowed, and why."""
    if len(table) < FEWEST:
        raise ValueError(f"found {len(table)} stars, expected at least {FEWEST}")
    stars = members_of(table, matrix)
    columns = which_columns(stars, compared)
    low, high = ends_of(window)["phi1"]
    phi1 = within(stars.phi1, 0.5 * (low + high))
    check_inside(table, {"phi1": phi1} | dict(stars.values), window)
    values = {name: np.asarray(stars.values[name], dtype=float) for name in columns}
    there = {name: np.isfinite(column) for name, column in values.items()}
    variances = {name: np.where(there[name], stars.errors[name] ** 2, 1.0) for name in columns}
    both = np.logical_and.reduce([there[name] for name in MOTIONS]) if set(MOTIONS) <= set(columns) else False
    covariance = np.where(both, np.nan_to_num(stars.covariance), 0.0)
    ln_background = np.log(table[DENSITY]) if DENSITY in table else None
    ln_ratio = np.log(table[RATIO]) if RATIO in table else np.zeros(len(table))
    return Catalogue(
        phi1, values, variances, covariance, ln_background, ln_ratio, knots_between(low, high, count, phi1)
    )


def ends_of(window: sk.Table) -> dict[str, tuple[float, float]]:
    """Return the ends of each column of a window; ValueError unless there are two, in increasing order."""
    if len(window) != 2:
        raise ValueError(f"window: found {len(window)} numbers for each column, expected two: its ends")
    ends = {name: (float(window[name][0]), float(window[name][1])) for name in window.names}
    for name, (low, high) in ends.items():
        if not low < high:
            raise ValueError(f"window: {name} = [{low:g}, {high:g}], expected the lower end first")
    if ends["phi1"][1] - ends["phi1"][0] > 360:
        raise ValueError("window: phi1 runs over more than a turn")
    return ends


def check_inside(table: sk.Table, values: Mapping[str, sk.Array], window: sk.Table) -> None:
    """Refuse stars outside the window; ValueError has their number, the first of them, and the likely mistake."""
    for name, (low, high) in ends_of(window).items():
        if name not in values:
            raise ValueError(f"window: the stars have no {name}; they have {', '.join(values)}")
        column = values[name]
        beyond = ROUNDING * (high - low)
        outside = (column < low - beyond) | (column > high + beyond)
        if not outside.any():
            continue
        unit = COLUMNS[name].unit if name in COLUMNS else "deg"
        first = int(np.argmax(outside))
        raise ValueError(
            f"{int(outside.sum())} of {len(column)} are outside the window, {name} = {low:g} to {high:g} {unit}. "
            f"The first is row {first + 1} with {name} = {column[first]:.6g} {unit}, and all lie from "
            f"{np.nanmin(column):.6g} to {np.nanmax(column):.6g}. {_hint(table, name)}"
        )


def _hint(table: sk.Table, name: str) -> str:
    """Return the likely mistake in a table whose stars are outside the window."""
    ra, dec = table["ra"], table["dec"]
    if name in ("phi1", "phi2") and np.ptp(ra) < TURN and (np.abs(dec) <= QUARTER).all() and (ra <= TURN).all():
        return (
            "All ra and dec would be angles in radians. Are they? Then write "
            'stars = { file = "...", units = { ra = "rad", dec = "rad" } }'
        )
    if name in ("phi1", "phi2") and ((ra >= 0) & (ra <= HOURS)).all():
        return 'All ra lie within 24. Are they in hours? Then add units = { ra = "hourangle" } to the table.'
    return "Cut the table to the window, or widen the window; also check the frame."
