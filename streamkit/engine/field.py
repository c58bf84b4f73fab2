"""The total acceleration field: the sum of forces centred on the origin or on moving bodies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from streamkit.engine import kernels, loops, orbits
from streamkit.engine.arguments import layout_of, pack
from streamkit.engine.carried import beside, carried
from streamkit.engine.changing import numbers_of, tables_of
from streamkit.engine.drag_kernels import drag_kernel
from streamkit.engine.forces import BATCH, DEEPEST, NO_FRAME, NO_TRACKS, Forces
from streamkit.engine.kernels import Force, NumpyKernel
from streamkit.engine.loops import NUMBERS, WORK, Scratch
from streamkit.engine.methods import RKN4, Splitting
from streamkit.engine.motion import STILL
from streamkit.engine.passing import NOBODY, Nobody, Passing
from streamkit.engine.single_orbit import orbit_states
from streamkit.engine.steps import Method
from streamkit.engine.velocity_forces import DraggedForces, drags, with_drag
from streamkit.errors import ComponentError, OutOfDomain, message_of
from streamkit.stream import Array, Orbit

FARTHEST = 300.0  # radius in kpc that holds the mass of a body
SHARES = 4  # slices of many particles for each thread


def _scratch() -> Scratch:
    """Return doubles that begin at a cache line, so that no vector straddles two, and integers."""
    raw = np.empty(WORK + 8)
    first = -raw.ctypes.data % 64 // raw.itemsize
    return Scratch(raw[first : first + WORK], np.empty(NUMBERS, dtype=np.int64))


NO_DRAG_OF_BODIES = "the force of what moves may not depend on velocity"


class Drag(NamedTuple):
    """The forces that depend on velocity: the address of a kernel, and its packed parameters."""

    address: int
    parameters: Array


@dataclass(frozen=True)
class Field:
    """The total acceleration, for integrators. It is local to its process and cannot be pickled.

    Attributes
    ----------
    forces
        Addresses, parameters and trajectories, in the form of the loops.
    kernels
        (c,) the kernels; the references keep the machine code alive.
    names
        (c,) names of the components, for messages.
    scratch
        Work space of the loops: a field advances one set of particles at a time.
    heights
        (n,) heights in kpc of the disc of the forces fixed at the origin (`disc_heights`); empty without a disc.
    threads
        Largest number of threads of `adaptive_step` and `split_step` for many particles. The result does not depend on
        it.
    drag
        The forces that depend on velocity; None without any.
    passing
        The bodies that fly past particles, whose forces are not among these forces.
    """

    forces: Forces
    kernels: tuple[Any, ...]
    names: tuple[str, ...]
    scratch: Scratch = field(default_factory=_scratch, repr=False)
    heights: Array = field(default_factory=lambda: np.empty(0), repr=False)
    threads: int = 1
    drag: Drag | None = None
    passing: Passing | Nobody = NOBODY

    def __reduce__(self) -> Any:
        raise TypeError("a Field holds machine code of this process: send the Spec instead and build it there")

    def acceleration(self, t: Array | float, q: Array, v: Array | None = None) -> Array:
        """(3, n) acceleration in (km/s)^2/kpc at positions q (3, n) and times t (n,) or one time.

        It includes the forces that depend on velocity only if velocities v (3, n) are given.
        """
        q = np.require(q, float, ["C", "W"])  # the loops take no read-only arrays
        times = np.broadcast_to(np.asarray(t, dtype=float), q.shape[1:]).copy()
        out = np.empty_like(q)
        self._call(lambda: loops.accelerations(self._together, times, q, out))
        if v is not None and self.drag is not None:
            v = np.require(v, float, ["C", "W"])
            dragged = with_drag(self.forces, *self.drag)
            self._call(lambda: drags(dragged, times, q, v, out))
        return out

    @cached_property
    def all_forces(self) -> Forces | DraggedForces:
        """All forces, in the form for the loops that advance particles."""
        return self._dragged(self._together)

    @cached_property
    def own_forces(self) -> Forces | DraggedForces:
        """All forces but those of bodies that fly by, in the same form."""
        return self._dragged(self.forces)

    @cached_property
    def _together(self) -> Forces:
        return self.forces if isinstance(self.passing, Nobody) else beside(self.forces, self.passing.forces)

    def _dragged(self, forces: Forces) -> Forces | DraggedForces:
        return forces if self.drag is None else with_drag(forces, *self.drag)

    def radial_second_derivative(self, t: Array, q: Array) -> Array:
        """(n,) d^2 Phi / dr^2 along the line to the Galactic centre, by a central difference of the acceleration."""
        r = np.sqrt((q**2).sum(axis=0))
        unit = q / r
        h = 1e-4 * r
        outer = (self.acceleration(t, q + h * unit) * unit).sum(axis=0)
        inner = (self.acceleration(t, q - h * unit) * unit).sum(axis=0)
        return np.asarray(-(outer - inner) / (2 * h))

    def orbit(self, q: Array, v: Array, t0: float, t1: float, max_step: float) -> Orbit:
        """Integrate one orbit from t0 to t1 (either direction), with nodes at most ``max_step`` apart."""
        count = max(int(np.ceil(abs(t1 - t0) / max_step)), 2)
        step = (t1 - t0) / count
        t: Array = t0 + step * np.arange(count + 1, dtype=float)
        t[-1] = t1
        q, v = (np.require(x, float, ["C", "W"]) for x in (q, v))
        if self._in_python:
            states = orbit_states(self.acceleration, q, v, t)
        else:
            out = np.empty((count + 1, 9))
            method = Method(RKN4.drift, RKN4.kick, np.zeros(2), 1, np.empty(0))
            self.run(orbits.integrate_orbit, method, q, v, t0, step, out)
            states = out.T
        if step < 0:
            t, states = t[::-1], states[:, ::-1]
        states = np.ascontiguousarray(states)
        return Orbit(np.ascontiguousarray(t), states[:3], states[3:6], states[6:], np.full(count + 1, np.nan))

    def orbits(self, times: Array, q: Array, v: Array, grid: Array) -> list[Orbit]:
        """Integrate n orbits through q, v (3, n) at their own times (n,), both ways: their states on a grid of times.

        The grid (T,) increases and includes all times.
        """
        if self._in_python:
            return [self._both_ways(*one, grid) for one in zip(times, q.T, v.T, strict=True)]
        method = Method(RKN4.drift, RKN4.kick, np.zeros(2), 1, np.empty(0))
        states, out = np.concatenate([q, v]).T, np.empty((len(times), 9, len(grid)))
        for way in (1, -1):
            order = np.argsort(way * times, kind="stable")
            for some in np.array_split(order, len(order) // BATCH + 1):
                part = np.empty((len(some), len(grid), 9))
                self.run(orbits.integrate_orbits, method, times[some], states[some], grid[::way].copy(), part)
                for i, reached in zip(some, part[:, ::way], strict=True):
                    there = way * (grid - times[i]) >= 0
                    out[i][:, there] = reached[there].T
        return [Orbit(grid, x[:3], x[3:6], x[6:], np.full(len(grid), np.nan)) for x in out]

    def _both_ways(self, time: float, q: Array, v: Array, grid: Array) -> Orbit:
        step = float(np.diff(grid).max())
        past, future = (self.orbit(q, v, time, float(end), step) for end in (grid[0], grid[-1]))
        both = ("t", "q", "v", "a", "r_tidal")
        joined = {k: np.concatenate([getattr(past, k)[..., :-1], getattr(future, k)], axis=-1) for k in both}
        return Orbit(**joined).at(grid)

    def with_passing(self, bodies: Sequence[tuple[Field, Orbit, float]]) -> Field:
        """Add bodies that fly past particles: the field of each, its orbit, and its size in kpc, which is positive.

        The orbits must share the grid of times of all that moves. `adaptive_step` takes steps that resolve the passage
        of such a body, and evaluates its force as often as the passage asks for. Raises ValueError as `with_moving`.
        """
        for other, orbit, _ in bodies:
            self._grid_with(orbit)
            _fixed(other)
        passing = Passing(
            forces=carried([(other.forces, orbit) for other, orbit, _ in bodies]),
            sizes=np.array([size for _, _, size in bodies]),
            strengths=np.array([_strength(other, float(orbit.t[0]), size) for other, orbit, size in bodies]),
            first=np.cumsum([0, *(len(other.forces.address) for other, _, _ in bodies)]),
        )
        kernels, names = (sum((getattr(b[0], k) for b in bodies), getattr(self, k)) for k in ("kernels", "names"))
        return replace(self, passing=passing, kernels=kernels, names=names)

    def with_moving(self, other: Field, orbit: Orbit) -> Field:
        """Add another field's forces, whose common centre moves along ``orbit`` (equal time steps).

        Call it once for each moving body. All orbits must share one grid of times, and one body may lose mass. Raises
        ValueError otherwise, and if the forces of the other field move already.
        """
        self._grid_with(orbit)
        _fixed(other)
        here, forces = self.forces, beside(self.forces, carried([(other.forces, orbit)]))
        if len(here.tracks) and (orbit.mass_left != 1.0).any():  # it must be the first: see `add_forces`
            if (here.tracks[0, :, 18] != 1.0).any():
                raise ValueError("only one of the moving components can lose mass")
            moves, count = forces.trajectory >= 0, len(forces.tracks)
            trajectory = np.where(moves, (forces.trajectory + 1) % count, forces.trajectory)
            forces = forces._replace(trajectory=trajectory, tracks=np.roll(forces.tracks, 1, axis=0))
        kernels, names = self.kernels + other.kernels, self.names + other.names
        return replace(self, forces=forces, kernels=kernels, names=names)

    def seen_from(self, orbit: Orbit) -> Field:
        """Return the field in a frame whose origin moves along ``orbit``: its acceleration is subtracted.

        The orbit must have the grid of times of the moving components.
        """
        from scipy.interpolate import CubicSpline  # slow to import, and only hosts that move need it

        first, step = self._grid_with(orbit)
        cubics = CubicSpline(np.arange(len(orbit.t)), orbit.a, axis=1).c[::-1]
        frame = np.ascontiguousarray(cubics.transpose(1, 0, 2).reshape(-1, 12))
        return replace(self, forces=self.forces._replace(first=first, step=step, frame=frame))

    def _grid_with(self, orbit: Orbit) -> tuple[float, float]:
        """Return first time and step of an orbit's grid; ValueError if the moving components have another one."""
        first, here, count = float(orbit.t[0]), self.forces, len(orbit.t) - 1
        step = float((orbit.t[-1] - first) / count)
        count_here = here.tracks.shape[1] if len(here.tracks) else len(here.frame)
        if count_here and (first, step, count) != (here.first, here.step, count_here):
            raise ValueError("orbits of moving components must share one grid of times")
        return first, step

    def pieces(self, n: int) -> list[slice]:
        """Return slices of n particles for the threads: one if they are few, or if a force runs in Python.

        Particles that were released late take up to twice as long as early ones, so that each thread gets several of
        many particles.
        """
        count = 1 if self._in_python else min(self.threads, n // BATCH)
        if count <= 1:  # a fit calls this thousands of times a second
            return [slice(0, n)]
        if n // BATCH >= SHARES * self.threads:
            count = SHARES * self.threads
        edges = np.linspace(0, n, count + 1).astype(int).tolist()
        return [slice(*ends) for ends in pairwise(edges)]

    def spread(self, n: int, loop: Callable[[slice, Scratch], None]) -> None:
        """Call a loop with a slice of n particles and scratch: once, or for each slice in some thread; then `check`.

        The loop must release the lock of the interpreter.
        """
        pieces = self.pieces(n)
        if len(pieces) == 1:
            self._call(lambda: loop(pieces[0], self.scratch))
            return

        unused = list(self.scratch_per_thread)

        def one(piece: slice) -> None:
            scratch = unused.pop()  # there is one for each thread
            loop(piece, scratch)
            unused.append(scratch)

        with ThreadPoolExecutor(min(self.threads, len(pieces))) as pool:
            list(pool.map(one, reversed(pieces)))  # those that take longest come first

    @cached_property
    def scratch_per_thread(self) -> list[Scratch]:
        """The scratch of each thread."""
        return [self.scratch, *(_scratch() for _ in range(self.threads - 1))]

    @cached_property
    def _in_python(self) -> tuple[NumpyKernel, ...]:
        return tuple(kernel for kernel in self.kernels if isinstance(kernel, NumpyKernel))

    def run(self, loop: Callable[..., None], *arguments: Any) -> None:
        """Call one of the compiled loops that advance particles, with these forces; then `check` for exceptions."""
        self._call(lambda: loop(self.all_forces, *arguments))

    def _call(self, call: Callable[[], None]) -> None:
        if not self._in_python:
            call()
            return
        for kernel in self._in_python:
            kernel.error = None
        with self._in_python[0].catching_exceptions():
            call()
        self.check()

    def check(self) -> None:
        """Raise an exception that a force in Python raised inside a loop.

        KeyboardInterrupt and OutOfDomain are raised unchanged. Others become a `ComponentError` with the name and the
        parameters of the force. So does SystemExit: it would end the process without a message, with an exit status
        that the force chose.
        """
        errors = [(i, getattr(kernel, "error", None)) for i, kernel in enumerate(self.kernels)]
        failed = [(i, error) for i, error in errors if error is not None]
        for kernel in self._in_python:
            kernel.error = None
        for _, error in failed:
            if isinstance(error, KeyboardInterrupt):
                raise error
        for i, error in failed:
            if isinstance(error, OutOfDomain):
                raise error
            raise ComponentError(
                f"potential {self.names[i]} raised {type(error).__name__}: {message_of(error)} "
                f"(parameters {self.kernels[i].shown_arguments})"
            ) from error


def _strength(body: Field, t: float, size: float) -> float:
    """Return G times the mass of a body in kpc (km/s)^2: the largest inside some radii."""
    r = size * (FARTHEST / size) ** np.linspace(0.0, 1.0, 8)  # a geomspace, which takes as long as all the rest
    ax, ay, az = body.acceleration(t, r * np.full((3, 1), 3**-0.5))
    return float(np.sqrt(((ax * ax + ay * ay + az * az) * r**4).max()))


def _fixed(other: Field) -> None:
    """Raise ValueError if the forces of a field cannot be those of a body."""
    if other.drag is not None:
        raise ValueError(NO_DRAG_OF_BODIES)
    if len(other.forces.tracks) or len(other.forces.frame):
        raise ValueError("these forces move already: add the forces of each trajectory by themselves")


def build_field(potentials: Sequence[Force], *, exact: bool = False) -> Field:
    """Compile (or load from the disk cache) the forces of the potentials, which add up, fixed at the origin.

    A potential with an expansion is replaced by it. With ``exact`` it is not, and it is as it is today, at the origin
    with axes that are not turned.
    """
    built, packed = list[Any](), list[Array]()
    for p in potentials:
        force, rotation, changes = (p, None, ()) if exact else (p.in_loop(), p.rotation(), p.changes())
        motion = STILL if exact else p.motion()
        if force.compiled:
            values = force.in_engine_units() + (rotation or ()) + tables_of(changes) + motion.tables
            given = numbers_of(changes), rotation is not None, motion.moves
            built.append(kernels.compiled_kernel(type(force), layout_of(values), *given))
            packed.append(pack(values))
        else:
            built.append(NumpyKernel(force, changes, rotation, motion))
            packed.append(np.zeros(0))
    forces = Forces(
        address=np.array([k.address for k in built], dtype=np.int64),
        offset=np.cumsum([0, *map(len, packed)]).astype(np.int64),
        trajectory=np.full(len(built), -1),
        parameters=np.concatenate([*packed, np.zeros(1)]),  # never empty: its address is passed on
        first=0.0,
        step=1.0,
        tracks=NO_TRACKS,
        frame=NO_FRAME,
    )
    names = [p.kind for p in potentials]
    dragging = [] if exact else [p for p in potentials if p.has_drag()]
    if not dragging:
        return Field(forces, kernels=tuple(built), names=tuple(names))
    kernel, parameters = drag_kernel(dragging)
    drag = Drag(kernel.address, parameters)
    kinds = ", ".join(p.kind for p in dragging)
    return Field(forces, kernels=(*built, kernel), names=(*names, kinds), drag=drag)


def adaptive_step(
    field: Field, splitting: Splitting, q: Array, v: Array, t0: Array, t1: float, eta: Array, deepest: int
) -> None:
    """Advance q, v (3, n), in place, each particle with the power of two of steps that its dynamical time asks for.

    No step is longer than ``eta`` (2,) times sqrt(distance / acceleration), about the Galactic centre and about the
    progenitor, or than it takes to cross a disc, but a block takes at most ``2**deepest`` of them.
    """
    _advance(field, splitting, q, v, t0, t1, eta, min(deepest, DEEPEST))


def split_step(field: Field, splitting: Splitting, q: Array, v: Array, t0: Array, t1: float, steps: int) -> None:
    """Advance q, v (3, n), in place, from their own times t0 (n,) to t1 in equal steps."""
    _advance(field, splitting, q, v, t0, t1, np.zeros(2), steps)


def _advance(
    field: Field, splitting: Splitting, q: Array, v: Array, t0: Array, t1: float, eta: Array, most: int
) -> None:
    """Advance the rows of q and v in place. The loops need contiguous rows: others are copied, and copied back."""
    callers_rows = [*q, *v]
    rows = tuple(np.ascontiguousarray(row) for row in callers_rows)
    method = Method(splitting.drift, splitting.kick, eta, most, field.heights)
    n, adapts = len(t0), eta[0] > 0
    forces, passing = (field.own_forces, field.passing) if adapts else (field.all_forces, NOBODY)

    def advance(piece: slice, scratch: Scratch) -> None:
        everything = piece == slice(0, n)  # a fit comes here thousands of times a second
        parts, times = (rows, t0) if everything else (tuple(row[piece] for row in rows), t0[piece])
        loops.advance(forces, passing, method, scratch, parts, times, t1)

    field.spread(n, advance)
    for row, advanced in zip(callers_rows, rows, strict=True):
        if advanced is not row:
            row[:] = advanced
