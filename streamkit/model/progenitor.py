"""The progenitor: its track over the look-back time with its tidal radius, and its next apocentre."""

from __future__ import annotations

import numpy as np

from streamkit.engine import Field, build_field
from streamkit.errors import OutOfDomain
from streamkit.model.host import tidal_radius
from streamkit.model.release import losing_mass, release_times
from streamkit.spec import Setup
from streamkit.stream import Array, Orbit
from streamkit.units import GYR

NODE = 0.002 * GYR
"""Spacing of the progenitor's track: its interpolation error stays far below that of any particle."""

SHARPEST = 1.5
"""Most that the progenitor may turn between two nodes of its track, radians: its revolutions are counted by them."""

FUTURE = 6.0 * GYR
"""How far ahead the progenitor's next apocentre is looked for."""


def progenitor_track(host: Field, setup: Setup) -> tuple[Orbit, Array]:
    """Return the progenitor over the look-back time in the host alone, and when it releases its particles (n,).

    With the mass that it has left, and the tidal radius of that mass:
    r_t = [G M / (Omega^2 - d^2 Phi / dr^2)]^(1/3), Omega = |L| / r^2 instantaneous (Gibbons+ 2014, eq. 1).

    Raises
    ------
    OutOfDomain
        If there is no such orbit, no such radius, or no orbital plane.
    ComponentError
        As `release_times`.
    """
    with np.errstate(all="ignore"):  # what is not finite is found below, and has a reason of its own
        orbit = host.orbit(setup.q, setup.v, 0.0, -setup.lookback * GYR, NODE)
        if not (np.isfinite(orbit.q).all() and np.isfinite(orbit.v).all()):
            raise OutOfDomain(_not_finite(setup))
        if not orbit.omega.max() > 0:
            raise OutOfDomain("the progenitor moves on a line through the Galactic centre: there is no orbital plane")
        if not orbit.omega.max() * NODE <= SHARPEST:
            raise OutOfDomain("the progenitor passes too near the Galactic centre to be followed")
        r_tidal = tidal_radius(host, orbit, setup.mass)
    if np.isnan(r_tidal).any():
        raise OutOfDomain("the progenitor has no tidal radius somewhere on its track (Omega^2 <= d2Phi/dr2)")
    track = Orbit(orbit.t, orbit.q, orbit.v, orbit.a, r_tidal)
    times = release_times(setup.stripping, track)
    return losing_mass(track, setup.stripping.mass_loss, times), times


def _not_finite(setup: Setup) -> str:
    """Return the reason for an orbit that is not finite: by name the potential without a force, if one has none."""
    for potential in setup.potentials.values():
        if not np.isfinite(build_field([potential]).acceleration(0.0, setup.q[:, None])).all():
            return f"the acceleration of the potential {potential.kind} is not finite where the progenitor is today"
    return "the orbit of the progenitor is not finite"


def next_apocentre(host: Field, setup: Setup) -> Orbit | None:
    """Integrate the progenitor ahead until just past its next apocentre; None if it has none within 6 Gyr."""
    reach = 0.25 * GYR
    while reach <= FUTURE:
        orbit = host.orbit(setup.q, setup.v, 0.0, reach, NODE)
        if len(orbit.apocentres()):
            return orbit
        reach *= 2
    return None
