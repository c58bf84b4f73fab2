"""The progenitor: its track over the look-back time with its tidal radius, and its next apocentre."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamkit.engine import build_field
from streamkit.errors import OutOfDomain
from streamkit.model.host import NODE, SHARPEST, Host
from streamkit.model.satellite import Satellite
from streamkit.runfile import StreamInputs
from streamkit.stream import Orbit
from streamkit.units import GYR

FUTURE = 6.0 * GYR  # limit of the search for the progenitor's next apocentre


def progenitor_track(host: Host, inputs: StreamInputs) -> Orbit:
    """Return the progenitor over the look-back time in the host, with the tidal radius of its whole mass.

    OutOfDomain if there is no such orbit, no such radius, or no orbital plane.
    """
    with np.errstate(all="ignore"):  # orbits that are not finite are refused below
        orbit = _orbit(host, inputs, -inputs.lookback * GYR)
        if not (np.isfinite(orbit.q).all() and np.isfinite(orbit.v).all()):
            raise OutOfDomain(_not_finite(inputs))
        if not orbit.omega.max() > 0:
            raise OutOfDomain("the progenitor moves on a line through the Galactic centre: there is no orbital plane")
        if not orbit.omega.max() * NODE <= SHARPEST:
            raise OutOfDomain("the progenitor passes too near the Galactic centre to be followed")
        r_tidal = Satellite(inputs.satellite, inputs.mass).tidal_radius(host.tidal_bracket(orbit))
    if np.isnan(r_tidal).any():
        raise OutOfDomain("the progenitor has no tidal radius somewhere on its track (Omega^2 <= d2Phi/dr2)")
    return replace(orbit, r_tidal=r_tidal)


def _orbit(host: Host, inputs: StreamInputs, t1: float) -> Orbit:
    """Integrate the progenitor from today to t1: as a test particle, or together with the bodies."""
    together = host.paths(t1).progenitor if host.progenitor else None
    return together or host.until(t1).orbit(inputs.q, inputs.v, 0.0, t1, NODE)


def _not_finite(inputs: StreamInputs) -> str:
    """Return the reason why an orbit is not finite: the potential whose force is not finite, if there is one."""
    for potential in inputs.potentials.values():
        if not np.isfinite(build_field([potential]).acceleration(0.0, inputs.q[:, None])).all():
            return f"the acceleration of the potential {potential.kind} is not finite where the progenitor is today"
    return "the orbit of the progenitor is not finite"


def next_apocentre(host: Host, inputs: StreamInputs) -> Orbit | None:
    """Integrate the progenitor ahead until just past its next apocentre; None if it has none within 6 Gyr."""
    reach = 0.25 * GYR
    while True:
        orbit = _orbit(host, inputs, reach)
        if len(orbit.apocentres()):
            return orbit
        if reach >= FUTURE:
            return None
        reach = min(2 * reach, FUTURE)
