"""Measures of one stream, and of a stream against a reference: another stream, or an N-body snapshot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from streamkit.model import Host, Model
from streamkit.observe import CELL, ENOUGH, Track, mean_track, measure_stream, quantiles
from streamkit.runfile import Spec, StreamInputs
from streamkit.stream import ARMS, Array, BoolArray, Prediction, Stream
from streamkit.units import GYR

ENDS = 0.5  # per cent of the unbound particles beyond each end of the stream
NEAR = 60.0  # radius about the progenitor, in kpc, of the near part of a track
BIN = 0.1 * GYR  # width of the bins in stripping time in which a stripping rate is matched


def angular_momentum(q: Array, v: Array) -> Array:
    """(n,) Total angular momentum in kpc km/s at positions q and velocities v (3, n)."""
    return np.asarray(np.sqrt((np.cross(q.T, v.T) ** 2).sum(axis=1)))


@dataclass(frozen=True)
class Portrait:
    """A stream, its measures, and the prediction of the observables, if there are any.

    The energies are those in the host of the run file that the stream was made from, or is compared with. A reference
    that is no variant has a ``title``: "N-body" for a snapshot, the kind of its scheme for a live progenitor.
    """

    stream: Stream
    inputs: StreamInputs
    prediction: Prediction | None = None
    title: str = ""

    @cached_property
    def tracks(self) -> dict[str, Track]:
        """The mean track of each arm."""
        return {name: mean_track(self.stream, arm) for name, arm in ARMS.items()}

    @cached_property
    def integrals(self) -> tuple[Array | None, Array]:
        """Energy (n,) and angular momentum (n,) of the particles minus the progenitor's."""
        host = Host(self.inputs.potentials, self.inputs.bodies, self.inputs.companion)
        stream, core = self.stream, self.stream.orbit
        energy, of_core = host.energy(stream.q, stream.v), host.energy(core.q[:, -1:], core.v[:, -1:])
        momentum = angular_momentum(stream.q, stream.v) - angular_momentum(core.q[:, -1:], core.v[:, -1:])
        return None if energy is None or of_core is None else energy - of_core, momentum

    @property
    def moves(self) -> bool:
        """Whether a body moves about the host: energies are then not conserved."""
        return bool(self.inputs.bodies) or self.inputs.companion is not None

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Windings in degrees at the end of the trailing and of the leading tail; NaN without a stream."""
        free = ~self.stream.bound
        if not free.any():
            return np.nan, np.nan
        low, high = quantiles(np.degrees(self.stream.winding[free]), self.stream.weight[free], (ENDS, 100 - ENDS))
        return low, high

    def measures(self) -> dict[str, float]:
        """Return the measures of the stream alone: lengths, mean offsets of the tails, fraction bound."""
        stream = self.stream
        weight = stream.weight / stream.weight.sum()
        measures = {"length_leading": max(self.ends[1], 0.0), "length_trailing": max(-self.ends[0], 0.0)}
        for what, values in zip(("energy", "angular_momentum"), self.integrals, strict=True):
            for name, arm in ARMS.items():
                chosen = stream.arm == arm
                measurable = values is not None and chosen.any()
                mean = float(np.average(values[chosen], weights=weight[chosen])) if measurable else np.nan  # type: ignore[index]
                measures[f"{what}_offset_{name}"] = mean
        measures["bound"] = float(weight[stream.bound].sum())
        return measures


def portrait(spec: Spec) -> Portrait:
    """Return the portrait of the stream at the prior's centre; raises as `Model.stream`."""
    inputs = spec.bind()
    made, prediction = Model(spec).observe(inputs)
    return Portrait(made, inputs, prediction)


def portrait_of(stream: Stream, inputs: StreamInputs, *, title: str = "") -> Portrait:
    """Return the portrait of a given stream, with the prediction of the run file's observables."""
    return Portrait(stream, inputs, measure_stream(inputs.observables, stream), title)


