"""What is measured of a stream, and between a stream and a reference: another stream, or an N-body snapshot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from streamkit.integrals import offsets
from streamkit.march import orbital_plane
from streamkit.model import Model, measure
from streamkit.phase import Array, BoolArray, Prediction, Stream
from streamkit.spec import Setup, Spec

ARMS = {"leading": 1, "trailing": -1}
ENDS = 0.5
"""Per cent of the unbound particles beyond each end of the stream."""
CELL, KERNEL = 1.0, 3.0
"""Grid of angles and standard deviation of the smoothing kernel of the mean track, degrees."""
ENOUGH = 10.0
"""Effective particles under the kernel below which a track has no value."""
NEAR = 60.0
"""Radius about the progenitor, in kpc, of the near part of a track."""
LARGEST = 7200.0
"""Longest arm in degrees: twenty turns."""


@dataclass(frozen=True)
class Track:
    """The mean track of one arm, smoothed with a Gaussian kernel.

    Attributes
    ----------
    angle
        (k,) degrees from the progenitor in its orbital plane, counted positive along either arm.
    r, height
        (k,) mean distance from the centre within the plane, and mean height above it, kpc.
    width, thickness
        (k,) standard deviations of the two, kpc.
    density
        (k,) fraction of the stream's unbound particles per degree.
    count
        (k,) effective number of particles under the kernel, those in its far wings not counted.
    """

    angle: Array
    r: Array
    height: Array
    width: Array
    thickness: Array
    density: Array
    count: Array

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
    cells = int(min(angle.max(initial=0.0), LARGEST) / CELL) + len(kernel)
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


@dataclass(frozen=True)
class Portrait:
    """A stream with what is measured of it alone.

    Attributes
    ----------
    stream
        The stream.
    setup
        The run file it was made from, or is compared with: its host gives the energies.
    prediction
        What the observable says of it; None without one.
    """

    stream: Stream
    setup: Setup
    prediction: Prediction | None = None

    @cached_property
    def tracks(self) -> dict[str, Track]:
        """The mean track of each arm."""
        return {name: mean_track(self.stream, arm) for name, arm in ARMS.items()}

    @cached_property
    def integrals(self) -> tuple[Array | None, Array]:
        """Energy (n,) and angular momentum (n,) of the particles minus the progenitor's."""
        return offsets(self.stream, self.setup.potentials.values())

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Windings in degrees at the end of the trailing and of the leading tail; NaN without a stream."""
        free = ~self.stream.bound
        if not free.any():
            return np.nan, np.nan
        low, high = quantiles(np.degrees(self.stream.winding[free]), self.stream.weight[free], (ENDS, 100 - ENDS))
        return low, high

    def own(self) -> dict[str, float]:
        """Return what is measured of the stream alone: lengths, mean offsets of the tails, fraction bound."""
        stream = self.stream
        weight = stream.weight / stream.weight.sum()
        found = {"length_leading": max(self.ends[1], 0.0), "length_trailing": max(-self.ends[0], 0.0)}
        for what, values in zip(("energy", "angular_momentum"), self.integrals, strict=True):
            for name, arm in ARMS.items():
                chosen = stream.arm == arm
                found[f"{what}_offset_{name}"] = (
                    float(np.average(values[chosen], weights=weight[chosen]))
                    if values is not None and chosen.any()
                    else np.nan
                )
        found["bound"] = float(weight[stream.bound].sum())
        return found


def portrait(spec: Spec, theta: Array | Mapping[str, Any] | None = None) -> Portrait:
    """Return the portrait of the stream at parameters (d,), or a mapping of some; the rest at the prior's centre.

    Raises
    ------
    OutOfDomain, ComponentError
        As `Model.stream`.
    """
    setup = spec.bind(theta)
    stream, prediction = Model(spec).observe(setup)
    return Portrait(stream, setup, prediction)


def quantiles(values: Array, weights: Array, percent: Sequence[float]) -> tuple[float, ...]:
    """Return weighted percentiles, which are NumPy's own where the weights are equal."""
    order = np.argsort(values, kind="stable")
    w = weights[order]
    middle = np.cumsum(w) - 0.5 * (w + w[0])
    where = np.asarray(percent) / 100 * (middle[-1] if len(w) > 1 else 0.0)
    return tuple(np.interp(where, middle, values[order]).tolist())


def compare(this: Portrait, other: Portrait) -> dict[str, float]:
    """Return what is measured between a stream and a reference; NaN where there is nothing to measure."""
    found: dict[str, float] = {}
    lengths = [portrait.ends[1] - portrait.ends[0] for portrait in (this, other)]
    found["length_ratio"] = lengths[0] / lengths[1]
    for name in ARMS:
        found |= {f"{what}_{name}": value for what, value in _tracks(this, other, name).items()}
    found |= _distributions(this, other)
    return found


