"""Built-in observable: the power spectrum of the density along a stream."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, model_validator

import streamkit as sk
from streamkit.builtin.observables.track.along import Arm, Longitudes, datum_panel
from streamkit.builtin.observables.track.columns import within
from streamkit.builtin.observables.track.lines import debris_of

LEAST = 0.1  # smallest smooth density, in units of its mean
FEWEST = 30  # fewest particles whose density has a power spectrum
FINE, DRAWN = 64, 181  # nodes of an integral per wavelength, and wavelengths of a drawn line


class PowerSpectrum(sk.Observable):
    """The power spectrum of the density along a stream: how strong gaps of each length are.

    The density between two longitudes is divided by a smooth one, a polynomial. With the contrast d(x) the power is
    P = 2 |integral of d exp(-2 pi i x / wavelength) dx|^2 / L, for a length L: a wave of amplitude A has A^2 L / 2. The
    shot noise of the particles is subtracted. Choose longitudes without the progenitor.
    """

    kind = "power_spectrum"
    reference = "Bovy, Erkal & Sanders 2017, MNRAS 466, 628: the power spectrum of a stream's density"
    example: ClassVar[dict[str, Any]] = {
        "frame": {"pole": [192.86, 27.13], "origin": [266.4, -28.94]},
        "table": {"wavelength": [40.0, 20.0, 10.0], "power": [0.5, 0.3, 0.3], "error": [0.5, 0.3, 0.3]},
        "low": -40.0,
        "high": 40.0,
    }

    frame: Longitudes
    table: Annotated[
        sk.Table,
        sk.Columns(wavelength="deg", power="deg", error="deg").positive("wavelength", "error"),
    ] = Field(description="Power at each wavelength along phi1, and its error; it is negative below the shot noise.")
    low: sk.Angle = Field(description="Longitude where the compared part of the stream begins.")
    high: sk.Angle = Field(description="Longitude where it ends.")
    degree: int = Field(default=3, ge=0, le=10, description="Degree of the polynomial that is the smooth density.")
    shot_noise: Annotated[sk.Number, Field(ge=0)] = Field(
        default=0.0, description="Shot noise in degrees that the data have: 2 L / (number of stars); 0 if subtracted."
    )
    arm: Arm = "both"

    @model_validator(mode="after")
    def _in_order(self) -> PowerSpectrum:
        if not 0 < self.high - self.low <= 180:
            raise ValueError(f"found low = {self.low:g} and high = {self.high:g} deg, expected 0 < high - low <= 180")
        if (self.table["wavelength"] > self.high - self.low).any():
            raise ValueError(f"found a wavelength longer than high - low = {self.high - self.low:g} deg")
        return self

    def sky_frame(self) -> sk.Frame:
        """Return the frame of phi1."""
        return self.frame

    def data(self) -> tuple[sk.Array, sk.Array]:
        """Return the powers and their errors (m,) in degrees."""
        return self.table["power"], self.table["error"]

    def predict(self, stream: sk.Stream) -> sk.Prediction:
        """Return the powers. With shot noise S of the particles the variance of a power P is S^2 + 2 max(P, 0) S.

        The details hold the smallest smooth density in units of its mean, one number.
        """
        names = tuple(f"power at {length:g} deg" for length in self.table["wavelength"].tolist())
        x, weight = self._inside(stream)
        if len(x) < FEWEST or not weight.sum() > 0:
            none = np.full(len(names), np.nan)
            return sk.Prediction(names, none, none, why_not="too few particles lie between the two longitudes")
        power, shot, least = self._power(x, weight, self.table["wavelength"])
        variance = shot**2 + 2.0 * np.maximum(power, 0.0) * shot
        return sk.Prediction(names, power + self.shot_noise, variance, details={"least": np.array([least])})

    def _inside(self, stream: sk.Stream) -> tuple[sk.Array, sk.Array]:
        """(n,) Longitudes from -1 to 1 of the debris between low and high, and its weights."""
        chosen = debris_of(stream, self.arm)
        middle = 0.5 * (self.low + self.high)
        x = (within(stream.seen(self.frame).lon[chosen], middle) - middle) / (0.5 * (self.high - self.low))
        inside = np.abs(x) <= 1
        return x[inside], stream.weight[chosen][inside]

    def _power(self, x: sk.Array, weight: sk.Array, wavelengths: sk.Array) -> tuple[sk.Array, float, float]:
        """Return the power (m,), its shot noise, and the smallest smooth density in units of its mean.

        The smooth density is the sum of Legendre polynomials that is closest to that of the particles: no bins.
        """
        legendre, mean = np.polynomial.legendre, weight.sum() / 2.0
        moments = weight @ legendre.legvander(x, self.degree)
        smooth = moments * (np.arange(self.degree + 1) + 0.5)
        half = 0.5 * (self.high - self.low)
        count = max(FINE * int(np.ceil(2 * half / wavelengths.min())), 8 * FINE)
        nodes = (np.arange(count) + 0.5) * 2 / count - 1
        share = weight / np.maximum(legendre.legval(x, smooth), LEAST * mean)
        # where the smooth density is raised to its least value, particles make up less than 1 of it
        flat = np.minimum(legendre.legval(nodes, smooth) / (LEAST * mean), 1.0) * 2 / count
        wave = 2j * np.pi * half / wavelengths[:, None]
        contrast = half * (np.exp(-wave * x) @ share - np.exp(-wave * nodes) @ flat)
        shot = 2.0 / (2 * half) * half**2 * float((share**2).sum())
        least = float(legendre.legval(nodes, smooth).min() / mean)
        return np.asarray(2.0 / (2 * half) * np.abs(contrast) ** 2 - shot), shot, least

    def mock(self, prediction: sk.Prediction, rng: np.random.Generator) -> dict[str, Any]:
        """Return a table with Gaussian numbers by the errors."""
        drawn = rng.normal(prediction.mean, self.table["error"])
        return {"table": self.table.to_dict() | {"power": drawn.tolist()}}

    def panels(self, stream: sk.Stream, prediction: sk.Prediction) -> tuple[sk.Panel, ...]:
        """Return a picture of the powers against the wavelengths and of the model, with the residuals."""
        wavelength = self.table["wavelength"]
        grid = np.unique(np.concatenate([np.geomspace(wavelength.min(), wavelength.max(), DRAWN), wavelength]))
        labels, nowhere = ("wavelength [deg]", "power [deg]"), np.full(len(stream), np.nan)

        def model(at: sk.Array) -> sk.Array:
            return self._power(*self._inside(stream), at)[0] + self.shot_noise

        return (datum_panel(labels, nowhere, (wavelength, *self.data()), prediction, model, grid),)

    def remarks(self, prediction: sk.Prediction) -> tuple[str, ...]:
        """Warn of a stream that does not fill the longitudes."""
        if prediction.why_not or prediction.details["least"][0] >= LEAST:
            return ()
        return (
            f"power_spectrum: the stream does not fill phi1 = {self.low:g} to {self.high:g} deg: its smooth density "
            f"falls below {LEAST:g} of the mean. Choose low and high inside the stream, or a lower degree.",
        )
