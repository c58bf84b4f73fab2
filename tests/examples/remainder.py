import numpy as np
from pydantic import Field
from scipy.interpolate import CubicSpline

from streamkit import G, LengthArray, OutOfDomain, Potential, SpeedArray, cubic, cubic_pieces, hookimpl, log


class Remainder(Potential):
    """The spherical halo that a rotation curve leaves for it beside the other parts of the host."""

    kind = "remainder"
    r: LengthArray = Field(default=[1.0, 8.0, 50.0, 100.0, 200.0], description="Radii.")
    v_c: SpeedArray = Field(default=[200.0, 237.0, 158.0, 133.0, 110.0], description="Root of G M(<r) / r of them all.")

    @staticmethod
    def prepare(r, v_c, host):
        """Return the spline of the halo's G M(<r) / r on an even grid of ln r."""
        nodes = np.linspace(np.log(r[0]), np.log(r[-1]), 65)
        radii = np.exp(nodes)
        whole = CubicSpline(np.log(r), v_c, bc_type="clamped")(nodes) ** 2
        halo = whole - G * host.mass_inside(radii) / radii
        if (halo < 0).any():
            raise OutOfDomain("the other parts of the host have more mass than its rotation curve allows")
        slopes = CubicSpline(nodes, halo, bc_type="clamped")(nodes, 1) * (nodes[1] - nodes[0])
        return {"first": nodes[0], "last": nodes[-1], "pieces": cubic_pieces(halo, slopes)}

    @staticmethod
    def acceleration(x, y, z, t, first, last, pieces):
        """Return -G M(<r) / r^2 along the radius; M grows as r beyond either end of the curve."""
        r2 = x * x + y * y + z * z
        k = -cubic(0.5 * log(r2), (first, last), pieces) / r2
        return k * x, k * y, k * z


@hookimpl
def streamkit_components():
    return [Remainder]
