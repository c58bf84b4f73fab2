"""A few points of a track in a frame of its own, with errors: the data of a run file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit import Array, SkyFrame, sky_frame
from streamkit_galstreams.catalogue import Track
from streamkit_galstreams.measured import ALONG, ONE, Measured, measured
from streamkit_galstreams.widths import COLUMNS as WIDTHS
from streamkit_galstreams.widths import width_of

POINTS = 8
MARGIN = 0.03  # of the length, at both ends: splines are worst there
DISTANCE, VELOCITY = 0.1, 10.0  # errors of a distance (relative) and of a velocity in km/s: the library has none


@dataclass(frozen=True, eq=False)
class Points:
    """A stream as a run file has it."""

    track: Track
    measured: Measured
    frame: SkyFrame  # phi2 = 0 is the great circle nearest to the track
    # columns (n,) by name, in deg, kpc, mas/yr and km/s; phi1 and those that were measured along the stream
    columns: dict[str, Array]
    errors: dict[str, tuple[float, str]]  # the error of each column and where it is from; of a distance relative
    middle: dict[str, float]  # the values in the middle, also those that are no data; NaN where there is none

    @property
    def length(self) -> float:
        """The length of the observed stretch in degrees."""
        return float(np.ptp(self.columns["phi1"]))


def points_of(track: Track) -> Points:
    """Return `POINTS` points of a track, at even distances; ValueError if it lies along no great circle."""
    found, given = measured(track), track.points
    frame = sky_frame(stars=(given["ra"], given["dec"]))
    places = frame.from_icrs(*(given[name] for name in ("ra", "dec", "pm_ra_cosdec", "pm_dec")))
    order = np.argsort(places.phi1)
    along = places.phi1[order]
    margin = MARGIN * np.ptp(along)
    span = np.linspace(along[0] + margin, along[-1] - margin, POINTS)
    grid: Array = np.asarray(np.round(span, 1 if np.ptp(along) > 8 else 2))

    def at(values: Array, where: Array) -> Array:
        return np.asarray(np.interp(where, along, values[order]))

    every = {
        "phi2": places.phi2,
        "distance": given["distance"],
        "pm_phi1_cosphi2": places.pm_phi1_cosphi2,
        "pm_phi2": places.pm_phi2,
        "radial_velocity": given["radial_velocity"],
    }
    used = {
        "phi2": True,
        "distance": found.distance == ALONG,
        "pm_phi1_cosphi2": found.proper_motion == ALONG,
        "pm_phi2": found.proper_motion == ALONG,
        "radial_velocity": found.velocity == ALONG,
    }
    starts = used | {"distance": found.distance in (ALONG, ONE), "radial_velocity": found.start_velocity}
    columns = {"phi1": grid} | {name: at(every[name], grid) for name, is_used in used.items() if is_used}
    centre = np.array([grid.mean()])
    middle = {name: float(at(every[name], centre)[0]) if starts[name] else float("nan") for name in every}
    return Points(track, found, frame, columns, _errors(track, columns), middle | {"phi1": float(centre[0])})


def _errors(track: Track, columns: dict[str, Array]) -> dict[str, tuple[float, str]]:
    errors: dict[str, tuple[float, str]] = {name: width_of(track, name) for name in WIDTHS if name in columns}
    if "distance" in columns:
        errors["distance"] = DISTANCE, "10 %, our guess"
    if "radial_velocity" in columns:
        errors["radial_velocity"] = VELOCITY, "our guess"
    return errors
