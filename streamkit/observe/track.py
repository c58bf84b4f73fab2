"""The mean track of one arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from streamkit.stream import Array, Stream, orbital_plane

CELL, KERNEL = 1.0, 3.0  # grid of angles and standard deviation of the smoothing kernel of the mean track, degrees
ENOUGH = 10.0  # effective particles under the kernel below which a track has no value
LONGEST_ARM = 7200.0  # longest arm in degrees: twenty turns


@dataclass(frozen=True)
class Track:
    """The mean track of one arm, smoothed with a Gaussian kernel."""

    angle: Array  # (k,) degrees from the progenitor in its orbital plane, counted positive along either arm
    # (k,) mean distance from the centre within the plane, and mean height above it, kpc.
    r: Array
    height: Array
    # (k,) standard deviations of the two, kpc.
    width: Array
    thickness: Array
    density: Array  # (k,) fraction of the stream's unbound particles per degree
    count: Array  # (k,) effective number of particles under the kernel, without its far wings

    @cached_property
    def slant(self) -> Array:
        """(k,) Cosine of the angle between the track's normal and the radius: Delta r times it is across the track."""
        slope = np.gradient(self.r, np.radians(self.angle))
        return np.asarray(self.r / np.hypot(self.r, slope))


def mean_track(stream: Stream, arm: int) -> Track:
    """Return the mean track of the leading (1) or trailing (-1) arm."""
    plane = orbital_plane(stream.orbit)
    chosen = stream.arm == arm
    angle = np.degrees(np.abs(stream.winding[chosen]))
    x, y = plane @ stream.q[:, chosen]
    r, height = np.hypot(x, y), np.cross(*plane) @ stream.q[:, chosen]
    weight = stream.weight[chosen]
    wing = int(4 * KERNEL / CELL)
    kernel = np.exp(-0.5 * (np.arange(-wing, wing + 1) * CELL / KERNEL) ** 2)
    kernel /= kernel.sum()
    cells = int(min(angle.max(initial=0.0), LONGEST_ARM) / CELL) + len(kernel)
    cell = np.minimum(np.rint(angle / CELL).astype(np.int64), cells - 1)

    def smooth(values: Array, by: Array = kernel) -> Array:
        return np.convolve(np.bincount(cell, values, cells), by, mode="same")

    total = smooth(weight)
    safe = np.where(total > 1e-9, total, np.nan)  # no particle, no track
    mean_r, mean_h = smooth(weight * r) / safe, smooth(weight * height) / safe
    return Track(
        angle=np.arange(float(cells)) * CELL,
        r=mean_r,
        height=mean_h,
        width=np.sqrt(np.maximum(smooth(weight * r * r) / safe - mean_r**2, 0.0)),
        thickness=np.sqrt(np.maximum(smooth(weight * height * height) / safe - mean_h**2, 0.0)),
        density=total / CELL / max(float(stream.weight[~stream.bound].sum()), 1e-12),
        count=np.nan_to_num(np.minimum(safe**2 / smooth(weight**2, kernel**2), total / (kernel**2).sum())),
    )


def quantiles(values: Array, weights: Array, percent: Sequence[float]) -> tuple[float, ...]:
    """Return weighted percentiles, which are NumPy's own where the weights are equal."""
    order = np.argsort(values, kind="stable")
    w = weights[order]
    middle = np.cumsum(w) - 0.5 * (w + w[0])
    where = np.asarray(percent) / 100 * (middle[-1] if len(w) > 1 else 0.0)
    return tuple(np.interp(where, middle, values[order]).tolist())
