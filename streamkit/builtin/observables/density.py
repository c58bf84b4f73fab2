"""Built-in observable: the density along a stream, against counts of stars."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, field_validator
from scipy.special import betainc, betaincc, gammainc, gammaincc, gammaln, ndtri, xlogy

import streamkit as sk
from streamkit.builtin.observables.track.along import Arm, Longitudes, datum_panel, gaps_along
from streamkit.builtin.observables.track.lines import ENOUGH, debris_of, is_enough, kernels, too_few
from streamkit.builtin.observables.track.panels import longitude_label

STIFFEST = 1e9  # shape of a gamma distribution beyond which it is treated as a constant
LEAST = 1e-150  # smallest number with a logarithm, or in a denominator


class Density(sk.Observable):
    """The density along a stream: counts of stars at longitudes phi1, in bins of equal width.

    The expected count is ``efficiency * (amplitude * shape + background)``. The shape is the density of the debris in
    phi1 under a kernel, divided by its mean at the data; the amplitude is then the mean count of the stream's stars.
    Counts without errors are Poisson numbers, and negative binomial numbers with the noise of the particles. Counts
    with errors are Gaussian. Bound particles are left out: leave out the bins of the progenitor too. Only a live
    progenitor (`restricted_nbody`) gives the rate at which debris leaves: the densities of schemes that release
    particles at a given rate differ from those of live satellites by factors of 2 to 7.
    """

    kind = "density"
    reference = "Erkal, Koposov & Belokurov 2017, MNRAS 470, 60: counts along a stream"
    wants_live = True
    likelihood_details = ()
    example: ClassVar[dict[str, Any]] = {
        "frame": {"pole": [192.86, 27.13], "origin": [266.4, -28.94]},
        "counts": {"phi1": [-30.0, -10.0, 10.0, 30.0], "count": [20.0, 31.0, 25.0, 14.0]},
        "kernel": 5.0,
        "amplitude": 20.0,
    }

    frame: Longitudes
    counts: Annotated[
        sk.Table,
        sk.Columns(phi1="deg", count="")
        .optional(error="", efficiency="")
        .between("count", 0, np.inf)
        .positive("error", "efficiency"),
    ] = Field(
        description="Middle of each bin, and the stars in it; with errors if the counts are Gaussian, and with the "
        "fraction of all stars in the bin that the survey detects."
    )
    amplitude: sk.PositiveNumber = Field(description="Mean count of the stream's stars over the bins.")
    background: Annotated[sk.Number, Field(ge=0)] = Field(default=0.0, description="Other stars in each bin.")
    kernel: sk.Angle = Field(
        default=1.0,
        gt=0,
        le=45,
        description="Standard deviation of the kernel in phi1. Half a bin or less blurs the model no more than the "
        "bins blur the data; a wider kernel is smoother.",
    )
    arm: Arm = "both"

    @field_validator("counts")
    @classmethod
    def _each_once(cls, counts: sk.Table) -> sk.Table:
        places, times = np.unique(counts["phi1"], return_counts=True)
        if (times > 1).any():
            raise ValueError(
                f"found {times.max()} bins at phi1 = {places[times.argmax()]:g} deg; expected each bin once: its stars "
                "would count twice"
            )
        return counts

    def sky_frame(self) -> sk.Frame:
        """Return the frame of phi1."""
        return self.frame

    @property
    def gaussian(self) -> bool:
        """Whether the counts have Gaussian errors."""
        return "error" in self.counts

    @property
    def efficiency(self) -> sk.Array:
        """(m,) Fraction of the stars in each bin that are detected."""
        return self.counts["efficiency"] if "efficiency" in self.counts else np.ones(len(self.counts))

    def data(self) -> tuple[sk.Array, sk.Array]:
        """Return the counts and their errors (m,); the error of a Poisson number is at least 1."""
        count = self.counts["count"]
        return count, self.counts["error"] if self.gaussian else np.sqrt(np.maximum(count, 1.0))

    def predict(self, stream: sk.Stream) -> sk.Prediction:
        """Return the expected counts.

        The details hold the number of particles (m,) under the kernel at each bin.
        """
        phi1 = self.counts["phi1"]
        names = tuple(f"count at {angle:g}" for angle in phi1.tolist())
        if not is_enough(stream, debris_of(stream, self.arm)):
            return too_few(names)
        particles = self._under(stream, phi1)
        number = particles.sum(axis=1)
        norm = len(phi1) / (number.sum() + ENOUGH)
        shape = norm * number
        # Each particle changes the shape at its position and, by the normalisation, everywhere else.
        share = norm * (particles - np.multiply.outer(shape / len(phi1), particles.sum(axis=0)))
        scale = self.efficiency * self.amplitude
        mean = scale * shape + self.efficiency * self.background
        return sk.Prediction(names, mean, scale**2 * (share**2).sum(axis=1), details={"particles": number})

    def _under(self, stream: sk.Stream, at: sk.Array) -> sk.Array:
        """(m, n) The kernels about longitudes (m,) at the debris, times its weights: 1 at the middle.

        The kernel is a Gaussian with faint exponential wings: away from the debris the model falls with the distance.
        """
        chosen = debris_of(stream, self.arm)
        away = np.subtract.outer(at, stream.seen(self.frame).lon[chosen])
        return kernels(((away + 180) % 360 - 180) / self.kernel) * stream.weight[chosen]

    def ln_likelihood(self, prediction: sk.Prediction, add_noise: bool) -> float | sk.Array:
        """Return the sum of ln of Gaussian, Poisson or, with noise, negative binomial probabilities."""
        total = self.ln_likelihoods(prediction, add_noise).sum(axis=-1)
        return float(total) if total.ndim == 0 else total

    def ln_likelihoods(self, prediction: sk.Prediction, add_noise: bool) -> sk.Array:
        """Return the terms (..., m) of `ln_likelihood`."""
        count, variance = self.counts["count"], self._variance(prediction, add_noise)
        if self.gaussian:
            return -0.5 * ((count - prediction.mean) ** 2 / variance + np.log(2 * np.pi * variance))
        return ln_counts(count, prediction.mean, variance)

    def residuals(self, prediction: sk.Prediction, add_noise: bool) -> sk.Array:
        """Return the normal scores of the counts in their distributions."""
        count, variance = self.counts["count"], self._variance(prediction, add_noise)
        if self.gaussian:
            return np.asarray((count - prediction.mean) / np.sqrt(variance))
        return scores(count, prediction.mean, variance)

    def _variance(self, prediction: sk.Prediction, add_noise: bool) -> sk.Array:
        """(..., m) Variances of Gaussian counts, or of the expectations of Poisson numbers."""
        errors2 = self.counts["error"] ** 2 if self.gaussian else 0.0
        return errors2 + (prediction.variance if add_noise else np.zeros_like(prediction.mean))

    def mock(self, prediction: sk.Prediction, rng: np.random.Generator) -> dict[str, Any]:
        """Return a table with Poisson numbers, or with Gaussian numbers by the errors."""
        if self.gaussian:
            drawn = np.maximum(rng.normal(prediction.mean, self.counts["error"]), 0.0)
        else:
            drawn = rng.poisson(prediction.mean).astype(float)
        return {"counts": self.counts.to_dict() | {"count": drawn.tolist()}}

    def panels(self, stream: sk.Stream, prediction: sk.Prediction) -> tuple[sk.Panel, ...]:
        """Return a picture of the counts and of the model, with the residuals."""
        phi1 = self.counts["phi1"]
        data, order = (phi1, *self.data()), np.argsort(phi1)
        scatter = data[2] if self.gaussian else np.sqrt(np.maximum(prediction.mean, LEAST))

        def model(at: sk.Array) -> sk.Array:
            norm = len(phi1) / (self._under(stream, phi1).sum() + ENOUGH)
            efficiency = np.interp(at, phi1[order], self.efficiency[order])
            shape = norm * self._under(stream, at).sum(axis=1)
            return np.asarray(efficiency * (self.amplitude * shape + self.background))

        labels, places = (longitude_label(self.frame, False), "stars in a bin"), stream.seen(self.frame).lon
        return (datum_panel(labels, places, data, prediction, model, scatter=scatter),)

    def remarks(self, prediction: sk.Prediction) -> tuple[str, ...]:
        """Warn of bins where the stream has no debris."""
        return gaps_along("density: {} of {} bins", self.counts["phi1"], prediction, self.kernel)


def ln_counts(count: sk.Array, mean: sk.Array, noise: sk.Array) -> sk.Array:
    """(..., m) ln of the probability of counts, given the mean and the variance ``noise`` of their expectation.

    The expectation has a gamma distribution, so the counts are negative binomial; without noise they are Poisson
    numbers. An emulator may give a mean of zero or less: then counts above zero have practically no probability.
    """
    mean, shape, is_stiff = _gamma(mean, noise)
    poisson = xlogy(count, mean) - mean - gammaln(count + 1)
    mixed = gammaln(count + shape) - gammaln(shape) - gammaln(count + 1)
    mixed = mixed - shape * np.log1p(mean / shape) + xlogy(count, mean / (shape + mean))
    return np.asarray(np.where(is_stiff, poisson, mixed))


def scores(count: sk.Array, mean: sk.Array, noise: sk.Array) -> sk.Array:
    """(..., m) Normal scores of counts in the distributions of `ln_counts`, at the middle of each count's probability.

    Dunn & Smyth 1996 draw a random position within this probability; the middle is the same at every call. Counts may
    be fractions, as smoothed counts are: the distributions are continued between the integers.
    """
    own = 0.5 * np.exp(ln_counts(count, mean, noise))
    mean, shape, is_stiff = _gamma(mean, noise)
    p = shape / (shape + mean)
    below = np.where(is_stiff, gammaincc(count + 1, mean), betainc(shape, count + 1, p)) - own
    above = np.where(is_stiff, gammainc(count + 1, mean), betaincc(shape, count + 1, p)) + own
    return np.asarray(np.where(below < above, ndtri(np.maximum(below, LEAST)), -ndtri(np.maximum(above, LEAST))))


def _gamma(mean: sk.Array, noise: sk.Array) -> tuple[sk.Array, sk.Array, sk.BoolArray]:
    """Return mean and shape of the gamma distribution, above zero, and where it is treated as a constant."""
    mean = np.maximum(mean, LEAST)
    shape = mean * (mean / np.maximum(noise, LEAST))
    return mean, np.clip(shape, LEAST, STIFFEST), np.asarray(shape >= STIFFEST, dtype=bool)
