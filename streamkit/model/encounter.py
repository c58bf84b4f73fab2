"""Bodies that have flown past a stream: the point of the stream that each of them met, and its orbit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from streamkit.components import Potential, Stripping
from streamkit.engine import Field, build_field
from streamkit.errors import OutOfDomain, blamed
from streamkit.model.blocks import block_edges
from streamkit.model.host import Host
from streamkit.model.release import Start, release_particles
from streamkit.runfile import FlyBy, StreamInputs
from streamkit.stream import Array, Orbit, seen_from, sky_matrix
from streamkit.units import GYR

PROBES = 256  # particles without random velocities that show where the unperturbed stream was
BLOCKS = 2  # blocks of the stream in one of the probes, of which no records are kept
WINDOW = 2.0  # standard deviation in degrees of the weights of probes about phi1
UNSEEN = 1e-9  # weight below which a probe is left out
LEAST = 2.0  # smallest sum of these weights: the stream ends beyond
SMALLEST = 1e-4  # size of an encounter in kpc that its steps resolve, where a point mass hits the stream
THICKEST = 0.1  # largest thickness of a stream, in units of its distance from the Galactic centre


@dataclass(frozen=True)
class Flight:
    """The orbit of a body that has flown past a stream."""

    potential: Potential
    orbit: Orbit  # on the grid of times of the progenitor's track
    time: float  # of the encounter
    duration: float  # the impact parameter and the extent together, over the relative speed
    size: float  # the extent of the body in kpc


def flights_past(inputs: StreamInputs, host: Host, track: Orbit, orbit: Orbit, field: Field) -> list[Flight]:
    """Return the orbits of all bodies that this stream has met; OutOfDomain if the stream has no such point.

    ``orbit`` is the track with the remaining mass of the progenitor, and the field is `with_progenitor` on it.
    The point is one of the stream as it would be without encounters: the mean of the particles that would be at phi1
    today, back at the time of the encounter. Particles without random velocities show it. They follow all of the
    scheme, the host and the gravity of the progenitor, so the arms may lie beside the progenitor's orbit, by more
    than an impact parameter. The mean is a local quadratic regression on phi1 with Gaussian weights: it is smooth in
    all parameters.
    """
    scheme = inputs.stripping
    if not inputs.flybys or not isinstance(scheme, Stripping):
        return []
    flybys = list(inputs.flybys.values())
    for name, flyby in inputs.flybys.items():
        ago, begins = flyby.encounter.time, -track.t[0] / GYR
        if not 0 < ago < begins:
            raise OutOfDomain(f"body {name}: it came {ago:g} Gyr ago, and the stream begins {begins:g} Gyr ago")
    few = replace(inputs, stripping=scheme.model_copy(update={"particles": PROBES}))
    start = release_particles(few, track, np.zeros((scheme.draws, PROBES)), orbit)
    times = np.array([-flyby.encounter.time * GYR for flyby in flybys])
    then, today = _probes(field, inputs, start, times)
    longitudes = dict[bytes, Array]()  # of all probes, once in each frame
    points = []
    for (name, flyby), state in zip(inputs.flybys.items(), then, strict=True):
        frame = np.asarray(sky_matrix(flyby.frame))
        if frame.tobytes() not in longitudes:
            longitudes[frame.tobytes()] = seen_from(inputs.sun.observer, today[:3], today[3:], frame).lon
        try:
            points.append(_point(flyby, state, longitudes[frame.tobytes()]))
        except OutOfDomain as error:
            raise OutOfDomain(f"body {name}: {error.reason}") from None
    states = [_at_encounter(flyby, *point) for flyby, point in zip(flybys, points, strict=True)]
    q, v = (np.array([state[k] for state in states]).T for k in (0, 1))
    with np.errstate(all="ignore"):  # orbits that are not finite are refused below
        orbits = host.until(float(track.t[0])).orbits(times, q, v, track.t)
    flights = []
    for name, flyby, orbit, time, point, (_, velocity) in zip(
        inputs.flybys, flybys, orbits, times, points, states, strict=True
    ):
        if not (np.isfinite(orbit.q).all() and np.isfinite(orbit.v).all()):
            raise OutOfDomain(f"body {name}: its orbit is not finite")
        speed = float(np.linalg.norm(velocity - point[1]))
        if not speed > 0:
            raise OutOfDomain(f"body {name}: it has no velocity relative to the stream")
        size = max(flyby.extent, SMALLEST)
        duration = float(np.hypot(flyby.encounter.impact_parameter, size)) / speed
        flights.append(Flight(flyby.potential, orbit, float(time), duration, size))
    return flights


def with_progenitor(field: Field, inputs: StreamInputs, orbit: Orbit) -> Field:
    """Return the field with the gravity of the progenitor on its orbit, if the scheme has it."""
    if isinstance(inputs.stripping, Stripping) and inputs.stripping.progenitor_gravity:
        return field.with_moving(build_field([inputs.satellite]), orbit)
    return field


def _probes(field: Field, inputs: StreamInputs, start: Start, times: Array) -> tuple[list[Array], Array]:
    """Return states (6, m) of the m particles released by each of some times, and those of all (6, n) today."""
    orbit, state, now = start.orbit, np.concatenate([start.q, start.v]), start.at_release.t.copy()
    blocks = block_edges(orbit, inputs.integrator)
    edges = np.union1d([*blocks[:-1:BLOCKS], blocks[-1]], times)[1:]
    active = np.searchsorted(start.at_release.t, edges, side="left").tolist()
    asked, at = set(times.tolist()), dict[float, Array]()
    with blamed(f"integrator {inputs.integrator.kind}"):
        for t1, m in zip(edges.tolist(), active, strict=True):
            inputs.integrator.advance(field, state[:3, :m], state[3:, :m], now[:m], t1)
            now[:m] = t1
            if t1 in asked:
                at[t1] = state[:, :m].copy()
    return [at[time] for time in times.tolist()], state


def _point(flyby: FlyBy, then: Array, longitude: Array) -> tuple[Array, Array]:
    """Return position and velocity (3,) of the point of the stream that a body met.

    then (6, m) are the states of the particles that had been released, at the time of the encounter, and longitude
    (n,) is phi1 of all particles today.
    """
    longitude, phi1 = longitude[: then.shape[1]], flyby.encounter.phi1
    away = (longitude - phi1 + 180.0) % 360.0 - 180.0
    weight = np.exp(-0.5 * (away / WINDOW) ** 2)
    if not weight.sum() >= LEAST:
        reach = f"from {longitude.min():.1f} to {longitude.max():.1f} deg" if len(away) else "nowhere"
        raise OutOfDomain(
            f"the stream that a body meets has no particles at phi1 = {phi1:g} deg today; without encounters those "
            f"released by then reach {reach}"
        )
    near = weight > UNSEEN
    weight, away, then = weight[near], away[near], then[:, near]
    root = np.sqrt(weight)
    powers = np.stack([root, root * away, root * away**2], axis=1)
    fitted = np.linalg.lstsq(powers, (root * then).T, rcond=None)[0]
    q, v = np.split(fitted[0], 2)
    along = v / np.linalg.norm(v)
    rest = then[:3] - q[:, None]
    rest = rest - along[:, None] * (along @ rest)
    if not weight @ (rest**2).sum(axis=0) <= THICKEST**2 * (q @ q) * weight.sum():
        raise OutOfDomain(f"the stream that a body meets is in several places at phi1 = {phi1:g} deg")
    return q, v


def _at_encounter(flyby: FlyBy, q: Array, v: Array) -> tuple[Array, Array]:
    """Return position and velocity (3,) of a body at its closest approach to a point of a stream at q, v (3,)."""
    encounter, psi = flyby.encounter, np.radians(flyby.encounter.angle)
    along = v / np.linalg.norm(v)
    outward = q - along * (along @ q)
    if not np.linalg.norm(outward) > 1e-9 * np.linalg.norm(q):
        raise OutOfDomain("the stream that a body meets moves along a line through the Galactic centre")
    outward = outward / np.linalg.norm(outward)
    pole = np.cross(outward, along)
    aside, turn = np.cos(psi) * outward + np.sin(psi) * pole, np.cos(psi) * pole - np.sin(psi) * outward
    relative = encounter.v_parallel * along + encounter.v_perpendicular * turn
    return q + encounter.impact_parameter * aside, v + relative
