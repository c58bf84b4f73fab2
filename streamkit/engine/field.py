"""The total acceleration field: the addresses of the forces, their parameters and the moving progenitor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from streamkit.engine import kernels, loops
from streamkit.engine.forces import DEEPEST
from streamkit.engine.kernels import Force
from streamkit.engine.methods import RKN4, Splitting
from streamkit.errors import ComponentError
from streamkit.stream import Array, BoolArray, IntArray, Orbit


@dataclass(frozen=True)
class Field:
    """The total acceleration: what an integrator needs and nothing more. Local to its process, never pickled.

    Attributes
    ----------
    address
        (c,) addresses of the compiled forces.
    offset
        (c + 1,) where each force's parameters start in ``parameters``.
    follows
        (c,) True for the forces centred on the progenitor.
    parameters
        Packed parameters in engine units.
    first, step, track
        The progenitor's path (T, 20) from ``first + k * step`` on: the six coefficients of `Orbit.polynomials`, and the
        fraction of its mass that is left, with its change to the next, by which the forces that follow it are
        multiplied. Unused without a follower.
    work, numbers
        Scratch of the loops: a field advances one set of particles at a time.
    kernels
        Keeps the machine code alive.
    names
        (c,) names of the components, for messages.
    """

    address: IntArray
    offset: IntArray
    follows: BoolArray
    parameters: Array
    first: float
    step: float
    track: Array
    work: Array
    numbers: IntArray
    kernels: tuple[Any, ...]
    names: tuple[str, ...]

    def __reduce__(self) -> Any:
        raise TypeError("a Field holds machine code of this process: send the Spec instead and build it there")

    @property
    def _head(self) -> tuple[Any, ...]:
        return self.address, self.offset, self.follows, self.parameters, self.first, self.step, self.track

    def acceleration(self, t: Array | float, q: Array) -> Array:
        """(3, n) acceleration in (km/s)^2/kpc at positions q (3, n) and times t (n,) or one time."""
        q = np.ascontiguousarray(q, dtype=float)
        times = np.broadcast_to(np.asarray(t, dtype=float), q.shape[1:]).copy()
        out = np.empty_like(q)
        loops.accelerations(*self._head, times, q, out)
        self.check()
        return out

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
        out = np.empty((count + 1, 9))
        head = (self.address, self.offset, self.follows, self.parameters)
        loops.carry(*head, q, v, t0, step, RKN4.drift, RKN4.kick, out)
        self.check()
        t = t0 + step * np.arange(count + 1)
        t[-1] = t1
        if step < 0:
            t, out = t[::-1], out[::-1]
        states = np.ascontiguousarray(out.T)
        return Orbit(np.ascontiguousarray(t), states[:3], states[3:6], states[6:], np.full(count + 1, np.nan))

    def with_moving(self, other: Field, orbit: Orbit) -> Field:
        """Add another field's forces, centred on the progenitor that moves along ``orbit`` (equal time steps)."""
        left = orbit.mass_left
        return replace(
            self,
            address=np.concatenate([self.address, other.address]),
            offset=np.concatenate([self.offset, self.offset[-1] + other.offset[1:]]),
            follows=np.concatenate([self.follows, np.ones_like(other.follows)]),
            parameters=np.concatenate([self.parameters[: self.offset[-1]], other.parameters]),
            first=float(orbit.t[0]),
            step=float((orbit.t[-1] - orbit.t[0]) / (len(orbit.t) - 1)),
            track=np.vstack([orbit.polynomials.reshape(18, -1), left[:-1], np.diff(left)]).T.copy(),
            kernels=self.kernels + other.kernels,
            names=self.names + other.names,
        )

    def check(self) -> None:
        """Raise what a force written in Python raised inside the loop.

        Raises
        ------
        ComponentError
            Naming the component and its parameters.
        """
        for i, (kernel, name) in enumerate(zip(self.kernels, self.names, strict=True)):
            error = getattr(kernel, "error", None)
            if error is not None:
                kernel.error = None
                values = self.parameters[self.offset[i] : self.offset[i + 1]]
                raise ComponentError(
                    f"potential {name} raised {type(error).__name__}: {error} (parameters {values.tolist()})"
                ) from error


def build_field(potentials: Sequence[Force]) -> Field:
    """Compile (or load from the disk cache) the forces of the potentials, which add up, fixed at the origin."""
    built = [kernels.compiled_kernel(type(p)) if p.compiled else kernels.numpy_kernel(type(p)) for p in potentials]
    values = [p.in_engine_units() for p in potentials]
    return Field(
        address=np.array([k.address for k in built], dtype=np.int64),
        offset=np.cumsum([0, *map(len, values)]).astype(np.int64),
        follows=np.zeros(len(built), dtype=bool),
        parameters=np.concatenate([*values, np.zeros(1)]),  # never empty: its address is passed on
        first=0.0,
        step=1.0,
        track=np.zeros((1, 20)),
        work=_aligned(loops.WORK),
        numbers=np.empty(loops.NUMBERS, dtype=np.int64),
        kernels=tuple(built),
        names=tuple(p.kind for p in potentials),
    )


def _aligned(n: int) -> Array:
    """(n,) Doubles that begin at a cache line, so that no vector straddles two."""
    raw = np.empty(n + 8)
    first = -raw.ctypes.data % 64 // raw.itemsize
    return raw[first : first + n]


def adaptive_step(
    field: Field, splitting: Splitting, q: Array, v: Array, t0: Array, t1: float, eta: Array, deepest: int
) -> None:
    """Advance q, v (3, n), in place, each particle with the power of two of steps that its dynamical time asks for.

    No step is longer than ``eta`` (2,) times sqrt(distance / acceleration), about the Galactic centre and about the
    progenitor, but a block takes at most ``2**deepest`` of them.
    """
    _advance(field, splitting, q, v, t0, t1, eta, min(deepest, DEEPEST))


def split_step(field: Field, splitting: Splitting, q: Array, v: Array, t0: Array, t1: float, steps: int) -> None:
    """Advance q, v (3, n), in place, from their own times t0 (n,) to t1 in equal steps."""
    _advance(field, splitting, q, v, t0, t1, np.zeros(2), steps)


def _advance(
    field: Field, splitting: Splitting, q: Array, v: Array, t0: Array, t1: float, eta: Array, most: int
) -> None:
    """Pass the rows of q and v, which the loops want contiguous, in place where they are."""
    given = [*q, *v]
    rows = [np.ascontiguousarray(row) for row in given]
    method = splitting.drift, splitting.kick, eta, most
    loops.advance(*field._head, *rows, t0, t1, *method, field.work, field.numbers)
    for row, done in zip(given, rows, strict=True):
        if done is not row:
            row[:] = done
