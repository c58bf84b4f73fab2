from pydantic import Field

from streamkit import G, Length, Mass, Potential, hookimpl, sqrt


class Jaffe(Potential):
    """Jaffe (1983) sphere: the density falls from r^-2 to r^-4 at the radius a."""

    kind = "jaffe"
    example = {"mass": 1e12, "a": 80.0}
    mass: Mass = Field(description="Total mass.")
    a: Length = Field(description="Scale radius.")

    @staticmethod
    def acceleration(x, y, z, t, mass, a):
        r2 = x * x + y * y + z * z
        k = -G * mass / (r2 * (sqrt(r2) + a))
        return k * x, k * y, k * z


@hookimpl
def streamkit_components():
    return [Jaffe]
