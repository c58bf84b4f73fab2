"""A run file bound to parameter values: what the model computes with."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from streamkit.components import HostData, Integrator, Observable, Potential, StrippingScheme, total_mass
from streamkit.errors import OutOfDomain, StreamkitError
from streamkit.runfile.progenitor import Sun
from streamkit.stream import Array

ONLY = "stream"  # what the stream of a run file is called that has one, and does not name it


def mass_of(potential: Potential, owner: str) -> float:
    """Return the mass in Msun of what is a progenitor or a body; OutOfDomain if it has no end."""
    mass = total_mass(potential)
    if np.isnan(mass):
        raise OutOfDomain(f"the mass of {owner} has no end")
    return mass


@dataclass(frozen=True)
class Body:
    """A galaxy beside the Milky Way, or a clump in it, that moves.

    Attributes
    ----------
    potential
        What it attracts with, centred on itself; it has a mass.
    q, v
        (3,) Galactocentric position (kpc) and velocity (km/s) today.
    friction
        Whether the Milky Way slows it down (Chandrasekhar's dynamical friction on its mass).
    reflex
        Whether the Milky Way moves because of it.
    """

    potential: Potential
    q: Array
    v: Array
    friction: bool = True
    reflex: bool = True

    @cached_property
    def mass(self) -> float:
        """Its mass in Msun, see `total_mass`. Raises OutOfDomain if it has no end."""
        return mass_of(self.potential, "a body")

    @property
    def extent(self) -> float:
        """Its scale length in kpc; 0 for a point mass.

        That is the potential's ``scale_radius``, if it has such a property, else the first length among its fields.
        """
        if hasattr(self.potential, "scale_radius"):
            return float(self.potential.scale_radius)
        lengths = [name for name, unit in self.potential.parameters().items() if unit.name == "kpc"]
        return float(getattr(self.potential, lengths[0])) if lengths else 0.0


@dataclass(frozen=True)
class StreamInputs:
    """One stream of a run file bound to parameter values: what the model computes with.

    Attributes
    ----------
    potentials
        The host: name -> component; a single one is called ``potential``.
    bodies
        The galaxies beside it, by name.
    satellite, mass
        The progenitor's own potential, and its mass in Msun.
    q, v
        (3,) Galactocentric position (kpc) and velocity (km/s) of the progenitor today.
    lookback
        Gyr.
    observables
        By name; a single one is called ``observable``.
    seed
        That of its own random draws.
    sun
        The Sun that the stream is seen from; its v_circ is a number.
    values
        The free parameters by name, in the units of the run file.
    friction, reflex
        As those of a `Body`, for the progenitor.
    name
        What the run file calls the stream.
    """

    potentials: dict[str, Potential]
    satellite: Potential
    mass: float
    q: Array
    v: Array
    lookback: float
    stripping: StrippingScheme
    integrator: Integrator
    observables: dict[str, Observable]
    seed: int
    values: dict[str, float]
    bodies: dict[str, Body] = field(default_factory=dict)
    friction: bool = False
    reflex: bool = False
    sun: Sun = field(default_factory=Sun)
    name: str = ONLY

    @property
    def observable(self) -> Observable | None:
        """The only observable; None without one. StreamkitError if there are several."""
        if len(self.observables) > 1:
            raise StreamkitError(
                f"there are several observables, {', '.join(self.observables)}: choose one by its name"
            )
        return next(iter(self.observables.values()), None)

    @property
    def companion(self) -> Body | None:
        """The progenitor as a body that is slowed down, or moves the Milky Way; None if it is a test particle."""
        moved = self.friction or self.reflex
        return Body(self.satellite, self.q, self.v, self.friction, self.reflex) if moved else None

    def expansions(self) -> dict[str, str]:
        """Describe the expansions that stand for potentials which are not compiled, by their path in the run file."""
        used = [*self.potentials.values(), *(body.potential for body in self.bodies.values()), self.satellite]
        return {p.place or p.kind: found.text() for p in used if (found := p.expanded()) is not None}


@dataclass(frozen=True)
class ModelInputs:
    """A run file bound to parameter values: all its streams, and what they share.

    Attributes
    ----------
    potentials, bodies, sun
        The host, the galaxies beside it and the Sun, as in every `StreamInputs`.
    streams
        What each stream is computed with, by name; a single one is called ``stream``.
    data
        Those that are no stream, by name.
    values
        The free parameters by name, in the units of the run file.
    """

    potentials: dict[str, Potential]
    bodies: dict[str, Body]
    sun: Sun
    streams: dict[str, StreamInputs]
    data: dict[str, HostData]
    values: dict[str, float]
