"""A live progenitor: its particles are followed together, and each block of time ends with a new force of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamkit.components import BlockEdge, LiveStripping, Population, Remnant
from streamkit.engine import MovingForce, record_together
from streamkit.errors import ComponentError, OutOfDomain, blamed
from streamkit.model.equilibrium import Equilibrium
from streamkit.model.host import Host
from streamkit.model.progenitor import progenitor_track
from streamkit.model.records import Records, begin_records
from streamkit.runfile import StreamInputs
from streamkit.stream import LEADING, TRAILING, Array, IntArray, Orbit, read_only
from streamkit.units import GYR, G

MAX_STEPS = 20_000  # from the look-back time to today
ORBIT_STEP = 0.06  # longest step in units of the progenitor's distance over its speed
DEBRIS_STEP = 0.01  # longest time in Gyr between two kicks by the host: debris is elsewhere on the orbit
BLOCK_TURN = 0.4  # radians that the progenitor turns in a block at most
# A progenitor is refused if it has less than this fraction of its mass within so many dynamical times (a^3/GM)^(1/2).
DISSOLVED, DISSOLUTION_TIME = 0.01, 10.0
MAX_UNBOUND = 0.5  # fraction of the mass that may be unbound at the look-back time


def follow_live(
    inputs: StreamInputs, scheme: LiveStripping, host: Host, track: Orbit, points: Array, threads: int
) -> tuple[Orbit, Records, IntArray, Array]:
    """Follow the particles of a live progenitor along its track, from uniform random numbers (draws, n).

    Returns the track with the progenitor's remaining mass and its tidal radius; the records of the particles; the
    Lagrange point (n,) on whose side each particle is today; and the weight of each particle (n,).

    Raises OutOfDomain: If the progenitor is no equilibrium, does not fit into its tidal radius at the look-back time,
    or needs too many steps.
    Raises ComponentError: If the scheme fails.
    """
    satellite = Equilibrium(inputs.satellite)
    with np.errstate(all="ignore"):
        bracket = host.tidal_bracket(track)
    edges, steps, kicks = _blocks(scheme, satellite, track)
    at_edges = track.at(edges)
    states = np.ascontiguousarray(np.concatenate([at_edges.q, at_edges.v, at_edges.a]).T)
    with blamed(f"stripping {scheme.kind}"):
        population = scheme.populate(read_only(states[0].copy()), satellite, read_only(points))
    q, v, mass = _checked(population, f"stripping {scheme.kind}")
    brackets = np.interp(edges, track.t, bracket)

    def edge(k: int) -> BlockEdge:
        return BlockEdge(float(edges[0]), float(edges[k]), q, v, mass, states[k], brackets[k])

    remnant = _remnant_at(edge(0), scheme, satellite, None)
    mass_left = [remnant.mass]
    released = replace(track.at(edges[:1]), r_tidal=_tidal_radius(remnant.mass, brackets[:1]))
    _must_fit(satellite, remnant.mass, float(released.r_tidal[0]))
    plane, offset, swept, records = begin_records(track, released, q, v, float)
    field = replace(host.until(float(track.t[0])), threads=threads)
    moving = MovingForce(field, track)
    dynamical = np.sqrt(satellite.scale**3 / (G * satellite.mass))
    for k in range(1, len(edges)):
        moving.advance(remnant.force, q, v, edges[k - 1], edges[k], steps[k - 1], kicks[k - 1])
        remnant = _remnant_at(edge(k), scheme, satellite, remnant)
        mass_left.append(remnant.mass)
        if remnant.mass < DISSOLVED * mass_left[0] and edges[k] - edges[0] < DISSOLUTION_TIME * dynamical:
            raise OutOfDomain(
                f"the progenitor {inputs.satellite.kind} dissolves at once: within {DISSOLUTION_TIME:g} of its "
                f"dynamical times from the look-back time less than {DISSOLVED:.0%} of it remains bound. It is too "
                "large for its tidal radius"
            )
        r_tidal = float(_tidal_radius(remnant.mass, brackets[k]))
        record_together(edges[k - 1], edges[k], q, v, states[k], r_tidal, plane, records)

    turned = np.arctan2(records.planar[1], records.planar[0]) + 2 * np.pi * records.revolutions
    winding = offset + turned - swept
    # A particle is bound if the scheme says so, or if it is inside the tidal radius.
    bound = np.asarray(remnant.bound, dtype=bool) | (records.gap <= 0)
    done = Records(q, v, records.t_strip, records.dq_strip, records.dv_strip, winding, records.chi, bound)
    mass_then = np.interp(track.t, edges, mass_left)
    orbit = replace(track, r_tidal=_tidal_radius(mass_then, bracket), mass_left=mass_then / inputs.mass)
    return orbit, done, np.where(winding > 0, LEADING, TRAILING), population.weight


def live_track(inputs: StreamInputs, scheme: LiveStripping, host: Host, track: Orbit) -> Orbit:
    """Return the track of a live progenitor: from the look-back time, or from the apocentre that ``passages`` asks for.

    Raises OutOfDomain: If there are fewer passages within the look-back time.
    """
    if scheme.passages is None:
        return track
    pericentres, apocentres = track.pericentres(), track.apocentres()
    if len(pericentres) < scheme.passages:
        raise OutOfDomain("the look-back time has fewer pericentre passages than stripping.passages")
    before = apocentres[apocentres < pericentres[-scheme.passages]]
    if len(before) == 0:
        raise OutOfDomain("the look-back time does not reach the apocentre before the first of stripping.passages")
    return progenitor_track(host, replace(inputs, lookback=-float(before[-1]) / GYR))


def _blocks(scheme: LiveStripping, satellite: Equilibrium, track: Orbit) -> tuple[Array, list[int], list[int]]:
    """Return the edges of the blocks (k + 1,), and the least number of steps and of the host's kicks in each (k,)."""
    rate = np.maximum(1 / (scheme.longest_block * GYR), track.omega / BLOCK_TURN)
    blocks = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(track.t))])
    edges = np.interp(np.linspace(0.0, blocks[-1], max(int(np.ceil(blocks[-1])), 1) + 1), blocks, track.t)
    with blamed(f"stripping {scheme.kind}"):
        longest = min(scheme.step * GYR, scheme.longest_step(satellite, track))
    allowed = ORBIT_STEP * track.r / np.sqrt((track.v**2).sum(axis=0))
    pieces = np.maximum(np.searchsorted(track.t, edges[:-1], side="right") - 1, 0)
    spans = np.diff(edges)
    kicks = np.ceil(spans / np.minimum(np.minimum.reduceat(allowed, pieces), DEBRIS_STEP * GYR) - 1e-9)
    steps = np.ceil(spans / longest - 1e-9)
    if not np.maximum(steps, kicks).sum() <= MAX_STEPS:
        raise OutOfDomain(
            f"the progenitor takes more than {MAX_STEPS} time steps with the stripping {scheme.kind}: it is too "
            "dense, or passes too near the Galactic centre"
        )
    return edges, steps.astype(int).tolist(), kicks.astype(int).tolist()


