import numpy as np
from pydantic import Field

from streamkit import G, HostData, Length, NumberDatum, Prediction, hookimpl


class VerticalForce(HostData):
    """The vertical force of the host at one place, as a surface density |a_z| / (2 pi G)."""

    kind = "vertical_force"
    reference = "Kuijken & Gilmore 1991, ApJ 367, L9: 71 +- 6 Msun/pc2 at 1.1 kpc"
    example = {"surface_density": (71.0, 6.0)}
    radius: Length = Field(default=8.0, description="Cylindrical radius.")
    z: Length = Field(default=1.1, description="Height above the plane.")
    surface_density: NumberDatum = Field(description="|a_z| / (2 pi G) and its error, in Msun/pc2.")

    def data(self):
        """Return the surface density and its error, (1,) each."""
        value, error = self.surface_density
        return np.array([value]), np.array([error])

    def predict(self, host):
        """Return the host's own surface density; it is exact, so its variance is zero."""
        _, _, a_z = host.acceleration(np.array([[self.radius], [0.0], [self.z]]))
        return Prediction(("surface_density",), np.abs(a_z) / (2 * np.pi * G) * 1e-6, np.zeros(1))


@hookimpl
def streamkit_components():
    return [VerticalForce]
