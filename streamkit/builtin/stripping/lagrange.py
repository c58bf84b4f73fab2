"""Built-in stripping schemes: release at the Lagrange points."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from streamkit import Array, IntArray, Orbit, PositiveNumber, Release, Speed, Stripping, Symbol


class LagrangeCloud(Stripping):
    """Modified Lagrange cloud stripping (mLCS): released at r_t on the line to the Galactic centre.

    The mean velocity is the progenitor's, with a Gaussian of dispersion sigma on each axis and no tangential
    tweak. With progenitor gravity on this is the method of the paper; off is its ablation.
    """

    kind = "mlcs"
    reference = "Gibbons, Belokurov & Evans 2014, MNRAS 445, 3788, section 3.2"
    draws = 3

    release_radius: Annotated[PositiveNumber, Symbol(r"$r_{\rm rel} / r_{\rm t}$")] = Field(
        default=1.0, description="Release radius in units of r_t."
    )
    sigma: Annotated[Speed, Symbol(r"$\sigma$")] = Field(default=10.0, description="Velocity dispersion per axis.")

    def release(self, orbit: Orbit, tail: IntArray, mass: float | Array, normals: Array) -> Release:
        """Place the particles at x_p (1 -+ r_t / |x_p|), with v_p + N(0, sigma) on each axis."""
        e_r = orbit.q / orbit.r
        q = orbit.q + tail * self.release_radius * orbit.r_tidal * e_r
        return Release(q, orbit.v + self.sigma * normals)


class Streakline(Stripping):
    """Kuepper-style streakline: released at r_t with the progenitor's angular velocity.

    Kuepper, Lane & Heggie 2012 have no dispersion (the default here); Gibbons+ 2014 compare with a Gaussian.
    """

    kind = "streakline"
    reference = "Kuepper, Lane & Heggie 2012, MNRAS 420, 2700"
    draws = 3

    release_radius: Annotated[PositiveNumber, Symbol(r"$r_{\rm rel} / r_{\rm t}$")] = Field(
        default=1.0, description="Release radius in units of r_t."
    )
    sigma: Annotated[Speed, Symbol(r"$\sigma$")] = Field(default=0.0, description="Velocity dispersion per axis.")

    def release(self, orbit: Orbit, tail: IntArray, mass: float | Array, normals: Array) -> Release:
        """Place the particles as mLCS does, with the tangential offset -+ Omega r_t."""
        e_r, e_phi, _ = orbit.frame
        offset = tail * self.release_radius * orbit.r_tidal
        v = orbit.v + offset * orbit.omega * e_phi + self.sigma * normals
        return Release(orbit.q + offset * e_r, v)
