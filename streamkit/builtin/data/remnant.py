"""The remnant of the progenitor today as data: its mass and its velocity dispersion."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from streamkit import Array, MassDatum, Observable, Prediction, Stream, VelocityDatum

NAMES = "mass", "dispersion"
FEWEST = 10  # fewest bound particles for a measurement


class RemnantData(Observable):
    """Mass and line-of-sight velocity dispersion of the remnant of the progenitor, beside the stream's data.

    With a live progenitor (`restricted_nbody`), whose mass and radius are those at the look-back time, these data
    constrain the remnant today. A scheme that releases particles has no remnant: then the dispersion is that of the
    debris inside the tidal radius, and the mass follows from `mass_loss`.
    """

    kind = "remnant"
    example: ClassVar[dict[str, Any]] = {"dispersion": ("11 km/s", "2 km/s")}

    mass: MassDatum | None = Field(default=None, description="Bound mass today and its error.")
    dispersion: VelocityDatum | None = Field(
        default=None,
        description="Velocity dispersion of the bound particles along the line of sight, and its error; each particle "
        "counts with its weight.",
    )

    def data(self) -> tuple[Array, Array]:
        """Return the mass in Msun and the dispersion in km/s and their errors, NaN where left out."""
        pairs = [getattr(self, name) or (np.nan, np.nan) for name in NAMES]
        values, errors = np.array(pairs).T
        return values, errors

    def mock(self, prediction: Prediction, rng: np.random.Generator) -> dict[str, Any]:
        """Return the numbers in use with Gaussian noise of their errors."""
        drawn = {}
        for name, mean in zip(NAMES, prediction.mean, strict=True):
            if (datum := getattr(self, name)) is not None:
                drawn[name] = [float(rng.normal(mean, datum[1])), float(datum[1])]
        return drawn

    def predict(self, stream: Stream) -> Prediction:
        """Measure the bound particles; a prediction without a value where fewer than ten are bound."""
        bound = stream.bound
        reason = "too few particles of the progenitor are still bound" if bound.sum() < FEWEST else ""
        if bound.all():
            reason = "no particle has left the progenitor"
        if reason:
            nothing = np.full(2, np.nan)
            return Prediction(NAMES, nothing, nothing, why_not=reason)
        left = float(stream.orbit.mass_left[-1])
        mass = stream.mass * left
        weight = stream.weight[bound]
        away = stream.orbit.q[:, -1] - stream.sun.q
        speed = (away / np.sqrt(away @ away)) @ stream.v[:, bound]
        mean = np.average(speed, weights=weight)
        dispersion = np.sqrt(np.average((speed - mean) ** 2, weights=weight))
        effective = weight.sum() ** 2 / (weight**2).sum()
        variance = [stream.mass**2 * left * max(1 - left, 0.0) / len(stream), dispersion**2 / (2 * effective)]
        return Prediction(NAMES, np.array([mass, dispersion]), np.array(variance))

    def remarks(self, prediction: Prediction) -> tuple[str, ...]:
        """Warn that nothing is compared where no datum is given."""
        given = self.mass is not None or self.dispersion is not None
        return () if given else ("The observable remnant has neither a mass nor a dispersion: nothing is compared.",)
