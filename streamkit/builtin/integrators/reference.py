"""The reference integrator, which checks the others."""

from __future__ import annotations

import numpy as np
from pydantic import Field

import streamkit as sk
from streamkit import engine  # loaded when it is used: it brings numba, and listing plugins need not wait for it


class Reference(sk.Integrator):
    """SciPy's DOP853 on all particles together: slow, adaptive, for checking the others."""

    kind = "dop853"
    reference = "Hairer, Norsett & Wanner 1993, Solving Ordinary Differential Equations I"
    order = 8
    drag = True

    rtol: sk.PositiveNumber = Field(default=1e-10, le=1e-3, description="Relative tolerance.")
    atol: sk.PositiveNumber = Field(default=1e-10, le=0.1, description="Absolute tolerance, in kpc and km/s.")

    def advance(self, field: engine.Field, q: sk.Array, v: sk.Array, t0: sk.Array, t1: float) -> None:
        """Advance in place; to NaN if a force is not finite. Each particle's time runs linearly in s from 0 to 1."""
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
        state = np.full((6, n), np.nan)
        if np.isfinite(rates(0.0, start)).all():  # from such a rate SciPy never ends
            done = solve_ivp(rates, (0.0, 1.0), start, method="DOP853", rtol=self.rtol, atol=self.atol)
            if done.success:  # else the last state is that of another time
                state = done.y[:, -1].reshape(6, n)
        q[:], v[:] = state[:3], state[3:]
