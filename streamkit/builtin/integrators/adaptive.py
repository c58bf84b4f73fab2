"""The default integrator: each particle has a step of its own."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

import streamkit as sk
from streamkit import engine  # loaded when it is used: it brings numba, and listing plugins need not wait for it

# A circular orbit turns by so many radians in a step, at most: a third of a revolution, where the leapfrog is unstable.
LARGEST_ETA = 2.0


class Adaptive(sk.Integrator):
    """Splitting whose step follows each particle's own dynamical time, by powers of two per block.

    Particles deep in the progenitor take many steps and escaped particles few, in batches of equal steps (Gibbons+ 2014
    use adaptive steps too). Where one step is enough for the whole block, Nystrom's fifth-order method takes one or two
    steps of 4 forces each. The step changes between blocks, so the method is not strictly symplectic. A particle
    crosses a thin disc in much less than a dynamical time; near its plane steps are short enough to resolve the
    crossing.
    """

    kind = "adaptive"
    reference = (
        "Omelyan+ 2002, Comput. Phys. Commun. 146, 188; Blanes & Moan 2002, J. Comput. Appl. Math. 142, 313; "
        "Hairer, Norsett & Wanner 1993, Solving Ordinary Differential Equations I, section II.14"
    )
    order = 4
    drag = True
    resolves_passages = True
    example: ClassVar[dict[str, Any]] = {"method": "rkn4", "eta": 0.3, "eta_progenitor": 0.2}

    method: Literal["pefrl", "rkn4"] = Field(
        default="rkn4", description="4 forces a step, or 6 and some thirty times as accurate for equal steps."
    )
    eta: sk.PositiveNumber = Field(
        default=0.4,
        le=LARGEST_ETA,
        description="Longest step in units of sqrt(distance/acceleration) about the Galactic centre.",
    )
    eta_progenitor: sk.PositiveNumber = Field(
        default=0.45,
        le=LARGEST_ETA,
        description="Longest step in units of sqrt(distance/acceleration) about the progenitor.",
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
