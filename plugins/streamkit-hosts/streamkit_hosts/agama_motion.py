"""Numbers of AGAMA that change in time: the modifiers `center` and `rotation`, and `UniformAcceleration`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PchipInterpolator

from streamkit import GYR, Array, StreamkitError
from streamkit_hosts.ini import Section
from streamkit_hosts.text import text_of

MOST_BYTES = 50_000_000  # of a file
MOST_ROWS = 20_000
MOST_KNOTS = 1000  # of a number in a run file
PRECISION = 1e-4  # of a number between its knots, in the range of its values
EVER = 20.0  # Gyr: so far before and after its rows a number goes on, as a straight line


@dataclass(frozen=True)
class Curve:
    """K numbers in time: cubics through values with slopes, and straight lines beyond the ends, as in AGAMA.

    A single row holds at all times. It is hashable: parts of a host with equal curves are put together.
    """

    rows: tuple[tuple[float, ...], ...]  # of 1 + 2 K numbers: the time, the values, the slopes

    @property
    def in_time(self) -> bool:
        """Whether the numbers change."""
        return len(self.rows) > 1

    @property
    def columns(self) -> tuple[Array, Array, Array]:
        """The times (T,), the values (T, K) and the slopes (T, K)."""
        table = np.array(self.rows)
        count = (table.shape[1] - 1) // 2
        return table[:, 0], table[:, 1 : 1 + count], table[:, 1 + count :]

    def changed(self, time: float, value: float, today: float) -> Curve:
        """Return it in units that are smaller by these factors, with ``today`` (in the file's unit) at 0."""
        t, values, slopes = self.columns
        return _curve((t - today) * time, values * value, slopes * (value / time))

    def centre(self) -> dict[str, list[float]]:
        """Return the columns of a `centre` of a curve in kpc and Gyr: a single row for a place at rest."""
        t, q, slopes = self.columns
        columns = {"t": t, **dict(zip("xyz", q.T, strict=True))}
        if self.in_time:
            columns |= dict(zip(("vx", "vy", "vz"), slopes.T / GYR, strict=True))
        return {name: column.tolist() for name, column in columns.items()}

    def knots(self, k: int, where: str) -> dict[str, list[float]]:
        """Return number k as the knots of a run file: a monotone cubic through them is as near as `PRECISION`.

        Beyond the rows it goes on for `EVER`. StreamkitError with ``where`` if it needs more than `MOST_KNOTS`.
        """
        t, values, slopes = self.columns
        y, slope = values[:, k], slopes[:, k]
        exact = CubicHermiteSpline(t, y, slope)
        limit, knots, share = PRECISION * max(float(np.ptp(y)), 1e-300), t[[0, -1]], np.arange(1, 8) / 8
        while True:  # a knot in the middle of each piece that is not near enough: few, but at extrema
            fine = knots[:-1, None] + np.diff(knots)[:, None] * share
            far = np.abs(PchipInterpolator(knots, exact(knots))(fine) - exact(fine)).max(axis=1) > limit
            if not far.any():
                break
            knots = np.sort(np.concatenate([knots, 0.5 * (knots[1:] + knots[:-1])[far]]))
            if len(knots) > MOST_KNOTS - 2:
                raise StreamkitError(f"{where} changes so fast that a run file would need more than {MOST_KNOTS} knots")
        times, found = knots.tolist(), exact(knots).tolist()
        return {
            "times": [_short(time) for time in (times[0] - EVER, *times, times[-1] + EVER)],
            "values": [_short(v) for v in (found[0] - EVER * slope[0], *found, found[-1] + EVER * slope[-1])],
        }


def curve_of(section: Section, name: str, count: int) -> Curve:
    """Return ``count`` numbers of a parameter: the numbers, a table ``[[t, ...], ...]``, or a file with such rows.

    A table may have the slopes too. Without them they are those of a natural cubic spline, limited as by Hyman (1983,
    SIAM J. Sci. Stat. Comput. 4, 645). StreamkitError with a sentence for anything else.
    """
    text = section.parameters[name].strip()
    fixed = _numbers(re.sub(r"^[\[(]|[\])]$", "", text))
    if fixed is not None and len(fixed) == count:
        return _curve(np.zeros(1), np.array([fixed]), np.zeros((1, count)))
    where = f"{section.where}: {name}"
    if text[:1] in "[(":
        rows = [_numbers(row) for row in re.findall(r"[\[(]([^\[\]()]*)[\])]", text[1:-1])]
    else:
        lines = text_of(_file(section, name, text, count), MOST_BYTES).splitlines()
        rows = [_numbers(line) for line in lines if line.strip()[:1] and line.strip()[0] in "0123456789+-."]
    good = [row for row in rows if row is not None and len(row) in (1 + count, 1 + 2 * count)]
    if len(good) != len(rows) or len({len(row) for row in good}) != 1 or not 1 <= len(good) <= MOST_ROWS:
        raise StreamkitError(
            f"{where} is {text[:60]!r}; expected {count} number(s), or rows of a time and {count} number(s), with or "
            f"without their slopes, at most {MOST_ROWS}"
        )
    table = np.array(good)
    t, values = table[:, 0], table[:, 1 : 1 + count]
    if not np.isfinite(table).all() or (np.diff(t) <= 0).any():
        raise StreamkitError(f"{where}: expected finite numbers at times that increase")
    if len(t) == 1:
        return _curve(np.zeros(1), values, np.zeros_like(values))
    return _curve(t, values, table[:, 1 + count :] if table.shape[1] > 1 + count else _slopes(t, values))


def _curve(t: Array, values: Array, slopes: Array) -> Curve:
    return Curve(tuple(map(tuple, np.column_stack([t, values, slopes]).tolist())))


def _slopes(t: Array, values: Array) -> Array:
    """(T, K) Return the slopes of natural cubic splines, none steeper than three times the lines on either side."""
    lines = np.diff(values, axis=0) / np.diff(t)[:, None]
    before, after = np.concatenate([lines[:1], lines]), np.concatenate([lines, lines[-1:]])
    slopes = CubicSpline(t, values, bc_type="natural")(t, 1) if len(t) > 2 else before
    sign = np.where(before * after < 0, np.sign(slopes), np.sign(before))
    limited = sign * np.minimum(np.abs(slopes), 3.0 * np.minimum(np.abs(before), np.abs(after)))
    for end in (0, -1):
        limited[end] = np.where(slopes[end] * before[end] < 0, 0.0, limited[end])
    return np.asarray(limited)


def _numbers(text: str) -> list[float] | None:
    """Return the numbers of a row, up to a remark; None if there is something else."""
    try:
        return [float(word) for word in text.partition("#")[0].replace(",", " ").replace(";", " ").split()]
    except ValueError:
        return None


def _file(section: Section, name: str, text: str, count: int) -> Path:
    file = section.file.parent / text
    if not file.is_file():
        raise StreamkitError(
            f"{section.where}: {name} is {text[:60]!r}; expected {count} number(s), a table [[time, ...], ...] or a "
            "file with its rows"
        )
    return file


def _short(number: float) -> float:
    return float(f"{number:.10g}")
