"""The summary of the progenitor's orbit in the host."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from streamkit.errors import OutOfDomain
from streamkit.model import NODE, Host, next_apocentre, progenitor_track, stripped
from streamkit.runfile import StreamInputs
from streamkit.stream import Array, Orbit
from streamkit.units import GYR

HORIZON = 13.8  # look-back time in Gyr of the search for the progenitor's turning points: the age of the Universe


@dataclass(frozen=True)
class OrbitSummary:
    """The progenitor's orbit in the host alone, as far back as its period requires."""

    # (k,) turning radii in kpc, the latest first; empty where there are none within `HORIZON`.
    pericentres: Array
    apocentres: Array
    period: float  # radial period in Gyr, the mean over the turning points; NaN with fewer than two
    # whether the energy exceeds the potential at infinity; None where a component gives no potential.
    escapes: bool | None
    completed: int  # apocentres within the look-back time
    returns: bool  # whether the progenitor has another apocentre ahead
    # smallest and largest tidal radius in kpc within the look-back time; NaN where there is none.
    r_tidal: tuple[float, float]
    fastest: float = float("nan")  # largest angular velocity in radians per Gyr within the look-back time; NaN likewise
    # smallest and largest distance of every body from the Galactic centre in kpc within the look-back time.
    bodies: dict[str, tuple[float, float]] = field(default_factory=dict)


def summarise_orbit(inputs: StreamInputs) -> OrbitSummary:
    """Follow the progenitor back until it has turned twice at each end, at most to `HORIZON`."""
    host = Host(inputs.potentials, inputs.bodies, inputs.companion)
    reach, past = 1.0, None
    while True:
        try:
            past = host.until(-reach * GYR).orbit(inputs.q, inputs.v, 0.0, -reach * GYR, NODE)
        except OutOfDomain:  # a body that cannot be followed so far; a fault only if the stream needs it
            if past is None:
                raise
            break
        peri, apo = past.pericentres()[::-1], past.apocentres()[::-1]
        if min(len(peri), len(apo)) >= 2 or reach >= HORIZON or not np.isfinite(past.q).all():
            break
        reach = min(2 * reach, HORIZON)
    try:
        track = stripped(inputs, progenitor_track(host, inputs))
        completed = len(track.apocentres())
        r_tidal = float(track.r_tidal.min()), float(track.r_tidal.max())
        fastest = float(track.omega.max()) * GYR
    except OutOfDomain:
        completed, r_tidal, fastest = int((apo > -inputs.lookback * GYR).sum()), (np.nan, np.nan), np.nan
    orbits = host.paths(-inputs.lookback * GYR).bodies if host.bodies and np.isfinite(r_tidal[0]) else {}
    return OrbitSummary(
        pericentres=_radii(past, peri),
        apocentres=_radii(past, apo),
        period=_period(peri, apo) / GYR,
        escapes=host.unbinds(inputs.q, inputs.v),
        completed=completed,
        returns=next_apocentre(host, inputs) is not None,
        r_tidal=r_tidal,
        fastest=fastest,
        bodies={name: (float(orbit.r.min()), float(orbit.r.max())) for name, orbit in orbits.items()},
    )


def _radii(orbit: Orbit, times: Array) -> Array:
    return orbit.at(times).r if len(times) else np.empty(0)


def _period(peri: Array, apo: Array) -> float:
    """Return the mean time between like turning points, or twice that between two unlike ones."""
    gaps = [np.diff(times[::-1]) for times in (peri, apo) if len(times) > 1]
    if gaps:
        return float(np.concatenate(gaps).mean())
    return 2.0 * abs(float(peri[0] - apo[0])) if len(peri) and len(apo) else float("nan")
