"""Halos along turned axes in closed form: compared with what streamkit computes."""

from typing import Any, ClassVar

import numpy as np
from pydantic import Field

import streamkit as sk


def axes(alpha: Any, beta: Any, gamma: Any) -> Any:
    """(..., 3, 3) The axes of a potential as rows, for Euler angles (...) in degrees: AGAMA's reference, appendix."""
    ca, cb, cg = np.cos(np.radians([alpha, beta, gamma]))
    sa, sb, sg = np.sin(np.radians([alpha, beta, gamma]))
    rows = np.array([
        [ca * cg - sa * cb * sg, sa * cg + ca * cb * sg, sb * sg],
        [-ca * sg - sa * cb * cg, -sa * sg + ca * cb * cg, sb * cg],
        [sa * sb, -ca * sb, cb],
    ])  # fmt: skip
    return np.moveaxis(rows, (0, 1), (-2, -1))


def logarithmic(q: Any, v0: float = 220.0, p: float = 0.85, f: float = 0.75) -> Any:
    """Acceleration (3, n) of a logarithmic halo in its own axes: Binney & Tremaine 2008, eq. 2.71a."""
    shape = np.array([1.0, p, f])[:, None]
    return -(v0**2) * q / shape**2 / ((q / shape) ** 2).sum(axis=0)


class Foreign(sk.Potential):
    """The same halo as code that numba does not see."""

    kind = "test_foreign_halo"
    compiled = False
    evaluation = "expansion"
    example: ClassVar[dict[str, Any]] = {"v0": 220.0}
    v0: sk.Speed = Field(description="Speed.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, v0: Any) -> Any:
        return tuple(logarithmic(np.stack([x, y, z]).reshape(3, -1), v0).reshape(3, *np.shape(x)))
