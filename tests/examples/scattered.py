import numpy as np
from pydantic import Field

from streamkit import PositiveNumber, Release, Speed, Stripping, hookimpl


class Scattered(Stripping):
    """Released at a range of radii about the tidal radius, with a radial dispersion only."""

    kind = "scattered"
    draws = 2
    scatter: PositiveNumber = Field(default=0.3, description="Dispersion of the release radius, in ln r_t.")
    sigma: Speed = Field(default=10.0, description="Radial velocity dispersion.")

    def release(self, orbit, tail, mass, normals):
        """Place the particles on the line to the Galactic centre."""
        outwards, _, _ = orbit.frame
        q = orbit.q + tail * orbit.r_tidal * np.exp(self.scatter * normals[0]) * outwards
        return Release(q, orbit.v + self.sigma * normals[1] * outwards)


@hookimpl
def streamkit_components():
    return [Scattered]
