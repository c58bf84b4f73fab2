"""Particle-spray stripping schemes for streamkit.

Frame at the progenitor: e_r outwards, e_phi along the motion, e_z along the angular momentum. Offsets are in
units of the tidal radius r_t, kicks in units of V = Omega r_t, with Omega the instantaneous angular speed.
The trailing tail (+1) is drawn as written, the leading tail (-1) mirrored through the progenitor.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from streamkit import (
    Angle,
    Array,
    Component,
    G,
    IntArray,
    Number,
    Orbit,
    PositiveNumber,
    Release,
    Stripping,
    hookimpl,
)

STREAMKIT_CONTRACT = 1  # the contract with streamkit that this module was written for

# Chen+ 2025 draw the distance from a Gaussian. A fraction of 9e-6 of the draws is below this many r_t and is moved to
# it, since the escape speed of a point mass diverges at the point.
NEAREST = 0.1


def _around(orbit: Orbit, tail: IntArray, offset: Array, kick: Array) -> Release:
    """Add offsets and kicks, (3, n) along e_r, e_phi, e_z, to the progenitor; mirror the leading tail."""
    axes = np.stack(orbit.frame)
    q = orbit.q + tail * np.einsum("cn,ckn->kn", offset, axes)
    v = orbit.v + tail * np.einsum("cn,ckn->kn", kick, axes)
    return Release(q, v)


class _Fardal(Stripping):
    """The fields and the release that both variants share."""

    draws = 4
    scales_with_k_r: ClassVar[bool]  # whether the tangential kick is in units of k_r V, else in units of V

    k_r: Number = Field(default=2.0, description="Mean radial offset in units of r_t.")
    k_vphi: Number = Field(default=0.3, description="Mean tangential kick in units of V = Omega r_t.")
    sigma_kr: Number = Field(default=0.4, ge=0, description="Dispersion of the radial offset, in r_t.")
    sigma_kvphi: Number = Field(default=0.4, ge=0, description="Dispersion of the tangential kick, in V.")
    sigma_kz: Number = Field(default=0.5, ge=0, description="Dispersion of the vertical offset, in r_t.")
    sigma_kvz: Number = Field(default=0.5, ge=0, description="Dispersion of the vertical kick, in V.")

    def release(self, orbit: Orbit, tail: IntArray, mass: float | Array, normals: Array) -> Release:
        """Draw k_r, k_vphi, k_z and k_vz independently, one row of normals each."""
        k_r = self.k_r + self.sigma_kr * normals[0]
        k_vphi = self.k_vphi + self.sigma_kvphi * normals[1]
        if self.scales_with_k_r:
            k_vphi = k_r * k_vphi
        zero = np.zeros_like(k_r)
        offset = orbit.r_tidal * np.stack([k_r, zero, self.sigma_kz * normals[2]])
        kick = orbit.omega * orbit.r_tidal * np.stack([zero, k_vphi, self.sigma_kvz * normals[3]])
        return _around(orbit, tail, offset, kick)


class Fardal15(_Fardal):
    """Particle spray of Fardal, Huang & Weinberg 2015, with the constants of the paper.

    Offsets: k_r r_t outwards, k_z r_t upwards. Kicks: k_vphi V along the motion, k_vz V upwards.
    """

    kind = "fardal15"
    reference = "Fardal, Huang & Weinberg 2015, MNRAS 452, 301"
    scales_with_k_r = False


class Fardal15Gala(_Fardal):
    """gala's variant (``gala_modified``): wider, and the tangential kick scales with the drawn k_r.

    Offsets: k_r r_t outwards, k_z r_t upwards. Kicks: k_r k_vphi V along the motion, k_vz V upwards.
    """

    kind = "fardal15_gala"
    reference = "gala (Price-Whelan 2017, JOSS 2, 388), after Fardal, Huang & Weinberg 2015, MNRAS 452, 301"
    scales_with_k_r = True

    k_vphi: Number = Field(default=0.3, description="Mean tangential kick in units of k_r V, V = Omega r_t.")
    sigma_kr: Number = Field(default=0.5, ge=0, description="Dispersion of the radial offset, in r_t.")
    sigma_kvphi: Number = Field(default=0.5, ge=0, description="Dispersion of the tangential kick, in k_r V.")


class Chen25(Stripping):
    """Particle spray of Chen, Valluri, Gnedin & Ash 2025, calibrated on globular clusters.

    Released at distance D in the direction (phi, theta) from the progenitor, at the escape speed
    sqrt(2 G M / D) in the direction (alpha, beta): azimuths from e_r towards e_phi, latitudes towards e_z.
    All are Gaussian; D and alpha are correlated.
    """

    kind = "chen25"
    reference = "Chen, Valluri, Gnedin & Ash 2025, ApJS 276, 32"
    draws = 5

    distance: PositiveNumber = Field(default=1.6, description="Mean distance D in units of r_t.")
    phi: Angle = Field(default=-30.0, description="Mean azimuth of the position.")
    theta: Angle = Field(default=0.0, description="Mean latitude of the position.")
    speed: PositiveNumber = Field(default=1.0, description="Speed in units of the escape speed at D.")
    alpha: Angle = Field(default=20.0, description="Mean azimuth of the velocity.")
    beta: Angle = Field(default=0.0, description="Mean latitude of the velocity.")
    sigma_distance: Number = Field(default=0.35, ge=0, description="Dispersion of D, in r_t.")
    sigma_phi: Angle = Field(default=23.0, ge=0, description="Dispersion of phi.")
    sigma_theta: Angle = Field(default=12.0, ge=0, description="Dispersion of theta.")
    sigma_alpha: Angle = Field(default=20.0, ge=0, description="Dispersion of alpha.")
    sigma_beta: Angle = Field(default=22.0, ge=0, description="Dispersion of beta.")
    correlation: Number = Field(default=-0.7, ge=-1, le=1, description="Correlation of D and alpha.")

    def release(self, orbit: Orbit, tail: IntArray, mass: float | Array, normals: Array) -> Release:
        """Draw D, phi, theta, alpha and beta, one row of normals each."""
        n_distance, n_phi, n_theta, n_alpha, n_beta = normals
        n_alpha = self.correlation * n_distance + np.sqrt(1.0 - self.correlation**2) * n_alpha
        d = np.maximum(self.distance + self.sigma_distance * n_distance, NEAREST) * orbit.r_tidal
        v = self.speed * np.sqrt(2.0 * G * mass / d)
        where = _direction(self.phi + self.sigma_phi * n_phi, self.theta + self.sigma_theta * n_theta)
        whither = _direction(self.alpha + self.sigma_alpha * n_alpha, self.beta + self.sigma_beta * n_beta)
        return _around(orbit, tail, d * where, v * whither)


def _direction(azimuth: Array, latitude: Array) -> Array:
    """(3, n) unit vectors from angles (n,) in degrees."""
    a, b = np.radians(azimuth), np.radians(latitude)
    return np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)])


@hookimpl
def streamkit_components() -> list[type[Component]]:
    """List the schemes."""
    return [Fardal15, Fardal15Gala, Chen25]
