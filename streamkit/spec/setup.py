"""A run file bound to parameter values: what the model computes with."""

from __future__ import annotations

from dataclasses import dataclass

from streamkit.components import Integrator, Observable, Potential, Stripping
from streamkit.stream import Array


@dataclass(frozen=True)
class Setup:
    """A run file bound to parameter values: what the model computes with.

    Attributes
    ----------
    potentials
        The host: name -> component; a single one is called ``potential``.
    satellite, mass
        The progenitor's own potential, and its ``mass`` in Msun.
    q, v
        (3,) Galactocentric position (kpc) and velocity (km/s) of the progenitor today.
    lookback
        Gyr.
    values
        The free parameters by name, in the units of the run file.
    """

    potentials: dict[str, Potential]
    satellite: Potential
    mass: float
    q: Array
    v: Array
    lookback: float
    stripping: Stripping
    integrator: Integrator
    observable: Observable | None
    seed: int
    values: dict[str, float]
