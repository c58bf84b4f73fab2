import numpy as np
from pydantic import Field
from scipy.interpolate import CubicSpline

from streamkit import LengthArray, Potential, SpeedArray, cubic, cubic_pieces, hookimpl, log


class Tabulated(Potential):
    """A spherical host from a table of circular velocities; flat inside the first radius and beyond the last."""

    kind = "tabulated"
    r: LengthArray = Field(default=[8.0, 50.0, 100.0, 150.0, 200.0], description="Radii.")
    v_c: SpeedArray = Field(default=[237.0, 158.0, 133.0, 119.0, 110.0], description="Circular velocities there.")

    @staticmethod
    def prepare(r, v_c):
        """Return the spline of v_c on an even grid of ln r."""
        spline = CubicSpline(np.log(r), v_c, bc_type="clamped")
        nodes = np.linspace(np.log(r[0]), np.log(r[-1]), 257)
        pieces = cubic_pieces(spline(nodes), spline(nodes, 1) * (nodes[1] - nodes[0]))
        return {"first": nodes[0], "last": nodes[-1], "pieces": pieces}

    @staticmethod
    def acceleration(x, y, z, t, first, last, pieces):
        """Return -v_c^2 / r along the radius."""
        r2 = x * x + y * y + z * z
        v = cubic(0.5 * log(r2), (first, last), pieces)
        k = -v * v / r2
        return k * x, k * y, k * z


@hookimpl
def streamkit_components():
    return [Tabulated]
