"""Warnings about numbers of the integrator and the stripping scheme that are too large for the progenitor's orbit."""

from __future__ import annotations

import numpy as np

from streamkit.runfile import StreamInputs
from streamkit.study.preflight.orbit import OrbitSummary

LONGEST = 1.0  # radians that the progenitor turns in a step; the leapfrog is unstable on a circular orbit beyond 2


def size_warnings(inputs: StreamInputs, orbit: OrbitSummary) -> list[str]:
    """Return a warning about a step in which the progenitor turns too far, and about a dispersion above its speed."""
    warnings = []
    step = getattr(inputs.integrator, "step", None)
    if isinstance(step, float) and min(step, inputs.integrator.longest_block) * orbit.fastest > LONGEST:
        warnings.append(
            f"integrator.step = {step:g} Gyr is too long for this orbit: at its pericentre the progenitor turns by 1 "
            f"radian in {1 / orbit.fastest:.2g} Gyr. Take a tenth of that or less, or integrator.kind = 'adaptive'."
        )
    sigma, speed = getattr(inputs.stripping, "sigma", None), float(np.sqrt(inputs.v @ inputs.v))
    if isinstance(sigma, float) and sigma > speed:
        warnings.append(
            f"stripping.sigma = {sigma:g} km/s is above the progenitor's own speed, {speed:.3g} km/s: the debris flies "
            "off in all directions. Is it in m/s? Speeds are in km/s unless they have a unit."
        )
    return warnings
