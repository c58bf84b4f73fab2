"""Checks of data that are no stream: on a host known in closed form."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from streamkit import Array, G, HostData
from streamkit.testing.common import Check, require
from streamkit.testing.observables import gives_each_datum_one_quantity, has_a_covariance_of_its_data


class FlattenedHost:
    """The potential v^2 / 2 ln(R^2 + z^2 / q^2) with v = 220 km/s and q = 0.9, for tests."""

    v, q = 220.0, 0.9

    def __init__(self, numbers: Mapping[str, float] | None = None) -> None:
        self.numbers: Mapping[str, float] = numbers or {}  # see `HostView.numbers`

    def circular_velocity(self, radii: Array) -> Array:
        """(n,) The same everywhere."""
        return np.full(np.shape(radii), self.v)

    def mass_inside(self, radii: Array) -> Array:
        """(n,) That of the sphere with this velocity."""
        return np.asarray(self.v**2 * np.asarray(radii) / G)

    def flattening(self, radii: Array, z: Array) -> Array:
        """(n,) The same everywhere."""
        return np.full(np.broadcast(radii, z).shape, self.q)

    def acceleration(self, q: Array) -> Array:
        """(3, n) Minus the gradient."""
        x, y, z = q
        k = -(self.v**2) / (x * x + y * y + z * z / self.q**2)
        return np.asarray([k * x, k * y, k * z / self.q**2])

    def potential(self, q: Array) -> Array | None:
        """(n,) The potential itself."""
        x, y, z = q
        return np.asarray(0.5 * self.v**2 * np.log(x * x + y * y + z * z / self.q**2))


def has_a_value(data: HostData) -> None:
    """Check that names, mean, variance and data have one length, and that the numbers can be used."""
    prediction, (values, errors) = data.predict(FlattenedHost(data.example_host)), data.data()
    m = len(prediction.names)
    shapes = [np.shape(each) for each in (prediction.mean, prediction.variance, values, errors)]
    require(shapes == [(m,)] * 4, f"{m} names, but mean, variance and data have shapes {shapes}")
    require(not prediction.why_not, f"says {prediction.why_not!r} of a flattened isothermal sphere")
    used = np.isfinite(values)
    require(np.isfinite(prediction.mean[used]).all(), f"the mean is {prediction.mean} and why_not is empty")
    require((prediction.variance[used] >= 0).all(), f"the variance is {prediction.variance}")
    require((errors[used] > 0).all(), f"data() gives standard errors that are not positive: {errors}")


def has_a_likelihood(data: HostData) -> None:
    """Check that an ``ln_likelihood`` of its own is one finite number; None is a Gaussian."""
    prediction = data.predict(FlattenedHost(data.example_host))
    for add_noise in (False, True):
        likelihood = data.ln_likelihood(prediction, add_noise)
        require(
            likelihood is None or (np.ndim(likelihood) == 0 and np.isfinite(likelihood)),
            f"ln_likelihood gives {likelihood}",
        )


def has_an_example_of_what_it_reads(data: HostData) -> None:
    """Check that ``example_host`` has each number that ``reads`` names."""
    missing = sorted(data.reads().keys() - data.example_host.keys())
    require(not missing, f"reads {', '.join(missing)}, and example_host has no such number")


CHECKS: tuple[Check, ...] = (
    has_an_example_of_what_it_reads,
    has_a_value,
    has_a_covariance_of_its_data,
    gives_each_datum_one_quantity,
    has_a_likelihood,
)
