"""A run file bound to parameter values: the inputs of the model."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from streamkit.components import HostData, Integrator, Observable, Potential, StrippingScheme, total_mass
from streamkit.errors import OutOfDomain, StreamkitError
from streamkit.runfile.encounter import Encounter
from streamkit.runfile.progenitor import Sun
from streamkit.stream import Array, Frame

ONLY = "stream"  # the name of the only stream of a run file that gives it none


def mass_of(potential: Potential, owner: str) -> float:
    """Return the mass in Msun of a progenitor or a body; OutOfDomain if it is infinite."""
    mass = total_mass(potential)
    if np.isnan(mass):
        raise OutOfDomain(f"the mass of {owner} is infinite")
    return mass


def extent_of(potential: Potential) -> float:
    """Return the scale length of a body in kpc; 0 for a point mass.

    That is the potential's ``scale_radius``, if it has such a property, else the first length among its fields.
    """
    if hasattr(potential, "scale_radius"):
        return float(potential.scale_radius)
    lengths = [name for name, unit in potential.parameters().items() if unit.name == "kpc"]
    return float(getattr(potential, lengths[0])) if lengths else 0.0


@dataclass(frozen=True)
class Body:
    """A galaxy that moves about the Milky Way, or a clump that moves in it."""

    potential: Potential  # the body's potential, centred on the body, with a mass
    # (3,) Galactocentric position (kpc) and velocity (km/s) today.
    q: Array
    v: Array
    friction: bool = True  # whether Chandrasekhar's dynamical friction in the Milky Way acts on its mass
    reflex: bool = True  # whether the Milky Way moves because of the body

    @cached_property
    def mass(self) -> float:
        """The body's mass in Msun, see `total_mass`. Raises OutOfDomain if the mass is infinite."""
        return mass_of(self.potential, "a body")

    @property
    def extent(self) -> float:
        """Its scale length in kpc, see `extent_of`."""
        return extent_of(self.potential)


@dataclass(frozen=True)
class FlyBy:
    """A body that has flown past a stream."""

    potential: Potential  # the body's potential, centred on the body, with a mass
    encounter: Encounter
    frame: Frame  # of the phi1 of the encounter

    @property
    def extent(self) -> float:
        """Its scale length in kpc, see `extent_of`."""
        return extent_of(self.potential)


@dataclass(frozen=True)
class StreamInputs:
    """One stream of a run file bound to parameter values: the inputs of the model."""

    potentials: dict[str, Potential]  # the host: name -> component; a single one is called ``potential``
    # the progenitor's potential, and its mass in Msun.
    satellite: Potential
    mass: float
    # (3,) Galactocentric position (kpc) and velocity (km/s) of the progenitor today.
    q: Array
    v: Array
    lookback: float  # Gyr
    stripping: StrippingScheme
    integrator: Integrator
    observables: dict[str, Observable]  # by name; a single one is called ``observable``
    seed: int  # the seed of this stream's random draws
    values: dict[str, float]  # the free parameters by name, in the units of the run file
    bodies: dict[str, Body] = field(default_factory=dict)  # the bodies that move about the host, by name
    flybys: dict[str, FlyBy] = field(default_factory=dict)  # the bodies that this stream has met, by name
    # the same settings as those of a `Body`, for the progenitor.
    friction: bool = False
    reflex: bool = False
    sun: Sun = field(default_factory=Sun)  # the Sun as the observer; its v_circ is a number
    name: str = ONLY  # the name of the stream in the run file

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
        """The progenitor as a body with friction or reflex; None if it is a test particle."""
        moved = self.friction or self.reflex
        return Body(self.satellite, self.q, self.v, self.friction, self.reflex) if moved else None

    def expansions(self) -> dict[str, str]:
        """Describe the expansions of potentials that are not compiled, by their path in the run file."""
        flybys = (flyby.potential for flyby in self.flybys.values())
        used = [*self.potentials.values(), *(body.potential for body in self.bodies.values()), *flybys, self.satellite]
        return {p.place or p.kind: expanded.text() for p in used if (expanded := p.expanded()) is not None}


@dataclass(frozen=True)
class ModelInputs:
    """A run file bound to parameter values: all its streams, and their common host and Sun."""

    # the host, the bodies and the Sun, as in every `StreamInputs`.
    potentials: dict[str, Potential]
    bodies: dict[str, Body]
    sun: Sun
    streams: dict[str, StreamInputs]  # the inputs of each stream by name; a single one is called ``stream``
    data: dict[str, HostData]  # the data without a stream, by name
    values: dict[str, float]  # the free parameters by name, in the units of the run file
    numbers: dict[str, float] = field(default_factory=dict)  # those of the host that the data read, by their paths