def compare(this: Portrait, other: Portrait) -> dict[str, float]:
    """Return the measures of a stream against a reference; NaN where there is nothing to measure."""
    lengths = [portrait.ends[1] - portrait.ends[0] for portrait in (this, other)]
    measures = {"length_ratio": lengths[0] / lengths[1]}
    for name in ARMS:
        measures |= {f"{what}_{name}": value for what, value in _tracks(this, other, name).items()}
    return measures | _distributions(this, other)


def _tracks(this: Portrait, other: Portrait, name: str) -> dict[str, float]:
    """Measure one arm's mean track against the reference's, point by point at equal angle, across the track.

    The variance of the noise from the finite number of particles is subtracted from the mean square of the distances.
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
    near_part = good & _near(b, other)[cut]
    return {
        "track_near": _rms(square - noise, step, near_part),
        "track": _rms(square - noise, step, good),
        "width_ratio": _ratio(a.width[cut], b.width[cut], good),
        "thickness_ratio": _ratio(a.thickness[cut], b.thickness[cut], good),
    }


def _near(track: Track, of: Portrait) -> BoolArray:
    """(k,) True from the progenitor to the first point of the track outside its surroundings."""
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

    def distance(u: Array | None, v: Array | None, chosen: Sequence[BoolArray]) -> float:
        if u is None or v is None or not (chosen[0].any() and chosen[1].any()):
            return np.nan
        weights = (p.stream.weight[members] for p, members in zip((this, other), chosen, strict=True))
        return float(wasserstein_distance(u[chosen[0]], v[chosen[1]], *weights))

    distances = {}
    for i, what in enumerate(("energy", "angular_momentum")):
        free = [~portrait.stream.bound for portrait in (this, other)]
        distances[f"{what}_distance"] = distance(this.integrals[i], other.integrals[i], free)
    for name, arm in ARMS.items():
        u, v = (np.degrees(portrait.stream.winding) for portrait in (this, other))
        distances[f"density_distance_{name}"] = distance(
            u, v, [portrait.stream.arm == arm for portrait in (this, other)]
        )
    return distances


def pulls(this: Portrait, other: Portrait) -> dict[str, float]:
    """Return the observables' differences from the reference, measured alike, in standard errors of the data.

    Raises ComponentError if the observable fails on the reference.
    """
    values = observables(this)
    reference = measure_stream(this.inputs.observables, other.stream)
    if not values or reference is None:
        return {}
    errors = np.concatenate([observable.data()[1] for observable in this.inputs.observables.values()])
    away = (np.array(list(values.values())) - reference.mean) / np.where(errors > 0, errors, np.nan)
    return {f"pull_{name}": value for name, value in zip(reference.names, away.tolist(), strict=True)}


def observables(this: Portrait) -> dict[str, float]:
    """Return the observables of a portrait; none where they have no value."""
    prediction = this.prediction
    if prediction is None or prediction.why_not:
        return {}
    return {f"observable_{name}": value for name, value in zip(prediction.names, prediction.mean.tolist(), strict=True)}


def match_rate(stream: Stream, reference: Stream) -> Stream:
    """Weigh the unbound particles so that as many were stripped at each time as in the reference.

    The bound ones keep their weights, and the unbound ones their sum. Times at which the stream has lost no particle
    stay without.
    """
    begin = float(min(stream.orbit.t[0], reference.orbit.t[0]))
    edges = np.linspace(begin, 0.0, max(round(-begin / BIN), 1) + 1)
    bins, counts = [], []
    for each in (stream, reference):
        free = ~each.bound
        bins.append(np.clip(np.digitize(each.t_strip[free], edges) - 1, 0, len(edges) - 2))
        counts.append(np.bincount(bins[-1], each.weight[free], len(edges) - 1))
    present, wanted = counts
    factor = np.divide(wanted, present, out=np.zeros_like(present), where=present > 0)
    if not (factor * present).sum() > 0:
        return stream
    weight = stream.weight.copy()
    weight[~stream.bound] *= factor[bins[0]] * present.sum() / (factor * present).sum()
    return replace(stream, weight=weight)
