"""What of a track was measured, and what only fills its columns.

The library's flags say what a paper gives. Its numbers do not always agree: distances of 1 kpc in place of none, or
that fall to a parsec; velocities of 1000 km/s and more, of zero, or splines through a few stars.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from streamkit import Array
from streamkit_galstreams.catalogue import Track

PLACEHOLDER = 1.0  # kpc, in place of a distance
NEAREST = 0.5  # kpc; a spline through few stars goes below
FASTEST = 600.0  # km/s, above the escape speed near the Sun; 999 and 1000 stand for none
SPLINES = ("ibata2021", "ibata2024")  # their velocities are splines through few stars, wrong at the ends
WIDEST = 3.0  # a distance that changes by more along one stream is told
SAME = 1e-6  # relative; a column is constant
ONE, ALONG = "one value", "along the stream"


@dataclass(frozen=True)
class Measured:
    """What a fit may use of a track, and why not the rest."""

    # "", `ONE` value for the whole stream, or `ALONG` it.
    distance: str
    proper_motion: str
    velocity: str
    start_velocity: bool  # whether its velocities may start a search, though they are no data
    faults: tuple[str, ...] = field(default=())  # what was found in the library's rows

    @property
    def dims(self) -> str:
        """Return s, d, p and v for sky, distance, proper motion and velocity, with - for what is missing."""
        return (
            "s"
            + ("d" if self.distance else "-")
            + ("p" if self.proper_motion else "-")
            + ("v" if self.velocity else "-")
        )

    @property
    def rank(self) -> tuple[int, int, int]:
        """How much is measured: a track with a higher rank is preferred."""
        full = bool(self.distance) and bool(self.proper_motion)
        return int(full), (self.distance == ALONG) + (self.proper_motion == ALONG), self.velocity == ALONG


def measured(track: Track) -> Measured:
    """Return what was measured of a track."""
    faults: list[str] = []
    distance = _distance(track, faults)
    motion = track.flags[2]
    if motion not in "01":
        faults.append(f"InfoFlag {motion} for the proper motion: not measured along the stream")
    velocity, start = _velocity(track, faults)
    return Measured(distance, ALONG if motion == "1" else "", velocity, start, tuple(faults))


def _distance(track: Track, faults: list[str]) -> str:
    values, flag = track.points["distance"], track.flags[1]
    if not np.isfinite(values).all():
        faults.append("a distance is no number")
        return ""
    constant = _constant(values)
    if constant and abs(values[0] - PLACEHOLDER) < SAME:
        faults.append("distance 1 kpc everywhere: a placeholder")
        return ""
    if values.min() < NEAREST:
        faults.append(f"distance falls to {values.min():.2g} kpc")
        return ""
    if constant:
        return ONE
    if flag != "1":
        faults.append(f"distance varies, and its InfoFlag {flag} says that it was not measured")
        return ""
    if values.max() > WIDEST * values.min():
        faults.append(f"distance from {values.min():.3g} to {values.max():.3g} kpc: look at its ends")
    return ALONG


def _velocity(track: Track, faults: list[str]) -> tuple[str, bool]:
    values, flag = track.points["radial_velocity"], track.flags[3]
    unknown = np.abs(values) < SAME
    if not np.isfinite(values).all() or unknown.all():
        return "", False
    fast = float(np.abs(values).max())
    if fast > FASTEST:
        if flag == "1":
            faults.append(f"a velocity of {fast:.3g} km/s: all dropped")
        return "", False
    if flag != "1":
        return "", _constant(values)
    if np.count_nonzero(unknown) > 1:
        faults.append("velocity 0 where it is unknown: all dropped")
        return "", False
    if track.paper in SPLINES:
        faults.append("velocity is a spline through few stars: it starts the search, and is no datum")
        return "", True
    return ALONG, True


def _constant(values: Array) -> bool:
    return bool(np.ptp(values) <= SAME * np.abs(values).max())
