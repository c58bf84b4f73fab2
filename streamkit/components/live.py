"""Stripping schemes that follow a live progenitor: all its particles from the look-back time on.

At the edge of each block of time the model calls the method `LiveStripping.update_remnant`. The method sees all
particles. It returns the force of the progenitor on them in the next block, the bound mass, and which particles are
bound.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from pydantic import Field

from streamkit.components.bases import StrippingScheme
from streamkit.components.potential import Potential
from streamkit.renamed import Renamed, adopt
from streamkit.stream import Array, BoolArray, Orbit
from streamkit.units import Duration

if TYPE_CHECKING:  # the engine brings numba, which naming a component does not need
    from streamkit.engine import Force


class SatelliteView(Protocol):
    """The progenitor at the look-back time, as a sphere in equilibrium.

    Raises OutOfDomain: If the progenitor is no such sphere.
    """

    @property
    def potential(self) -> Potential:
        """The potential of the progenitor."""

    @property
    def mass(self) -> float:
        """Mass in Msun of all particles together: the mass inside `cut`."""

    @property
    def scale(self) -> float:
        """``G M / |Phi(0)|`` in kpc: the scale radius of a Plummer or Hernquist sphere."""

    @property
    def cut(self) -> float:
        """Radius in kpc beyond which there are no particles."""

    def mass_inside(self, r: Array) -> Array:
        """(n,) Mass in Msun inside radii r (n,) in kpc, without a cut."""

    def sample(self, points: Array) -> tuple[Array, Array]:
        """Return positions and velocities (3, n) about the centre, from uniform random numbers (6, n)."""

    def weigh(self, q: Array, v: Array, density: Callable[[Array], Array]) -> Array:
        """(n,) Number of tracers that each particle at q, v (3, n) about the centre stands for, with a mean of 1.

        The tracers have a density (k,) at radii (k,) in kpc and are in isotropic equilibrium in the progenitor's
        potential. The number is the ratio of their distribution function to that of the mass.

        Raises OutOfDomain: If there is no such equilibrium.
        """


@dataclass(frozen=True)
class Population:
    """The particles of a progenitor at the look-back time.

    Attributes
    ----------
    q, v
        (3, n) Galactocentric positions and velocities.
    mass
        (n,) mass in Msun of each particle.
    weight
        (n,) weight of each particle in the stream, such as its share of stars, with a mean of 1.
    """

    q: Array
    v: Array
    mass: Array
    weight: Array


@dataclass(frozen=True)
class BlockEdge:
    """All particles at the edge of a block of time, and the state of their progenitor.

    Attributes
    ----------
    start, t
        The look-back time and the time of this edge in kpc/(km/s), negative in the past.
    q, v
        (3, n) Galactocentric positions in kpc and velocities in km/s of the particles, in rows without gaps. Read only.
    mass
        (n,) mass in Msun of each particle.
    core
        (9,) position in kpc, velocity in km/s and acceleration in (km/s)^2/kpc of the progenitor's centre.
    bracket
        ``Omega^2 - d^2 Phi / dr^2`` of the host at the centre, in (km/s/kpc)^2. The tidal radius of a mass M is
        ``(G M / bracket)^(1/3)``.
    """

    start: float
    t: float
    q: Array
    v: Array
    mass: Array
    core: Array
    bracket: float


@dataclass(frozen=True)
class Remnant:
    """What is left of the progenitor at the edge of a block.

    Attributes
    ----------
    force
        The force on the particles until the next edge, centred on the progenitor: a `Monopole`, which is quick, or any
        potential. A force of the same class with the same number of parameters at every edge costs no compilation.
    mass
        Bound mass in Msun, zero or more.
    bound
        (n,) whether each particle is bound.
    """

    force: Force
    mass: float
    bound: BoolArray


class LiveStripping(StrippingScheme):
    """A scheme that fills the progenitor with particles at the look-back time and follows all of them.

    For each stream the model calls `longest_step`, then `populate` once, then `update_remnant` at the look-back time
    and at the end of each block of time, the last of which ends today. Units are kpc, km/s, Msun and kpc/(km/s).
    Methods may raise OutOfDomain: there is no stream at these parameters. Any other exception ends the run as a
    ComponentError. An instance keeps no state between calls.

    The mass and the size of the progenitor are those at the look-back time. Its particles move in the host and in the
    force of the remnant, with leapfrog in equal steps: the section ``integrator`` is not used. The tide strips the
    debris. The Lagrange point of each particle follows from its side of the progenitor today. Every such scheme has the
    fields below.
    """

    draws: ClassVar[int] = 6
    """Uniform random numbers for each particle, in one sequence."""
    longest_block: ClassVar[float] = 0.04
    """Longest time in Gyr between two calls of `update_remnant`. It is shorter where the progenitor turns quickly."""

    particles: int = Field(default=20000, ge=50, description="Number of particles that fill the progenitor.")
    quasi_random: bool = Field(
        default=True, description="Draw the particles from a scrambled Sobol sequence, or independently."
    )
    passages: int | None = Field(
        default=None,
        ge=1,
        description="Number of pericentre passages of the live progenitor: it starts at the apocentre before the first "
        "of them, within the look-back time, and ln L has no step where the look-back time would pass an apocentre. "
        "Without it, it starts at the look-back time.",
    )
    step: Duration = Field(
        default=0.005,
        description="Longest time step. It is shorter where the progenitor or its pericentre asks for it: at most 0.35 "
        "dynamical times (a^3 / G M)^(1/2), and 0.06 of distance over speed of the progenitor.",
    )

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Accept the former names of what a scheme defines: plugins of contract 1 may use them."""
        super().__init_subclass__(**kwargs)
        adopt(cls, "renew", "update_remnant")
        adopt(cls, "renewal", "longest_block")

    renew: ClassVar[Any] = Renamed("renew", "update_remnant")
    renewal: ClassVar[Any] = Renamed("renewal", "longest_block")

    def populate(self, core: Array, satellite: SatelliteView, points: Array) -> Population:
        """Fill the progenitor, whose centre is at core (9,) as in `BlockEdge`, from uniform random numbers (draws, n).

        By default all particles have the same mass and are drawn from the isotropic distribution function.
        """
        q, v = satellite.sample(points)
        n = points.shape[1]
        return Population(q + core[:3, None], v + core[3:6, None], np.full(n, satellite.mass / n), np.ones(n))

    @abstractmethod
    def update_remnant(self, edge: BlockEdge, satellite: SatelliteView, previous: Remnant | None) -> Remnant:
        """Return what is left of the progenitor at the edge of a block.

        Called at the look-back time, at the end of each block and today, in order.

        Parameters
        ----------
        edge
            All particles now.
        satellite
            The progenitor at the look-back time.
        previous
            The remnant at the previous edge; None at the look-back time.
        """

    def longest_step(self, satellite: SatelliteView, orbit: Orbit) -> float:
        """Return the longest step in kpc/(km/s) that the progenitor itself allows. By default there is no limit."""
        return float("inf")
