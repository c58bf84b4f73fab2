import numpy as np
from pydantic import Field

from streamkit import GYR, Duration, G, LiveStripping, Remnant, hookimpl
from streamkit.builtin.potentials.closed_forms import Plummer


class Evaporation(LiveStripping):
    """A star cluster that loses mass at a constant rate, at a constant radius."""

    kind = "evaporation"
    lifetime: Duration = Field(default=6.0, description="Time in which all mass is lost.")

    def update_remnant(self, edge, satellite, previous):
        """Return a Plummer sphere of the remaining mass."""
        left = satellite.mass * max(1 - (edge.t - edge.start) / (self.lifetime * GYR), 1e-3)
        d2 = ((edge.q - edge.core[:3, None]) ** 2).sum(axis=0)
        v2 = ((edge.v - edge.core[3:6, None]) ** 2).sum(axis=0)
        bound = 0.5 * v2 < G * left / np.sqrt(d2 + satellite.scale**2)
        return Remnant(Plummer(mass=left, radius=satellite.scale), left, bound)


@hookimpl
def streamkit_components():
    return [Evaporation]
