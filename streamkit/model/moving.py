"""The objects that move in a host: progenitors and bodies, with their orbits and tidal radii."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from streamkit.model.host import Host
from streamkit.model.progenitor import progenitor_track
from streamkit.model.satellite import Satellite
from streamkit.runfile import Source, as_spec
from streamkit.stream import Array, Orbit


@dataclass(frozen=True)
class Moving:
    """One object: its mass today in Msun, and its orbit over the longest look-back time, with its tidal radius."""

    mass: float
    orbit: Orbit

    def turning(self) -> dict[str, float]:
        """Return the last pericentre and apocentre: times in engine units and radii in kpc; NaN where there is none."""
        values = {}
        for name, times in (("peri", self.orbit.pericentres()), ("apo", self.orbit.apocentres())):
            last = self.orbit.at(times[-1:]) if len(times) else None
            values[f"t_{name}"] = np.nan if last is None else float(last.t[0])
            values[f"r_{name}"] = np.nan if last is None else float(last.r[0])
            values[f"r_tidal_{name}"] = np.nan if last is None else float(last.r_tidal[0])
        return values


def moving_objects(source: Source, parameters: Array | Mapping[str, float] | None = None) -> dict[str, Moving]:
    """Return the progenitors by the names of their streams, and the bodies as ``body NAME``.

    Tidal radii of progenitors are those in the host with all bodies, tidal radii of bodies those in the host alone.
    Raises OutOfDomain where an object has no orbit.
    """
    inputs = as_spec(source).bind_all(parameters)
    host = Host(inputs.potentials, inputs.bodies)
    objects = {}
    for name, stream in inputs.streams.items():
        beside = Host(inputs.potentials, inputs.bodies, stream.companion) if stream.companion else host
        objects[name] = Moving(stream.mass, progenitor_track(beside, stream))
    if not objects:  # data on the host alone: no look-back time says how far bodies are followed
        return {}
    longest = max(stream.lookback for stream in inputs.streams.values())
    for name, orbit in host.orbits(longest).items():
        body = inputs.bodies[name]
        alone = Host(inputs.potentials)
        r_tidal = Satellite(body.potential, body.mass).tidal_radius(alone.tidal_bracket(orbit))
        objects[f"body {name}"] = Moving(body.mass, replace(orbit, r_tidal=r_tidal))
    return objects
