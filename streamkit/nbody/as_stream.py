"""Turn an N-body snapshot into a `Stream` with the conventions of the model: the same code then measures both.

The stripping time, the number of turns of the winding, and the phase chi, if the file lacks them, come from orbits:
the particles are followed back in the host with the run file's progenitor.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from streamkit.engine import build_field
from streamkit.errors import StreamkitError
from streamkit.model import Host, Satellite, next_apocentre, progenitor_track, stripped
from streamkit.nbody.rewind import distances, rewind
from streamkit.nbody.snapshot import Snapshot
from streamkit.runfile import StreamInputs
from streamkit.stream import LEADING, TRAILING, Array, BoolArray, Orbit, Stream, lag_in_plane, orbital_plane

FEWEST = 50  # fewest particles of a remnant
OFFSET = 1.0  # largest distance, in tidal radii, between the remnant and the run file's progenitor
SPEED_OFFSET = 0.1  # largest difference of their velocities, in units of the progenitor's speed
# Factor by which the median particle may be outside the progenitor's range of distances or speeds.
BEYOND = 10.0


def as_stream(snapshot: Snapshot, inputs: StreamInputs) -> Stream:
    """Return the snapshot's particles as a stream in the host, and about the progenitor, of a bound run file.

    The track of the core comes from the snapshot if it has one; otherwise the progenitor's orbit is used. The file says
    which particles are bound; otherwise these are the particles inside the tidal radius today. Only the whole turns of
    the file's windings are used: codes differ in the zero point of the winding by the size of the satellite.

    Raises StreamkitError if the snapshot cannot be this progenitor's: other units, another place, another velocity.
    """
    host = Host(inputs.potentials, inputs.bodies, inputs.companion)
    model_track = stripped(inputs, progenitor_track(host, inputs))
    _same_scale(snapshot, model_track)
    _same_place(snapshot, model_track, inputs)
    orbit = _track(snapshot, host, inputs, model_track)
    n = snapshot.q.shape[1]
    if snapshot.t_strip is not None:
        bound = np.isnan(snapshot.t_strip)
    else:
        bound = distances(snapshot.q, orbit.q[:, -1]) <= orbit.r_tidal[-1]
    t_strip, winding, chi = snapshot.t_strip, snapshot.winding, snapshot.chi
    if t_strip is None or winding is None or chi is None:
        field = host.until(float(model_track.t[0])).with_moving(build_field([inputs.satellite]), model_track)
        past = rewind(field, model_track, snapshot.q[:, ~bound], snapshot.v[:, ~bound])
        t_strip = _filled(bound, past.t_strip) if t_strip is None else t_strip
        winding = _filled(bound, past.winding) if winding is None else winding
        chi = _filled(bound, past.chi) if chi is None else chi
    today = lag_in_plane(orbital_plane(orbit), snapshot.q, orbit.q[:, -1:])
    winding = today + 2 * np.pi * np.round((np.where(bound, 0.0, winding) - today) / (2 * np.pi))
    nowhere = np.full((3, n), np.nan)
    dq, dv = (nowhere if x is None else x for x in (snapshot.dq_strip, snapshot.dv_strip))
    return Stream(
        q=snapshot.q,
        v=snapshot.v,
        t_release=np.full(n, orbit.t[0]),
        t_strip=np.where(bound, 0.0, t_strip),
        dq_galactocentric=dq,
        dv_galactocentric=dv,
        tail=np.where(winding > 0, LEADING, TRAILING),
        winding=winding,
        chi=chi,
        bound=bound,
        weight=np.ones(n),
        orbit=orbit,
        ahead=partial(next_apocentre, host, inputs),
        parameters=dict(inputs.values),
        sun=inputs.sun.observer,
        mass=inputs.mass,
    )


def _filled(bound: BoolArray, values: Array) -> Array:
    out = np.zeros(len(bound))
    out[~bound] = values
    return out


def _track(snapshot: Snapshot, host: Host, inputs: StreamInputs, model_track: Orbit) -> Orbit:
    if snapshot.core is None or snapshot.core.shape[1] < 2:
        return model_track
    t, q, v = snapshot.core[0], np.ascontiguousarray(snapshot.core[1:4]), np.ascontiguousarray(snapshot.core[4:])
    left = np.interp(t, model_track.t, model_track.mass_left)
    bare = Orbit(t, q, v, host.until(float(t[0])).acceleration(t, q, v), np.full(len(t), np.nan), left)
    satellite = Satellite(inputs.satellite, inputs.mass)
    return replace(bare, r_tidal=satellite.shrunk(satellite.tidal_radius(host.tidal_bracket(bare)), left))


def _same_scale(snapshot: Snapshot, track: Orbit) -> None:
    """Refuse particles whose distances or speeds are far from any of the progenitor's: their units are not as said."""
    speed = np.sqrt((track.v**2).sum(axis=0))
    for what, values, expected, unit in (
        ("distance", snapshot.q, track.r, "kpc"),
        ("speed", snapshot.v, speed, "km/s"),
    ):
        median = float(np.median(np.sqrt((values**2).sum(axis=0))))
        if not expected.min() / BEYOND < median < expected.max() * BEYOND:
            raise StreamkitError(
                f"{snapshot.source}: the median {what} is {median:.3g} {unit} in the units that the file states; the "
                f"progenitor of the run file has {expected.min():.3g} to {expected.max():.3g} {unit}. Are the units "
                "right, is the host's centre at the origin, and is the snapshot of this satellite?"
            )


def _same_place(snapshot: Snapshot, track: Orbit, inputs: StreamInputs) -> None:
    """Refuse a snapshot whose remnant is elsewhere: angles along the stream are counted from it."""
    state = snapshot.core[1:, -1] if snapshot.core is not None else remnant(snapshot.q, snapshot.v, track.r_tidal[-1])
    if state is None:
        return  # dissolved: nothing to compare with
    away = float(distances(state[:3, None], inputs.q)[0])
    faster = float(distances(state[3:, None], inputs.v)[0])
    if away > OFFSET * track.r_tidal[-1] or faster > SPEED_OFFSET * np.sqrt(inputs.v @ inputs.v):
        names = ("x", "y", "z", "vx", "vy", "vz")
        numbers = ", ".join(f"{name} = {value:.8g}" for name, value in zip(names, state, strict=True))
        raise StreamkitError(
            f"{snapshot.source}: its remnant is {away:.3g} kpc and {faster:.3g} km/s away from the run file's "
            f"progenitor, whose tidal radius is {track.r_tidal[-1]:.3g} kpc. To start the model from it, put into "
            f"[progenitor]: {numbers} (kpc and km/s, Galactocentric)."
        )


def remnant(q: Array, v: Array, r_tidal: float) -> Array | None:
    """(6,) Position and velocity of the densest clump by a shrinking sphere; None without one.

    A clump is no remnant if it holds fewer than `FEWEST` particles within a tidal radius, or not twice as many as the
    next tidal radius does: a piece of a stream holds as many.
    """
    centre = np.median(q, axis=1)
    radius = float(np.percentile(distances(q, centre), 90))
    while radius > 0.25 * r_tidal:
        inside = distances(q, centre) < radius
        if inside.sum() < FEWEST:
            break
        centre = q[:, inside].mean(axis=1)
        radius *= 0.9
    away = distances(q, centre)
    within, within_twice = int((away < r_tidal).sum()), int((away < 2 * r_tidal).sum())
    if within < FEWEST or within < 2 * (within_twice - within):
        return None
    core = away < 0.5 * r_tidal
    return np.concatenate([q[:, core].mean(axis=1), v[:, core].mean(axis=1)])
