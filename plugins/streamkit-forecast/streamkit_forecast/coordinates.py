"""Coordinates in which slopes are taken and priors are Gaussian: the parameters, or ln of those log-uniform."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit import Array, BoolArray, LogUniform, Normal, Spec, SpecError, TruncatedNormal

NODES = 4096  # quantiles of a prior for its standard deviation


@dataclass(frozen=True)
class Coordinates:
    """The coordinates z of d parameters.

    Attributes
    ----------
    logarithmic
        (d,) Whether z is ln of the parameter: where its prior is log-uniform.
    centre
        (d,) z where the slopes are taken.
    sd
        (d,) Standard deviations of the priors of z: that of a uniform prior is its width / sqrt(12).
    low, high
        (d,) Ends of the priors.
    """

    logarithmic: BoolArray
    centre: Array
    sd: Array
    low: Array
    high: Array

    def parameters(self, z: Array) -> Array:
        """(d,) Return the parameters at z (d,)."""
        return np.where(self.logarithmic, np.exp(np.where(self.logarithmic, z, 0.0)), z)

    @property
    def scale(self) -> Array:
        """(d,) Slopes of the parameters in z."""
        return np.where(self.logarithmic, self.parameters(self.centre), 1.0)


def coordinates_at(spec: Spec, theta: Array) -> Coordinates:
    """Return the coordinates about theta (d,); SpecError if a parameter is at an end of its prior, or beyond."""
    logarithmic = np.array([isinstance(prior, LogUniform) for prior in spec.priors])
    u = (np.arange(NODES) + 0.5) / NODES
    sd, ends = [], []
    for name, prior, log, value in zip(spec.names, spec.priors, logarithmic, theta, strict=True):
        low, high = prior.support
        if not low < value < high:
            raise SpecError(
                f"{spec.source}: {name}: found {value:g}, which is not inside its prior, {prior.text()}: slopes need "
                "room on both sides. Choose another place with --set or --run, or another prior"
            )
        x = prior.ppf(u)
        unbounded = isinstance(prior, Normal) and not isinstance(prior, TruncatedNormal)
        sd.append(prior.sd if unbounded else float(np.std(np.log(x) if log else x)))
        ends.append((np.log(low), np.log(high)) if log else (low, high))
    low_, high_ = np.array(ends).T
    centre = np.array(theta, dtype=float)
    centre[logarithmic] = np.log(centre[logarithmic])
    return Coordinates(logarithmic, centre, np.array(sd), low_, high_)
