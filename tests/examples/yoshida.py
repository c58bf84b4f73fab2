import math

import numpy as np
from pydantic import Field

from streamkit import GYR, Duration, Integrator, hookimpl
from streamkit.engine import Splitting, split_step

W1 = 1 / (2 - 2 ** (1 / 3))
W0 = 1 - 2 * W1
YOSHIDA = Splitting(np.array([W1, W0 + W1, W0 + W1, W1]) / 2, np.array([W1, W0, W1]), 4)


class Yoshida(Integrator):
    """Yoshida's fourth-order composition of three leapfrogs, with a fixed step."""

    kind = "yoshida"
    reference = "Yoshida 1990, Phys. Lett. A 150, 262"
    order = 4
    drag = True
    step: Duration = Field(default=0.002, description="Longest step.")

    def advance(self, field, q, v, t0, t1):
        """Advance q, v (3, n) in place from times t0 (n,) to t1."""
        if len(t0):
            steps = math.ceil((t1 - float(t0.min())) / (self.step * GYR) - 1e-9)
            split_step(field, YOSHIDA, q, v, t0, t1, max(steps, 1))


@hookimpl
def streamkit_components():
    return [Yoshida]
