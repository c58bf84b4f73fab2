"""The nodes of an expansion and the coordinate w between the plane and the pole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit.stream import Array

INNER, OUTER = 0.01, 2000.0  # radii in kpc of the first and the last node
POLE = 1.0 - 5e-7  # cos(theta) of the node at the pole, where the direction of increasing theta is not defined


@dataclass(frozen=True)
class Grid:
    """The nodes of an expansion; they stay the same throughout a fit."""

    radii: int  # number of nodes in ln r
    heights: int = 1  # number of nodes in w: 1 for a sphere
    angles: int = 1  # number of azimuths: 1 for an axisymmetric potential
    thickness: float = np.inf  # h of the coordinate w in kpc; with an infinite one w is mu
    mirror: bool = True  # whether the potential is the same above and below the plane z = 0
    step: int = 1  # 2 if it is the same after half a turn about the z axis, else 1
    sines: bool = False  # whether the potential differs between y and -y

    @property
    def form(self) -> str:
        """Spherical, axisymmetric or general."""
        return "spherical" if self.heights == 1 else "axisymmetric" if self.angles == 1 else "general"

    @property
    def nodes(self) -> int:
        """Number of positions at which the force is computed."""
        return self.radii * self.heights * self.angles

    @property
    def s(self) -> Array:
        """(radii,) ln r of the nodes."""
        return np.linspace(np.log(INNER), np.log(OUTER), self.radii)

    @property
    def w(self) -> Array:
        """(heights,) w of the nodes, from the plane or the lower pole to the upper one."""
        return np.linspace(0.0 if self.mirror else -1.0, 1.0, self.heights)

    @property
    def phi(self) -> Array:
        """(angles,) azimuths in radians: over a whole turn, or the part of it that the symmetries leave."""
        if not self.sines:
            return np.pi / self.step * np.arange(self.angles) / max(self.angles - 1, 1)
        return 2 * np.pi / self.step * np.arange(self.angles) / self.angles

    @property
    def orders(self) -> list[int]:
        """Orders m of the harmonics cos(m phi) and sin(m phi)."""
        most = self.angles - 2 if not self.sines else (self.angles - 1) // 2
        return [self.step * k for k in range(max(most, 0) + 1)]

    def mu(self) -> Array:
        """(radii, heights) cos(theta) at the nodes, never quite 1: the inverse of w."""
        if np.isinf(self.thickness):
            return np.broadcast_to(np.clip(self.w, -POLE, POLE), (self.radii, self.heights))
        r2, h2 = np.exp(2 * self.s)[:, None], self.thickness**2
        w4 = self.w**4
        squared = (w4 * r2 + np.sqrt(w4**2 * r2**2 + 4 * w4 * h2 * (r2 + h2))) / (2 * (r2 + h2))
        return np.asarray(np.sign(self.w) * np.minimum(np.sqrt(squared), POLE))

    def slopes(self, mu: Array) -> tuple[Array, Array]:
        """(radii, heights) dw/dmu at constant s and dw/ds at constant mu."""
        if np.isinf(self.thickness):
            return np.ones_like(mu), np.zeros_like(mu)
        r2, h2 = np.exp(2 * self.s)[:, None], self.thickness**2
        nearness = mu**2 * r2 / (mu**2 * r2 + h2)
        root = ((r2 + h2) / (mu**2 * r2 + h2)) ** 0.25
        return np.asarray(root * (1 - 0.5 * nearness)), np.asarray(0.5 * mu * root * (r2 / (r2 + h2) - nearness))

    def positions(self) -> Array:
        """(3, nodes) Positions of the nodes: s, w, phi in the order of an array (radii, heights, angles)."""
        r = np.exp(self.s)
        if self.heights == 1:
            return np.asarray(r * np.array([[0.48], [0.6], [0.64]]))
        mu = self.mu()
        across, up = r[:, None] * np.sqrt(1 - mu**2), r[:, None] * mu
        phi = self.phi if self.angles > 1 else np.array([0.7])
        shape = (*across.shape, len(phi))
        x, y = across[..., None] * np.cos(phi), across[..., None] * np.sin(phi)
        return np.stack([x, y, np.broadcast_to(up[..., None], shape)]).reshape(3, -1)