def _tracks(this: Portrait, other: Portrait, name: str) -> dict[str, float]:
    """Measure one arm's mean track against the reference's, point by point at equal angle, across the track.

    The distances are free of the noise that comes from the finite number of particles: its variance is taken off
    their mean square.
    """
    a, b = this.tracks[name], other.tracks[name]
    common = min(len(a.angle), len(b.angle))
    reach = min(arm.ends[1] if name == "leading" else -arm.ends[0] for arm in (this, other))
    cut = slice(0, common)
    good = (a.count[cut] >= ENOUGH) & (b.count[cut] >= ENOUGH) & (a.angle[cut] <= reach)
    slant = b.slant[cut]
    square = ((a.r[cut] - b.r[cut]) * slant) ** 2 + (a.height[cut] - b.height[cut]) ** 2
    noise = np.zeros(common)
    for track in (a, b):
        variance = (track.width[cut] * slant) ** 2 + track.thickness[cut] ** 2
        noise += variance / np.maximum(track.count[cut], 1.0)
    step = np.radians(CELL) * b.r[cut] / slant  # length of the reference's track in a cell
    near = good & _near(b, other)[cut]
    return {
        "track_near": _rms(square - noise, step, near),
        "track": _rms(square - noise, step, good),
        "width_ratio": _ratio(a.width[cut], b.width[cut], good),
        "thickness_ratio": _ratio(a.thickness[cut], b.thickness[cut], good),
    }


def _near(track: Track, of: Portrait) -> BoolArray:
    """(k,) True from the progenitor to where the track first leaves its surroundings."""
    q = of.stream.orbit.q[:, -1]
    angle = np.radians(track.angle)
    square = (track.r * np.cos(angle) - np.sqrt(q @ q)) ** 2 + (track.r * np.sin(angle)) ** 2 + track.height**2
    outside = (square > NEAR**2) & (track.count >= ENOUGH)
    return np.asarray(np.cumsum(outside) == 0)


def _rms(square: Array, step: Array, chosen: BoolArray) -> float:
    if not chosen.any():
        return np.nan
    return float(np.sqrt(max(np.average(square[chosen], weights=step[chosen]), 0.0)))


def _ratio(a: Array, b: Array, chosen: BoolArray) -> float:
    chosen = chosen & (b > 0)
    return float(np.median(a[chosen] / b[chosen])) if chosen.any() else np.nan


def _distributions(this: Portrait, other: Portrait) -> dict[str, float]:
    """Return Wasserstein distances: of E, L, and of the angle along each arm."""
    from scipy.stats import wasserstein_distance  # slow to import

    found: dict[str, float] = {}
    streams = this.stream, other.stream
    for what, i in (("energy", 0), ("angular_momentum", 1)):
        u, v = this.integrals[i], other.integrals[i]
        free = [~stream.bound for stream in streams]
        found[f"{what}_distance"] = (
            float(
                wasserstein_distance(u[free[0]], v[free[1]], *(s.weight[f] for s, f in zip(streams, free, strict=True)))
            )
            if u is not None and v is not None and free[0].any() and free[1].any()
            else np.nan
        )
    for name, arm in ARMS.items():
        members = [stream.arm == arm for stream in streams]
        found[f"density_distance_{name}"] = (
            float(
                wasserstein_distance(
                    *(np.degrees(s.winding[m]) for s, m in zip(streams, members, strict=True)),
                    *(s.weight[m] for s, m in zip(streams, members, strict=True)),
                )
            )
            if members[0].any() and members[1].any()
            else np.nan
        )
    return found


def pulls(this: Portrait, other: Portrait) -> dict[str, float]:
    """Return the observables' differences from the reference, measured alike, in standard errors of the data.

    Raises
    ------
    ComponentError
        If the observable fails on the reference.
    """
    found = observables(this)
    observable = this.setup.observable
    if not found or observable is None:
        return {}
    reference = measure(observable, other.stream)
    _, errors = observable.data()
    away = (np.array(list(found.values())) - reference.mean) / np.where(errors > 0, errors, np.nan)
    return {f"pull_{name}": value for name, value in zip(reference.names, away.tolist(), strict=True)}


def observables(this: Portrait) -> dict[str, float]:
    """Return the observables of a portrait; none where they have no value."""
    prediction = this.prediction
    if prediction is None or prediction.why_not:
        return {}
    return {f"observable_{name}": value for name, value in zip(prediction.names, prediction.mean.tolist(), strict=True)}
