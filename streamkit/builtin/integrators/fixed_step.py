"""Built-in integrators, all through the same compiled field with the moving progenitor."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

import streamkit as sk
from streamkit import engine  # loaded when it is used: it brings numba, and listing plugins need not wait for it


def _fixed(
    method: engine.Splitting, step: float, field: engine.Field, q: sk.Array, v: sk.Array, t0: sk.Array, t1: float
) -> None:
    """Take equal steps of at most ``step`` Gyr. Particles released inside the block take fewer."""
    counts = np.maximum(np.ceil((t1 - t0) / (step * sk.GYR) - 1e-9), 1).astype(int)
    edges = [0, *(np.flatnonzero(np.diff(counts)) + 1), len(t0)]
    for begin, end in pairwise(edges):
        if end > begin:
            part = slice(begin, end)
            engine.split_step(field, method, q[:, part], v[:, part], t0[part], t1, int(counts[begin]))


class Leapfrog(sk.Integrator):
    """Drift-kick-drift leapfrog with a fixed step: symplectic, second order."""

    kind = "leapfrog"
    order = 2
    drag = True

    step: sk.Duration = Field(default=0.001, description="Longest step.")

    def advance(self, field: engine.Field, q: sk.Array, v: sk.Array, t0: sk.Array, t1: float) -> None:
        """Advance in place."""
        _fixed(engine.LEAPFROG, self.step, field, q, v, t0, t1)


class ForestRuth(sk.Integrator):
    """Position-extended Forest-Ruth-like method (PEFRL) with a fixed step: symplectic, fourth order."""

    kind = "pefrl"
    reference = "Omelyan, Mryglod & Folk 2002, Comput. Phys. Commun. 146, 188"
    order = 4
    drag = True

    step: sk.Duration = Field(default=0.004, description="Longest step.")

    def advance(self, field: engine.Field, q: sk.Array, v: sk.Array, t0: sk.Array, t1: float) -> None:
        """Advance in place."""
        _fixed(engine.PEFRL, self.step, field, q, v, t0, t1)


class Adaptive(sk.Integrator):
    """Splitting whose step follows each particle's own dynamical time, by powers of two per block.

    Particles deep in the progenitor take many steps, escaped ones few, in batches of equal steps (Gibbons+ 2014 use
    adaptive steps too). Where one step is enough for the whole block, Nystrom's fifth-order method takes one or two
    steps of 4 forces each. The step changes between blocks, so the method is not strictly symplectic. Near the plane of
    a thin disc, which is crossed in much less than a dynamical time, steps are short enough to resolve it.
    """

    kind = "adaptive"
    reference = (
        "Omelyan+ 2002, Comput. Phys. Commun. 146, 188; Blanes & Moan 2002, J. Comput. Appl. Math. 142, 313; "
        "Hairer, Norsett & Wanner 1993, Solving Ordinary Differential Equations I, section II.14"
    )
    order = 4
    drag = True
    example: ClassVar[dict[str, Any]] = {"method": "rkn4", "eta": 0.3, "eta_progenitor": 0.2}

    method: Literal["pefrl", "rkn4"] = Field(
        default="rkn4", description="4 forces a step, or 6 and some thirty times as accurate for equal steps."
    )
    eta: sk.PositiveNumber = Field(
        default=0.4, description="Longest step in units of sqrt(distance/acceleration) about the Galactic centre."
    )
    eta_progenitor: sk.PositiveNumber = Field(
        default=0.45, description="Longest step in units of sqrt(distance/acceleration) about the progenitor."
    )
    deepest: int = Field(default=7, ge=0, le=20, description="A block takes at most 2 to this power steps.")

    def steps(self, duration: float) -> dict[str, float]:
        """Return the steps where a dynamical time is as long as a block; there are no more than the deepest level's."""
        etas = {"eta": self.eta, "eta_progenitor": self.eta_progenitor}
        return {name: duration / self.longest_block * min(2.0**self.deepest, 1 / eta) for name, eta in etas.items()}

    def advance(self, field: engine.Field, q: sk.Array, v: sk.Array, t0: sk.Array, t1: float) -> None:
        """Advance in place."""
        if len(t0):
            eta = np.array([self.eta, self.eta_progenitor])
            engine.adaptive_step(
                field, engine.PEFRL if self.method == "pefrl" else engine.RKN4, q, v, t0, t1, eta, self.deepest
            )


class Reference(sk.Integrator):
    """SciPy's DOP853 on all particles together: slow, adaptive, for checking the others."""

    kind = "dop853"
    reference = "Hairer, Norsett & Wanner 1993, Solving Ordinary Differential Equations I"
    order = 8
    drag = True

    rtol: sk.PositiveNumber = Field(default=1e-10, description="Relative tolerance.")
    atol: sk.PositiveNumber = Field(default=1e-10, description="Absolute tolerance, in kpc and km/s.")

    def advance(self, field: engine.Field, q: sk.Array, v: sk.Array, t0: sk.Array, t1: float) -> None:
        """Advance in place. Each particle's time runs linearly with a common s from 0 to 1."""
        from scipy.integrate import solve_ivp

        n = q.shape[1]
        if n == 0:
            return
        span = t1 - t0

        def rates(s: float, w: sk.Array) -> sk.Array:
            state = w.reshape(6, n)
            a = field.acceleration(t0 + s * span, state[:3], state[3:])
            return np.concatenate([state[3:] * span, a * span]).ravel()

        start = np.concatenate([q, v]).ravel()
        done = solve_ivp(rates, (0.0, 1.0), start, method="DOP853", rtol=self.rtol, atol=self.atol)
        state = done.y[:, -1].reshape(6, n)
        q[:], v[:] = state[:3], state[3:]
