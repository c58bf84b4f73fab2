"""What is forecast: the parameters of the host, and masses and flattenings that follow from them, with their slopes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from streamkit import Array, Host, Spec
from streamkit_forecast.coordinates import Coordinates

STEP = 1e-3  # of the standard deviations of the priors: the host has no noise
SAME = 1e-6  # relative difference of one quantity from another below which they are the same
NONE = 1e-9  # slopes below this, relative to the value, are none


@dataclass(frozen=True)
class Quantity:
    """One number: its value at the place of the forecast, and its slopes (d,) in the coordinates."""

    name: str
    unit: str
    value: float
    slopes: Array

    def sd(self, covariance: Array) -> float:
        """Return the standard deviation that follows from a covariance (d, d) of the coordinates."""
        return float(np.sqrt(self.slopes @ covariance @ self.slopes))


def quantities_at(spec: Spec, at: Coordinates, shared: Array, radii: Sequence[float]) -> list[Quantity]:
    """Return the ``shared`` parameters, then M(<r) and the potential's axis ratio q(r) at radii in kpc that may vary.

    q is that 45 deg above the plane, as `streamkit host` shows it.
    """
    found = []
    unit_vectors = np.diag(at.scale)
    values = at.parameters(at.centre)
    for i in shared:
        found.append(Quantity(spec.names[i], spec.units[i], float(values[i]), unit_vectors[i]))
    here = _profile(spec, at, at.centre, radii)
    slopes = np.zeros((len(here), len(at.centre)))
    for i in shared:
        step = np.zeros(len(at.centre))
        step[i] = min(STEP * at.sd[i], 0.5 * (at.centre - at.low)[i], 0.5 * (at.high - at.centre)[i])
        high, low = (_profile(spec, at, at.centre + sign * step, radii) for sign in (1, -1))
        slopes[:, i] = (high - low) / (2 * step[i])
    names = [(f"M(<{r:g} kpc)", "Msun") for r in radii] + [(f"q({r:g} kpc)", "") for r in radii]
    for (name, unit), value, slope in zip(names, here.tolist(), slopes, strict=True):
        varies = np.isfinite(slope).all() and (np.abs(slope) * at.sd > NONE * abs(value)).any()
        if varies and not any(_same(each, value, slope) for each in found):  # an axis ratio may be one at all radii
            found.append(Quantity(name, unit, value, slope))
    return found


def _same(quantity: Quantity, value: float, slopes: Array) -> bool:
    return bool(np.isclose(quantity.value, value, rtol=SAME) and np.allclose(quantity.slopes, slopes, rtol=SAME))


def _profile(spec: Spec, at: Coordinates, z: Array, radii: Sequence[float]) -> Array:
    host, r = Host(spec.host(at.parameters(z))), np.asarray(radii, dtype=float)
    slant = r / np.sqrt(2.0)
    return np.concatenate([host.mass_inside(r), host.flattening(slant, slant)])
