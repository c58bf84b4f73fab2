"""A built-in uniform acceleration: that of a frame whose origin is not at rest."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from streamkit import Potential, Symbol, Unit

_ACCELERATION = Unit("km2 / (kpc s2)")


class UniformAcceleration(Potential):
    """The same acceleration everywhere, as felt in a frame whose origin accelerates, such as a simulated halo's centre.

    It is minus the acceleration of the origin. Each component may change in time: ``ax = { times = [...], values =
    [...] }``. It stands beside the potentials of the host, and has no potential energy: energies, escape speeds and
    whether an orbit is bound are then not told.
    """

    kind = "uniform_acceleration"
    example = {"ax": 100.0, "ay": -40.0, "az": 60.0}
    reference = "Vasiliev 2019, MNRAS 482, 1525"

    ax: Annotated[float, _ACCELERATION, Symbol("$a_x$")] = Field(default=0.0, description="Along x.")
    ay: Annotated[float, _ACCELERATION, Symbol("$a_y$")] = Field(default=0.0, description="Along y.")
    az: Annotated[float, _ACCELERATION, Symbol("$a_z$")] = Field(default=0.0, description="Along z.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, ax: Any, ay: Any, az: Any) -> Any:
        """Return it at every place."""
        return ax + 0.0 * x, ay + 0.0 * y, az + 0.0 * z
