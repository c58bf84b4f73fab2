"""A live progenitor: its particles are followed together, and its force is renewed at the edge of every block."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamkit.components import BlockEdge, LiveStripping, Population, Remnant
from streamkit.engine import MovingForce, record_together
from streamkit.errors import ComponentError, OutOfDomain, blamed
from streamkit.model.equilibrium import Equilibrium
from streamkit.model.host import Host
from streamkit.model.integrate import Records
from streamkit.model.progenitor import progenitor_track
from streamkit.runfile import StreamInputs
from streamkit.stream import LEADING, TRAILING, Array, IntArray, Orbit, angle_in_plane, orbital_plane, read_only
from streamkit.units import GYR, G

MOST_STEPS = 20_000  # most steps from the look-back time to today
SHARE_OF_ORBIT = 0.06  # longest step in units of the progenitor's distance over its speed
ELSEWHERE = 0.01  # longest time in Gyr between two kicks by the host, for the debris that is elsewhere on the orbit
ARC = 0.4  # radians that the progenitor turns in a block at most
# Dynamical times (a^3 / G M)^(1/2) in which the progenitor may not lose all of its mass but this share.
AT_ONCE, LITTLE = 10.0, 0.01
UNBOUND = 0.5  # most of the mass that may be unbound at the start: more is no progenitor


def follow_live(
    inputs: StreamInputs, scheme: LiveStripping, host: Host, track: Orbit, points: Array, threads: int
) -> tuple[Orbit, Records, IntArray, Array]:
    """Follow the particles of a live progenitor along its track, from uniform random numbers (draws, n).

    Returns the track with the mass that the progenitor has left, and the tidal radius of that; the records of the
    particles; the Lagrange point (n,) on whose side each is today; and how much each counts (n,).

    OutOfDomain if the progenitor is no equilibrium, does not fit into its tidal radius at the look-back time, or asks
    for too many steps. ComponentError if the scheme fails.
    """
    name = f"stripping {scheme.kind}"
    satellite = Equilibrium(inputs.satellite)
    with np.errstate(all="ignore"):
        bracket = host.tidal_bracket(track)
    edges, steps, kicks = _blocks(scheme, satellite, track)
    at_edges = track.at(edges)
    brackets = np.interp(edges, track.t, bracket)
    states = np.ascontiguousarray(np.concatenate([at_edges.q, at_edges.v, at_edges.a]).T)
    with blamed(name):
        people = scheme.populate(read_only(states[0].copy()), satellite, read_only(points))
    q, v, mass = _checked(people, name)
    dynamical = np.sqrt(satellite.scale**3 / (G * satellite.mass))
    field = replace(host.until(float(track.t[0])), threads=threads)
    moving = MovingForce(field, track)
    books = _Books(track, q, v, edges[0], at_edges)

    def renewed(k: int, before: Remnant | None) -> Remnant:
        """Return what is left of the progenitor at an edge, by the scheme."""
        with blamed(name):
            edge = BlockEdge(float(edges[0]), float(edges[k]), q, v, mass, states[k], brackets[k])
            after = scheme.renew(edge, satellite, before)
        left[k] = _bound_mass(after, name)
        r_tidal[k] = np.cbrt(G * left[k] / brackets[k])
        return after

    left, r_tidal = np.empty(len(edges)), np.empty(len(edges))
    remnant = renewed(0, None)
    _must_fit(satellite, left[0], r_tidal[0])
    books.open(states[0], r_tidal[0])
    for k in range(1, len(edges)):
        moving.advance(remnant.force, q, v, edges[k - 1], edges[k], steps[k - 1], kicks[k - 1])
        remnant = renewed(k, remnant)
        if left[k] < LITTLE * left[0] and edges[k] - edges[0] < AT_ONCE * dynamical:
            raise OutOfDomain(
                f"the progenitor {inputs.satellite.kind} dissolves at once: within {AT_ONCE:g} of its dynamical times "
                "from the look-back time next to nothing of it is bound. It is too large for its tidal radius"
            )
        books.write(edges[k], states[k], r_tidal[k])
    done = books.close(remnant)
    over_time = np.interp(track.t, edges, left)
    orbit = replace(track, r_tidal=np.cbrt(G * over_time / bracket), mass_left=over_time / inputs.mass)
    tail = np.where(done.winding > 0, LEADING, TRAILING)
    return orbit, done, tail, people.weight


def live_track(inputs: StreamInputs, scheme: LiveStripping, host: Host, track: Orbit) -> Orbit:
    """Return the track of a live progenitor: from the look-back time, or from the apocentre that ``passages`` asks for.

    OutOfDomain if the look-back time does not hold so many.
    """
    if scheme.passages is None:
        return track
    pericentres, apocentres = track.pericentres(), track.apocentres()
    if len(pericentres) < scheme.passages:
        raise OutOfDomain("the look-back time holds fewer pericentre passages than stripping.passages")
    before = apocentres[apocentres < pericentres[-scheme.passages]]
    if len(before) == 0:
        raise OutOfDomain("the look-back time does not reach the apocentre before the first of stripping.passages")
    return progenitor_track(host, replace(inputs, lookback=-float(before[-1]) / GYR))


def _blocks(scheme: LiveStripping, satellite: Equilibrium, track: Orbit) -> tuple[Array, list[int], list[int]]:
    """Return the edges of the blocks (k + 1,), and the least number of steps and of the host's kicks in each (k,)."""
    rate = np.maximum(1 / (scheme.renewal * GYR), track.omega / ARC)
    blocks = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(track.t))])
    edges = np.interp(np.linspace(0.0, blocks[-1], max(int(np.ceil(blocks[-1])), 1) + 1), blocks, track.t)
    with blamed(f"stripping {scheme.kind}"):
        longest = min(scheme.step * GYR, scheme.longest_step(satellite, track))
    allowed = SHARE_OF_ORBIT * track.r / np.sqrt((track.v**2).sum(axis=0))
    pieces = np.maximum(np.searchsorted(track.t, edges[:-1], side="right") - 1, 0)
    spans = np.diff(edges)
    kicks = np.ceil(spans / np.minimum(np.minimum.reduceat(allowed, pieces), ELSEWHERE * GYR) - 1e-9)
    steps = np.ceil(spans / longest - 1e-9)
    if not np.maximum(steps, kicks).sum() <= MOST_STEPS:
        raise OutOfDomain(
            f"the progenitor takes more than {MOST_STEPS} time steps with the stripping {scheme.kind}: it is too "
            "dense, or passes too near the Galactic centre"
        )
    return edges, steps.astype(int).tolist(), kicks.astype(int).tolist()


