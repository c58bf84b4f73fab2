"""The track of a stream on the sky: mean, spread and covariance on a grid of phi1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from streamkit.stream.arrays import Array, freeze
from streamkit.stream.frames import Seen

if TYPE_CHECKING:
    from astropy.table import QTable

# The columns of a track, with their units by astropy's names.
TRACK_UNITS = {
    "phi2": "deg", "distance": "kpc", "pm_phi1_cosphi2": "mas/yr", "pm_phi2": "mas/yr", "radial_velocity": "km/s",
}  # fmt: skip
STEP = 0.5  # step of the default grid of longitudes, in kernels
FEWEST = 5.0  # fewest particles under the kernel: with fewer a track has no value
REACH = 5.0  # distance in kernels beyond which a particle does not count


@dataclass(frozen=True, repr=False)
class SkyTrack:
    """The mean track of the debris on the sky, by local lines; made by `Stream.track`. Units as in `Stream.seen`.

    The rows are those of `names`: phi2, distance, pm_phi1_cosphi2, pm_phi2, radial_velocity.

    Attributes
    ----------
    phi1
        (k,) longitudes, degrees.
    mean
        (5, k) the local lines there; NaN where the kernel has fewer than five particles.
    covariance
        (5, 5, k) of the debris about the lines.
    error
        (5, k) standard errors of the mean, from the finite number of particles.
    count
        (k,) number of particles under the kernel, times their weights.
    kernel
        Standard deviation of the kernel, degrees.
    """

    phi1: Array
    mean: Array
    covariance: Array
    error: Array
    count: Array
    kernel: float

    names = tuple(TRACK_UNITS)

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.phi1)

    def __repr__(self) -> str:
        return f"<SkyTrack at {len(self)} phi1 from {self.phi1.min():g} to {self.phi1.max():g} deg>"

    def __getitem__(self, name: str) -> Array:
        """(k,) The mean of a column; KeyError for another name."""
        return np.asarray(self.mean[self._row(name)])

    @property
    def spread(self) -> Array:
        """(5, k) Standard deviations of the debris about the lines."""
        return np.asarray(np.sqrt(np.einsum("iik->ik", self.covariance)))

    def correlation(self, one: str, other: str) -> Array:
        """(k,) Correlation of two columns of the debris about the lines; KeyError for another name."""
        i, j = self._row(one), self._row(other)
        return np.asarray(self.covariance[i, j] / (self.spread[i] * self.spread[j]))

    def _row(self, name: str) -> int:
        if name not in self.names:
            raise KeyError(f"a track has no column {name!r}; it has {', '.join(self.names)}")
        return self.names.index(name)

    def table(self) -> QTable:
        """Return one row per phi1 as an astropy QTable.

        For every column its mean, ``_spread``, ``_error`` and the ``_correlation_`` with each column after it; and
        the count of particles.
        """
        from astropy import units as u  # slow to import
        from astropy.table import QTable

        table = QTable({"phi1": self.phi1 * u.deg, "particles": self.count})
        parts = zip(TRACK_UNITS.items(), self.mean, self.spread, self.error, strict=True)
        for (name, unit), mean, spread, error in parts:
            table[name], table[f"{name}_spread"] = mean * u.Unit(unit), spread * u.Unit(unit)
            table[f"{name}_error"] = error * u.Unit(unit)
        for i, one in enumerate(self.names):
            for other in self.names[i + 1 :]:
                table[f"{one}_correlation_{other}"] = self.correlation(one, other)
        table.meta["kernel_deg"] = self.kernel
        return table

    def _repr_html_(self) -> Any:
        return self.table()[["phi1", *self.names]]._repr_html_()


def track_of(longitude: Array, seen: Seen, weight: Array, at: Array, kernel: float, turn: bool) -> SkyTrack:
    """Fit lines to debris (n,) at longitudes (k,) by weighted least squares with a Gaussian kernel, all in degrees.

    Where longitudes are those of one ``turn``, kernels continue beyond its ends.
    """
    columns = np.array([seen.lat, seen.distance, seen.pm_lon_coslat, seen.pm_lat, seen.radial_velocity])
    if turn:
        below, above = longitude.min() + REACH * kernel, longitude.max() - REACH * kernel
        copies = np.flatnonzero(longitude > above), np.flatnonzero(longitude < below)
        which = np.concatenate([*copies, np.arange(len(longitude))])
        shifts = np.repeat([-360.0, 360.0, 0.0], [*(len(part) for part in copies), len(longitude)])
        longitude, columns, weight = longitude[which] + shifts, columns[:, which], weight[which]
    order = np.argsort(longitude)
    longitude, columns, weight = longitude[order], columns[:, order], weight[order]
    c, k = len(columns), len(at)
    mean, error, covariance = np.full((c, k), np.nan), np.full((c, k), np.nan), np.full((c, c, k), np.nan)
    count = np.zeros(k)
    for i, phi in enumerate(at.tolist()):
        low, high = np.searchsorted(longitude, [phi - REACH * kernel, phi + REACH * kernel])
        x = (longitude[low:high] - phi) / kernel
        share = weight[low:high] * np.exp(-0.5 * x * x)
        count[i] = share.sum()
        if not count[i] >= FEWEST:
            continue
        share = share / count[i]
        y, centre = columns[:, low:high], float(share @ x)
        width = max(float(share @ (x - centre) ** 2), 1e-12)
        slope = (y @ (share * (x - centre))) / width
        mean[:, i] = y @ share - slope * centre
        rest = y - mean[:, i, None] - np.outer(slope, x)
        covariance[:, :, i] = (rest * share) @ rest.T
        error[:, i] = np.sqrt((rest * share * (1 - centre * (x - centre) / width)) ** 2 @ np.ones(len(x)))
    return SkyTrack(at, mean, covariance, error, count, kernel)


def even_grid(longitude: Array, kernel: float) -> Array:
    """(k,) An even grid of longitudes, in steps of half a kernel, over nearly all of the debris (n,)."""
    low, high = np.percentile(longitude, [0.5, 99.5]).tolist()
    steps = STEP * kernel
    return np.arange(np.ceil(low / steps), np.floor(high / steps) + 1) * steps


def within_half_turn(angle: Array, middle: float) -> Array:
    """(n,) Angles in degrees within half a turn of the middle."""
    return np.asarray(angle - 360.0 * np.round((angle - middle) / 360.0))


def grid_from(phi1: Sequence[float] | Array) -> Array:
    """(k,) The given longitudes; ValueError unless they are finite numbers in one dimension."""
    at = np.atleast_1d(np.asarray(phi1, dtype=float))
    if at.ndim != 1 or not at.size or not np.isfinite(at).all():
        raise ValueError("phi1 must be a list of finite numbers in degrees")
    return at