def _checked(population: Population, name: str) -> tuple[Array, Array, Array]:
    """Return copies of positions, velocities (3, n) and masses (n,); ComponentError for other shapes or numbers."""
    n = len(population.mass)
    for what, values, shape in (
        ("q", population.q, (3, n)), ("v", population.v, (3, n)),
        ("mass", population.mass, (n,)), ("weight", population.weight, (n,)),
    ):  # fmt: skip
        if np.shape(values) != shape:
            raise ComponentError(f"{name}: `populate` gave {what} of the shape {np.shape(values)}, expected {shape}")
        if not np.isfinite(values).all():
            raise ComponentError(f"{name}: `populate` gave {what} with numbers that are not finite")
    q, v, mass = (np.array(x, dtype=float, order="C") for x in (population.q, population.v, population.mass))
    return q, v, mass


def _must_fit(satellite: Equilibrium, bound: float, r_tidal: float) -> None:
    """Refuse a progenitor that is no bound sphere in its tidal field at the look-back time."""
    kind, half = satellite.potential.kind, satellite.half_mass_radius
    if bound < (1 - MAX_UNBOUND) * satellite.mass:
        raise OutOfDomain(
            f"less than half of the progenitor {kind} is bound at the look-back time: its particles are faster than "
            "its escape speed, or too far away"
        )
    if half > r_tidal:
        raise OutOfDomain(
            f"the progenitor {kind} is larger than its tidal radius at the look-back time: half its mass is outside. "
            "Its mass and radius are those at the look-back time"
        )


def _remnant_at(
    edge: BlockEdge, scheme: LiveStripping, satellite: Equilibrium, previous: Remnant | None
) -> Remnant:
    """Return what is left of the progenitor at an edge, by the scheme; ComponentError for a mass that is not valid."""
    name = f"stripping {scheme.kind}"
    with blamed(name):
        remnant = scheme.update_remnant(edge, satellite, previous)
    if not (np.isfinite(remnant.mass) and remnant.mass >= 0):
        raise ComponentError(f"{name}: `update_remnant` gave the bound mass {remnant.mass!r}, expected zero or more")
    return replace(remnant, mass=float(remnant.mass))


def _tidal_radius(mass: float | Array, bracket: float | Array) -> Array:
    return np.asarray(np.cbrt(G * mass / bracket))
