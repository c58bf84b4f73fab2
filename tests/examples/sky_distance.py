from typing import Annotated

import numpy as np
from pydantic import Field, field_validator

from streamkit import (
    Angle,
    Columns,
    Mark,
    Number,
    Observable,
    Panel,
    PanelData,
    Prediction,
    Table,
    hookimpl,
    place_on_sky,
    sky_matrix,
)

FEWEST = 10  # particles under the kernel below which there is no mean


def ln_gauss(difference, variance):
    return -0.5 * (difference**2 / variance + np.log(2 * np.pi * variance))


class SkyDistance(Observable):
    """Mean distance of the debris from the Sun at longitudes phi1, for data of which some are no members."""

    kind = "sky_distance"
    example = {
        "frame": "galactic",
        "table": {"phi1": [-30.0, 0.0, 30.0], "distance": [25.0, 24.0, 23.0], "error": [1.0, 1.0, 1.0]},
    }
    frame: str = Field(description="Frame of phi1: a name such as GD1Koposov10.")
    table: Annotated[
        Table, Columns(phi1="deg", distance="kpc", error="kpc").increasing("phi1").positive("distance", "error")
    ] = Field(description="Longitudes, distances and their errors.")
    kernel: Angle = Field(default=5.0, gt=0, le=45, description="Standard deviation of the window in phi1.")
    outliers: Number = Field(default=0.05, gt=0, lt=1, description="Fraction of the data that are no members.")

    @field_validator("frame")
    @classmethod
    def _exists(cls, value):
        sky_matrix(value)  # a ValueError with the nearest name becomes an error of the run file
        return value

    def sky_frame(self):
        """Return the frame of phi1: tables of particles then have phi1 and phi2."""
        return self.frame

    def data(self):
        """Return the distances and their errors, (m,) each."""
        return self.table["distance"], self.table["error"]

    def means(self, stream, phi1):
        """Return mean distances, their variances and the numbers of particles under the kernel, (m,) each."""
        seen = stream.seen(self.frame)
        away = (seen.lon - phi1[:, None] + 180) % 360 - 180
        weight = stream.weight * ~stream.bound * np.exp(-0.5 * (away / self.kernel) ** 2)
        number = weight.sum(axis=1)
        share = weight / np.maximum(number, 1e-300)[:, None]
        mean = share @ seen.distance
        variance = (share**2 * (seen.distance - mean[:, None]) ** 2).sum(axis=1)
        return mean, variance, number

    def predict(self, stream):
        """Return the mean distance at each longitude of the table."""
        names = tuple(f"distance at {phi1:g}" for phi1 in self.table["phi1"])
        mean, variance, number = self.means(stream, self.table["phi1"])
        if (number < FEWEST).any():
            none = np.full(len(names), np.nan)
            return Prediction(names, none, none, why_not="too few particles at one of the longitudes")
        return Prediction(names, mean, variance)

    def ln_likelihood(self, prediction, add_noise):
        """Return ln of a mixture: members about the model, outliers as broad as the data themselves."""
        value, error = self.data()
        variance = error**2 + add_noise * prediction.variance
        member = ln_gauss(value - prediction.mean, variance)
        outlier = ln_gauss(value - value.mean(), variance + value.var())
        mixture = np.logaddexp(np.log1p(-self.outliers) + member, np.log(self.outliers) + outlier)
        return float(mixture.sum())

    def mock(self, prediction, rng):
        """Return a table that the prediction might have given; all its data are members."""
        phi1, error = self.table["phi1"], self.table["error"]
        drawn = np.abs(rng.normal(prediction.mean, error))
        return {"table": {"phi1": phi1.tolist(), "distance": drawn.tolist(), "error": error.tolist()}}

    def radii(self):
        """Return the Galactocentric radii of the nearest and the farthest datum; profiles mark them."""
        phi1, distance = self.table["phi1"], self.table["distance"]
        q = place_on_sky(phi1, np.zeros(len(phi1)), distance, sky_matrix(self.frame))
        r = np.sqrt((q**2).sum(axis=0))
        return {"innermost datum": float(r.min()), "outermost datum": float(r.max())}

    def panels(self, stream, prediction):
        """Return one picture: the particles, the model's line, the data, and below them the residuals."""
        value, error = self.data()
        phi1, seen = self.table["phi1"], stream.seen(self.frame)
        grid = np.linspace(phi1.min(), phi1.max(), 91)
        mean, _, number = self.means(stream, grid)
        line = Mark("fit", grid, np.where(number < FEWEST, np.nan, mean), "mean distance")
        compared = PanelData(np.arange(len(value)), phi1, value, error, (value - prediction.mean) / error)
        return (Panel(r"$\phi_1$ [deg]", "distance [kpc]", seen.lon, seen.distance, (line,), compared),)


@hookimpl
def streamkit_components():
    return [SkyDistance]
