import numpy as np
from pydantic import Field

from streamkit import Angle, LengthDatum, Observable, Prediction, hookimpl


class DistanceAt(Observable):
    """Mean Galactocentric distance of the debris near one angle along the stream."""

    kind = "distance_at"
    example = {"angle": 60.0, "distance": ("40 kpc", "2 kpc")}
    angle: Angle = Field(description="Angle from the progenitor, leading positive.")
    width: Angle = Field(default=5.0, gt=0, description="Standard deviation of the window.")
    distance: LengthDatum = Field(description="Mean distance and its error.")

    def data(self):
        """Return the distance and its error, (1,) each."""
        value, error = self.distance
        return np.array([value]), np.array([error])

    def predict(self, stream):
        """Return the weighted mean and its variance."""
        away = (np.degrees(stream.winding) - self.angle) / self.width
        weight = np.exp(-0.5 * away**2) * ~stream.bound * stream.weight
        if weight.sum() < 10:
            none = np.full(1, np.nan)
            return Prediction(("distance",), none, none, why_not="too few particles near the angle")
        weight = weight / weight.sum()
        mean = (weight * stream.r).sum()
        variance = (weight**2 * (stream.r - mean) ** 2).sum()
        return Prediction(("distance",), np.array([mean]), np.array([variance]))


@hookimpl
def streamkit_components():
    return [DistanceAt]
