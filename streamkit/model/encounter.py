"""Bodies that have flown past a stream: the point of the stream that each of them met, and its orbit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from streamkit.components import Potential, Stripping
from streamkit.engine import Field, build_field
from streamkit.errors import OutOfDomain
from streamkit.model.host import NODE, Host
from streamkit.model.integrate import integrate
from streamkit.model.release import Start, release_particles
from streamkit.runfile import FlyBy, StreamInputs
from streamkit.stream import Array, Orbit, seen_from, sky_matrix
from streamkit.units import GYR

PROBES = 512  # particles without random velocities that show where the unperturbed stream was
WINDOW = 2.0  # standard deviation in degrees of the weights of probes about phi1
LEAST = 4.0  # smallest sum of these weights: the stream ends beyond
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


def flights_past(inputs: StreamInputs, host: Host, track: Orbit) -> list[Flight]:
    """Return the orbits of all bodies that this stream has met; OutOfDomain if the stream has no such point.

    The point is one of the stream as it would be without encounters: the mean of the particles that would be at phi1
    today, back at the time of the encounter. Particles without random velocities show it. They follow all of the
    scheme, the host and the gravity of the progenitor, so the arms may lie beside the progenitor's orbit, by more
    than an impact parameter. The mean is a local quadratic regression on phi1 with Gaussian weights: it is smooth in
    all parameters.
    """
    scheme = inputs.stripping
    if not inputs.flybys or not isinstance(scheme, Stripping):
        return []
    few = replace(inputs, stripping=scheme.model_copy(update={"particles": PROBES}))
    start = release_particles(few, track, np.zeros((scheme.draws, PROBES)))
    field = host.until(float(track.t[0]))
    beside = with_progenitor(field, inputs, start.orbit)
    return [_flight(one, inputs, field, beside, start) for one in inputs.flybys.values()]


def with_progenitor(field: Field, inputs: StreamInputs, orbit: Orbit) -> Field:
    """Return the field with the gravity of the progenitor on its orbit, if the scheme has it."""
    if isinstance(inputs.stripping, Stripping) and inputs.stripping.progenitor_gravity:
        return field.with_moving(build_field([inputs.satellite]), orbit)
    return field


def _flight(flyby: FlyBy, inputs: StreamInputs, field: Field, beside: Field, start: Start) -> Flight:
    time, track = -flyby.encounter.time * GYR, start.orbit
    if not track.t[0] < time < 0:
        raise OutOfDomain(
            f"an encounter was {flyby.encounter.time:g} Gyr ago, and the stream begins {-track.t[0] / GYR:g} Gyr ago"
        )
    point = _point(flyby, inputs, beside, start, time)
    q, v = _at_encounter(flyby, *point)
    speed = float(np.linalg.norm(v - point[1]))
    if not speed > 0:
        raise OutOfDomain("a body that flies by has no velocity relative to the stream")
    size = max(flyby.extent, SMALLEST)
    duration = float(np.hypot(flyby.encounter.impact_parameter, size)) / speed
    return Flight(flyby.potential, _through(field, q, v, time, track.t), time, duration, size)


def _point(flyby: FlyBy, inputs: StreamInputs, field: Field, start: Start, time: float) -> tuple[Array, Array]:
    """Return position and velocity (3,) of the point of the stream at the time of the encounter."""
    released = start.at_release.t < time
    before, after = (start.orbit.at(times) for times in _cut(start.orbit.t, time))
    tail, q, v = start.tail[released], start.q[:, released], start.v[:, released]
    chosen = Start(before, start.orbit.at(start.at_release.t[released]), tail, q, v)
    then = integrate(field, inputs.integrator, chosen)
    now_there = Start(after, start.orbit.at(np.full(len(tail), time)), tail, then.q, then.v)
    today = integrate(field, inputs.integrator, now_there)
    seen = seen_from(inputs.sun.observer, today.q, today.v, sky_matrix(flyby.frame))
    phi1 = flyby.encounter.phi1
    away = (seen.lon - phi1 + 180.0) % 360.0 - 180.0
    weight = np.exp(-0.5 * (away / WINDOW) ** 2)
    if not weight.sum() >= LEAST:
        raise OutOfDomain(
            f"the stream that a body meets has no particles at phi1 = {phi1:g} deg today; without encounters those "
            f"released by then reach from {seen.lon.min():.1f} to {seen.lon.max():.1f} deg"
        )
    root = np.sqrt(weight)
    powers = np.stack([root, root * away, root * away**2], axis=1)
    fitted = np.linalg.lstsq(powers, (root * np.concatenate([then.q, then.v])).T, rcond=None)[0]
    q, v = np.split(fitted[0], 2)
    along = v / np.linalg.norm(v)
    rest = then.q - q[:, None]
    rest = rest - along[:, None] * (along @ rest)
    if not weight @ (rest**2).sum(axis=0) <= THICKEST**2 * (q @ q) * weight.sum():
        raise OutOfDomain(f"the stream that a body meets is in several places at phi1 = {phi1:g} deg")
    return q, v


def _cut(t: Array, time: float) -> tuple[Array, Array]:
    """Return the times up to a time, and those from it on."""
    return np.append(t[t < time], time), np.append(time, t[t > time])


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


def _through(field: Field, q: Array, v: Array, time: float, grid: Array) -> Orbit:
    """Return the orbit through q, v (3,) at a time, on a grid of times; OutOfDomain if it is not finite."""
    with np.errstate(all="ignore"):  # orbits that are not finite are refused below
        past, future = (field.orbit(q, v, time, float(end), NODE) for end in (grid[0], grid[-1]))
        both = ("t", "q", "v", "a", "r_tidal")
        joined = {
            name: np.concatenate([getattr(past, name)[..., :-1], getattr(future, name)], axis=-1) for name in both
        }
        orbit = Orbit(**joined).at(grid)
    if not (np.isfinite(orbit.q).all() and np.isfinite(orbit.v).all()):
        raise OutOfDomain("the orbit of a body that flies by is not finite")
    return orbit
