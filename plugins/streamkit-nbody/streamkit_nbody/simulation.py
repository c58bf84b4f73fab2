"""The simulation: a satellite set on its orbit, and a leapfrog that carries it from record to record."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from streamkit import GYR, Array, BoolArray, IntArray, Orbit, OutOfDomain, SpecError
from streamkit.components import along_axes
from streamkit.engine import Field
from streamkit.model import NODE, Host, Satellite
from streamkit.runfile import Spec, StreamInputs
from streamkit.stream import angle_in_plane, orbital_plane
from streamkit_nbody import sphere
from streamkit_nbody.binding import Remnant, remnant
from streamkit_nbody.gravity import Gravity
from streamkit_nbody.plan import Options, Plan, make_plan
from streamkit_nbody.state import State, Track


@dataclass(frozen=True)
class Simulation:
    """The constants of a run."""

    spec: Spec  # the run file: its potential, progenitor and seed are used
    inputs: StreamInputs  # the same, bound: free parameters are at the centre of their priors
    host: Host  # the galaxy in which the satellite is disrupted
    plan: Plan  # softening, step, records
    # The point-mass orbit in the host from the look-back time to today: the satellite is set on its first point.
    orbit: Orbit
    workers: int = 1  # threads of the tree; the result does not depend on their number

    @staticmethod
    def of(spec: Spec, options: Options, workers: int = 1) -> Simulation:
        """Prepare a run.

        Raises SpecError if the host has a force that depends on velocity, or a body flies past the stream. Raises
        OutOfDomain if the progenitor is no sphere of finite mass in isotropic equilibrium, or its orbit is not finite.
        """
        inputs = spec.bind()
        sphere.sample(1, inputs)  # refuses a progenitor that is no sphere in equilibrium, before the orbit is computed
        for name, potential in inputs.potentials.items():
            if potential.has_drag():
                raise SpecError(
                    f"{spec.source}: {potential.place or name}: {potential.kind!r} has a force that depends on "
                    "velocity, which this simulation does not know"
                )
        for name in inputs.flybys:
            raise SpecError(
                f"{spec.source}: body.{name}.encounter: the point that the body passes is known for a scheme that "
                "releases particles, and not for this simulation: give the body its place today"
            )
        host = Host(inputs.potentials, inputs.bodies)
        with np.errstate(all="ignore"):  # what is not finite is found on the next line
            orbit = host.until(-inputs.lookback * GYR).orbit(inputs.q, inputs.v, 0.0, -inputs.lookback * GYR, NODE)
        if not (np.isfinite(orbit.q).all() and np.isfinite(orbit.v).all()):
            raise OutOfDomain("the orbit of the progenitor is not finite")
        return Simulation(spec, inputs, host, make_plan(inputs, orbit, options), orbit, workers)

    @cached_property
    def gravity(self) -> Gravity:
        """The particles' own gravity."""
        plan = self.plan
        return Gravity(sphere.mass_of(self.inputs) / plan.particles, plan.softening, plan.theta, self.workers)

    @cached_property
    def plane(self) -> Array:
        """(2, 3) Basis of the orbital plane: that of the point-mass orbit today."""
        return orbital_plane(self.orbit)

    @cached_property
    def field(self) -> Field:
        """The host's force over the run."""
        return self.host.until(-self.plan.span)

    @cached_property
    def satellite(self) -> Satellite:
        """The progenitor before it loses mass: the source of the tidal radius, as of every stream model."""
        return Satellite(self.inputs.satellite, self.inputs.mass)

    @property
    def without_energy(self) -> tuple[str, ...]:
        """The kinds of the host's potentials that give no potential energy: with one, none is monitored."""
        return tuple(p.kind for p in self.host.potentials.values() if not p.has_energy())

    def start(self) -> State:
        """Return the satellite in equilibrium on the first point of the orbit."""
        n, inputs = self.plan.particles, self.inputs
        place, motion = self.orbit.q[:, 0], self.orbit.v[:, 0]
        q, v = sphere.sample(n, inputs)
        potential = self.gravity.potential(q)
        binding = -self.gravity.mass * float(0.5 * potential.sum() + 0.5 * (v * v).sum())
        q, v = np.ascontiguousarray(q + place[:, None]), np.ascontiguousarray(v + motion[:, None])
        a, potential = self._forces_and_potential(0.0, q)
        none = Track(np.empty(0), np.empty((3, 0)), np.empty((3, 0)), np.empty(0), np.empty(0), np.empty(0))
        whole = Remnant(np.ones(n, dtype=bool), place, motion)
        track = self._extended(none, 0.0, whole, self._energy(0.0, q, v, potential))
        around = angle_in_plane(self.plane, q) - angle_in_plane(self.plane, track.q)
        return State(
            q, v, a,
            bound=whole.bound,
            gap=_distance(q, place) - track.r_tidal[0],
            t_strip=np.zeros(n),
            dq_strip=q - place[:, None],
            dv_strip=v - motion[:, None],
            revolutions=-np.round(around / (2.0 * np.pi)).astype(np.int64),
            track=track,
            binding=binding,
        )  # fmt: skip

    def advance(self, state: State) -> State:
        """Return the state at the next record. Raises NotFinite if a particle is lost."""
        plan, q, v, a = self.plan, state.q.copy(), state.v.copy(), state.a
        begin, end = state.time, plan.time(state.record + 1)
        for k in range(1, plan.steps + 1):
            v += 0.5 * plan.step * a
            q += plan.step * v
            if k < plan.steps:
                now = begin + (end - begin) * k / plan.steps
                a = self.gravity.forces(q) + self.field.acceleration(self._epoch(now), q)
            else:
                a, potential = self._forces_and_potential(end, q)
            v += 0.5 * plan.step * a
        left = remnant(self.gravity, q, v, state.bound | (state.gap <= 0.0))
        left = self._ghost(state) if left is None else left
        track = self._extended(state.track, end, left, self._energy(end, q, v, potential))
        return self._recorded(state, q, v, a, left.bound, track)

    def _recorded(self, state: State, q: Array, v: Array, a: Array, bound: BoolArray, track: Track) -> State:
        """Bring the particles' records up to the last one of the track."""
        place, motion = track.q[:, -1:], track.v[:, -1:]
        gap = _distance(q, place[:, 0]) - track.r_tidal[-1]
        inside, leaving = gap <= 0.0, (gap > 0.0) & (state.gap <= 0.0)
        passed = np.divide(state.gap, state.gap - gap, out=np.zeros_like(gap), where=leaving)
        crossing = track.t[-2] + (track.t[-1] - track.t[-2]) * passed
        return State(
            q, v, a,
            bound=bound,
            gap=gap,
            t_strip=np.where(inside, track.t[-1], np.where(leaving, crossing, state.t_strip)),
            dq_strip=np.where(inside, q - place, state.dq_strip),
            dv_strip=np.where(inside, v - motion, state.dv_strip),
            revolutions=state.revolutions + _crossings(*(angle_in_plane(self.plane, x) for x in (state.q, q))),
            track=track,
            binding=state.binding,
        )  # fmt: skip

    def _ghost(self, state: State) -> Remnant:
        """Carry the place of a satellite that is gone along the host's orbit."""
        end = self.plan.time(state.record + 1)
        place, motion = state.track.q[:, -1].copy(), state.track.v[:, -1].copy()
        orbit = self.field.orbit(place, motion, self._epoch(state.time), self._epoch(end), NODE)
        return Remnant(np.zeros(self.plan.particles, dtype=bool), orbit.q[:, -1], orbit.v[:, -1])

    def _extended(self, track: Track, t: float, left: Remnant, energy: float) -> Track:
        mass = self.gravity.mass * float(left.bound.sum())
        now = np.array([self._epoch(t)])
        q, v = np.ascontiguousarray(left.q[:, None]), np.ascontiguousarray(left.v[:, None])
        here = Orbit(now, q, v, self.field.acceleration(now, q), np.full(1, np.nan))
        left_over = np.array([mass / self.inputs.mass])
        whole = self.satellite.tidal_radius(self.host.tidal_bracket(here))
        r_tidal = float(self.satellite.shrunk(whole, left_over)[0]) if mass else 0.0
        if np.isnan(r_tidal):
            r_tidal = float(track.r_tidal[-1] if len(track.t) else here.r[0])
        return track.and_then(t, left.q, left.v, mass, r_tidal, energy)

    def _epoch(self, t: float) -> float:
        """Turn a time since the start into the host's, which is 0 today."""
        return t - self.plan.span

    def _forces_and_potential(self, t: float, q: Array) -> tuple[Array, Array]:
        self_gravity, potential = self.gravity.forces_and_potential(q)
        return self_gravity + self.field.acceleration(self._epoch(t), q), potential

    def _energy(self, t: float, q: Array, v: Array, potentials: Array) -> float:
        """Return the total energy in Msun (km/s)^2, with the particles' own potential (n,); NaN if not known."""
        hosts = self.host.potentials.values()
        if self.without_energy or self.host.bodies or any(p.growth or p.in_time or p.drifts for p in hosts):
            return float("nan")
        times = np.full(q.shape[1], self._epoch(t))
        host = sum(along_axes("potential", p, q, times) for p in hosts)
        return self.gravity.mass * float((0.5 * (v * v).sum(axis=0) + 0.5 * potentials + host).sum())


def _distance(q: Array, place: Array) -> Array:
    return np.asarray(np.sqrt(((q - place[:, None]) ** 2).sum(axis=0)))


def _crossings(before: Array, after: Array) -> IntArray:
    """(n,) Revolutions, -1, 0 or 1, that complete a change of angle of less than half a turn."""
    return -np.round((after - before) / (2.0 * np.pi)).astype(np.int64)
