"""Stripping schemes that follow a live progenitor: all its particles from the look-back time on.

What such a scheme does at the edge of each block of time is the method `LiveStripping.renew`: it sees all particles,
and says with which force the progenitor acts on them in the next block, how much mass it still has, and who is bound.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np
from pydantic import Field

from streamkit.components.bases import StrippingScheme
from streamkit.components.potential import Potential
from streamkit.stream import Array, BoolArray, Orbit
from streamkit.units import Duration

if TYPE_CHECKING:  # the engine brings numba, which naming a component does not need
    from streamkit.engine import Force


class SatelliteView(Protocol):
    """The progenitor at the look-back time, as a sphere in equilibrium. Raises OutOfDomain where it is none."""

    @property
    def potential(self) -> Potential:
        """Its own."""

    @property
    def mass(self) -> float:
        """Mass in Msun that its particles carry together: that inside `cut`."""

    @property
    def scale(self) -> float:
        """``G M / |Phi(0)|`` in kpc: the scale radius of a Plummer or Hernquist sphere."""

    @property
    def cut(self) -> float:
        """Radius in kpc beyond which it has no particles."""

    def mass_inside(self, r: Array) -> Array:
        """(n,) Mass in Msun inside radii r (n,) in kpc, without a cut."""

    def sample(self, points: Array) -> tuple[Array, Array]:
        """Return positions and velocities (3, n) about its centre, from uniform random numbers (6, n)."""

    def weigh(self, q: Array, v: Array, density: Callable[[Array], Array]) -> Array:
        """(n,) How many tracers each particle at q, v (3, n) about its centre stands for; their mean is 1.

        Tracers of a density (k,) at radii (k,) in kpc in its potential, in isotropic equilibrium: the ratio of their
        distribution function to that of the mass. Raises OutOfDomain where there is none.
        """


@dataclass(frozen=True)
class Population:
    """The particles of a progenitor at the look-back time.

    Attributes
    ----------
    q, v
        (3, n) Galactocentric positions and velocities.
    mass
        (n,) mass in Msun that each carries.
    weight
        (n,) how much each counts in the stream, such as its share of stars; their mean is 1.
    """

    q: Array
    v: Array
    mass: Array
    weight: Array


@dataclass(frozen=True)
class BlockEdge:
    """All particles at the edge of a block of time, and where their progenitor is.

    Attributes
    ----------
    start, t
        The look-back time and the time of this edge in kpc/(km/s), negative in the past.
    q, v
        (3, n) Galactocentric positions and velocities of the particles, in rows without gaps. Not to be changed.
    mass
        (n,) mass in Msun of each particle.
    core
        (9,) position, velocity and acceleration of the progenitor's centre.
    bracket
        ``Omega^2 - d^2 Phi / dr^2`` of the host there, in (km/s/kpc)^2: the tidal radius of a mass M is
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
        The force on its particles until the next edge, centred on the progenitor: a `Monopole`, which is quick, or any
        potential. Of one class throughout a stream and with as many parameters, it costs no compilation.
    mass
        Bound mass in Msun, zero or more.
    bound
        (n,) which particles are bound.
    """

    force: Force
    mass: float
    bound: BoolArray


class LiveStripping(StrippingScheme):
    """A scheme that fills the progenitor with particles at the look-back time and follows all of them.

    The mass and the size of the progenitor are those at the look-back time. Its particles move in the host and in the
    force that the scheme gives the progenitor, with leapfrog in equal steps: the section ``integrator`` is not used.
    Debris leaves when and where the tide takes it; the Lagrange point of each is found at the end, from the side on
    which it is. The fields below belong to every scheme of this sort.
    """

    draws: ClassVar[int] = 6
    """Uniform random numbers wanted per particle, in one sequence."""
    renewal: ClassVar[float] = 0.04
    """Longest time in Gyr between two calls of `renew`; it is shorter where the progenitor turns quickly."""

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

    def populate(self, core: Array, satellite: SatelliteView, points: Array) -> Population:
        """Fill the progenitor, whose centre is at core (9,), from uniform random numbers (draws, n).

        All particles carry the same mass, and are drawn from the isotropic distribution function.
        """
        q, v = satellite.sample(points)
        n = points.shape[1]
        return Population(q + core[:3, None], v + core[3:6, None], np.full(n, satellite.mass / n), np.ones(n))

    @abstractmethod
    def renew(self, edge: BlockEdge, satellite: SatelliteView, before: Remnant | None) -> Remnant:
        """Say what is left of the progenitor at the edge of a block.

        Called at the look-back time, at the end of each block and today, in order.

        Parameters
        ----------
        edge
            All particles now.
        satellite
            The progenitor at the look-back time.
        before
            What was left at the edge before; None at the look-back time.
        """

    def longest_step(self, satellite: SatelliteView, orbit: Orbit) -> float:
        """Return the longest step in kpc/(km/s) that the progenitor itself allows; no limit unless overridden."""
        return float("inf")
