"""The base of spherical potentials: the author writes the force as a function of the distance alone."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

from streamkit.components.potential import Potential
from streamkit.errors import StreamkitError
from streamkit.units import CENTRE


class Spherical(Potential):
    """A spherical potential, centred on the origin: `pull` takes the place of `acceleration`, `well` of `potential`.

    Both get the squared radius, which costs no square root, and no time: the fields by name follow.
    """

    is_spherical: ClassVar[bool] = True
    _force_method: ClassVar[str] = "pull"
    _energy_method: ClassVar[str] = "well"
    _place_arguments: ClassVar[tuple[str, ...]] = ("r2",)

    @staticmethod
    @abstractmethod
    def pull(r2: Any, *parameters: Any) -> Any:
        """Return ``a_r / r`` in (km/s)^2/kpc^2 at a squared radius in kpc^2, negative inwards: -G M(r) / r^3.

        The acceleration is this times (x, y, z). The rules for the arguments after r2, and for the arithmetic, are
        those of `Potential.acceleration`.
        """

    @staticmethod
    def well(r2: Any, *parameters: Any) -> Any:
        """Return the potential in (km/s)^2 for the same arguments. Optional: energies need it."""
        raise StreamkitError("this potential gives no potential energy: define `well` beside `pull`")

    @classmethod
    def acceleration(cls, x: Any, y: Any, z: Any, t: Any, *parameters: Any) -> Any:
        """Return the pull times the position; compiled code has the same formula in `engine.kernels`."""
        k = cls.pull(x * x + y * y + z * z + CENTRE, *parameters)
        return k * x, k * y, k * z

    @classmethod
    def potential(cls, x: Any, y: Any, z: Any, t: Any, *parameters: Any) -> Any:
        """Return the well at the radius of the position."""
        return cls.well(x * x + y * y + z * z + CENTRE, *parameters)

    @classmethod
    def has_energy(cls) -> bool:
        """Return whether the class defines `well`."""
        return cls.well is not Spherical.well