def _checked(people: Population, name: str) -> tuple[Array, Array, Array]:
    """Return positions, velocities (3, n) and masses (n,) of their own; ComponentError for other shapes or numbers."""
    n = len(people.mass)
    for what, values, shape in (
        ("q", people.q, (3, n)), ("v", people.v, (3, n)), ("mass", people.mass, (n,)), ("weight", people.weight, (n,)),
    ):  # fmt: skip
        if np.shape(values) != shape:
            raise ComponentError(f"{name}: `populate` gave {what} of the shape {np.shape(values)}, expected {shape}")
        if not np.isfinite(values).all():
            raise ComponentError(f"{name}: `populate` gave {what} with numbers that are not finite")
    q, v, mass = (np.array(x, dtype=float, order="C") for x in (people.q, people.v, people.mass))
    return q, v, mass


def _bound_mass(remnant: Remnant, name: str) -> float:
    if not (np.isfinite(remnant.mass) and remnant.mass >= 0):
        raise ComponentError(f"{name}: `renew` gave the bound mass {remnant.mass!r}, expected zero or more")
    return float(remnant.mass)


def _must_fit(satellite: Equilibrium, bound: float, r_tidal: float) -> None:
    """Refuse a progenitor that is no bound sphere in its tidal field at the look-back time."""
    kind, half = satellite.potential.kind, satellite.half_mass_radius
    if bound < (1 - UNBOUND) * satellite.mass:
        raise OutOfDomain(
            f"less than half of the progenitor {kind} is bound at the look-back time: its particles are faster than "
            "its escape speed, or too far away"
        )
    if half > r_tidal:
        raise OutOfDomain(
            f"the progenitor {kind} is larger than its tidal radius at the look-back time: half its mass lies beyond. "
            "Its mass and radius are those at the look-back time"
        )


class _Books:
    """The records of all particles, kept as `integrate` keeps them."""

    def __init__(self, track: Orbit, q: Array, v: Array, t: float, at_edges: Orbit) -> None:
        n = q.shape[1]
        self._q, self._v, self._now = q, v, t
        self._plane = orbital_plane(track)
        self._swept = np.unwrap(angle_in_plane(self._plane, track.q))
        self._planar = np.ascontiguousarray(self._plane @ q)
        angle = angle_in_plane(self._plane, q)
        lag = angle - self._swept[0]
        self._offset = lag - 2 * np.pi * np.round(lag / (2 * np.pi)) - angle + self._swept[0]
        self._revolutions = np.zeros(n)
        self._chi, self._gap, self._t_strip = np.zeros(n), np.zeros(n), np.full(n, t)
        self._dq, self._dv = q - at_edges.q[:, :1], v - at_edges.v[:, :1]

    def open(self, core: Array, r_tidal: float) -> None:
        """Begin: inside the tidal radius until shown to be outside."""
        away = np.sqrt(((self._q - core[:3, None]) ** 2).sum(axis=0)) - r_tidal
        self._gap[:] = np.minimum(away, 0.0)

    def write(self, t: float, core: Array, r_tidal: float) -> None:
        """Add what happened in the block that ends at t."""
        record_together(
            self._now, t, self._q, self._v, core, r_tidal, self._plane, self._revolutions, self._planar, self._chi,
            self._gap, self._t_strip, self._dq, self._dv,
        )  # fmt: skip
        self._now = t

    def close(self, remnant: Remnant) -> Records:
        """Return the records; bound is who the scheme says, or is inside the tidal radius."""
        turned = np.arctan2(self._planar[1], self._planar[0]) + 2 * np.pi * self._revolutions
        winding = self._offset + turned - self._swept[-1]
        bound = np.asarray(remnant.bound, dtype=bool) | (self._gap <= 0)
        return Records(self._q, self._v, self._t_strip, self._dq, self._dv, winding, self._chi, bound)
