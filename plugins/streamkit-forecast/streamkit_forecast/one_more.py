"""What one more datum at each longitude of a stream would give: the bounds with it beside all data of the run file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from streamkit import Array, Model, Observable, OutOfDomain, Spec
from streamkit_forecast.information import without_noise
from streamkit_forecast.quantities import Quantity
from streamkit_forecast.slopes import Slopes
from streamkit_forecast.surveys import own_track, track

PLACES = 25  # longitudes along a stream
ENDS = 1.0, 99.0  # percentiles of the debris between which they lie
# Errors of a star where the stream has no such column: Gaia's at G = 18, a photometric distance's, and DESI's.
TYPICAL = {"phi2": 0.1, "distance": 1.0, "pm_phi1_cosphi2": 0.1, "pm_phi2": 0.1, "radial_velocity": 5.0}
UNITS = {"phi2": "deg", "distance": "kpc", "pm_phi1_cosphi2": "mas/yr", "pm_phi2": "mas/yr", "radial_velocity": "km/s"}


@dataclass(frozen=True)
class Gain:
    """One more datum of a column along a stream: its error, and the sds (places, q) of all quantities with it."""

    source: str
    column: str
    unit: str
    error: float
    phi1: Array
    sd: Array


def one_more_of(spec: Spec, stream: str, theta: Array, errors: Mapping[str, float]) -> Observable | None:
    """Return a track of single data at even longitudes along a stream; None where it has no track of its own.

    A datum is a mean where the stream's own are means, and else a star.
    """
    inputs = spec.bind(theta, stream)
    like: Any = own_track(inputs)
    if like is None:
        return None
    try:
        made = Model(spec).stream(theta, stream)
    except OutOfDomain:  # said where the slopes are taken
        return None
    free = ~made.bound
    longitude = made.unwrapped_longitude(like.frame) if like.unwrapped else made.seen(like.frame).lon
    middle = float(np.median(longitude[free]))
    if not like.unwrapped:
        longitude = middle + (longitude - middle + 180.0) % 360.0 - 180.0
    low, high = np.percentile(longitude[free], ENDS)
    phi1 = np.round(np.linspace(low, high, PLACES), 1)
    typical = {name: float(np.median(error)) for name, (_, _, error) in like.given.items()}
    whole = {name: errors.get(name, typical.get(name, error)) for name, error in TYPICAL.items()}
    means = typical.keys() - {*like.stars, *(like.members.names if like.members is not None else ())}
    return track(spec, inputs, phi1, whole, stars=[name for name in whole if name not in means])


def gains_of(slopes: Slopes, covariance: Array, quantities: Sequence[Quantity]) -> list[Gain]:
    """Return the gains of all columns of one stream beside a covariance (d, d) of the coordinates.

    One more datum with the slopes j and the variance s2 changes the covariance C by -C j j C / (s2 + j C j).
    """
    part = next((each for each in slopes.parts if each.one_more), None)
    if part is None:
        return []
    observable: Any = part.measurement
    start = sum(len(each.used) for each in slopes.parts[: slopes.parts.index(part)])
    along = np.array([quantity.slopes for quantity in quantities])
    now = np.einsum("qa,ab,qb->q", along, covariance, along)
    found = []
    for column, rows in observable.quantities().items():
        j = np.zeros((len(slopes.of_mean), len(rows), len(covariance)))  # by seed
        j[:, :, slopes.which] = slopes.of_mean[:, start + rows]
        moved = j @ covariance
        seen = _product(moved @ along.T, moved @ along.T)
        whole = slopes.variance[start + rows] + _product(moved, j).sum(axis=1)
        sd = np.sqrt(np.maximum(now - seen / whole[:, None], 0.0))
        phi1, _, error = observable.given[column]
        found.append(Gain(slopes.source, column, UNITS[column], float(error[0]), np.asarray(phi1), sd))
    return found


def _product(one: Array, other: Array) -> Array:
    """(n, q) Products of numbers (seeds, n, q) of different seeds; negative ones, which are noise, are none."""
    whole, same = one.sum(axis=0) * other.sum(axis=0), (one * other).sum(axis=0)
    return np.asarray(np.maximum(without_noise(whole, same, len(one)), 0.0))
