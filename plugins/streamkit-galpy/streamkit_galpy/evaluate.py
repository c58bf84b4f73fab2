"""Evaluate a galpy potential at Cartesian positions in kpc, through arrays where it takes them."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

# Times in kpc/(km/s) between which a potential is tested for changes: a rotating one changes between any two.
TIMES = np.linspace(-11.93, 5.81, 12)
AXIS = 1e-12  # smallest cylindrical radius in ro: on the axis galpy's torque over radius is 0/0


@dataclass(frozen=True)
class Evaluator:
    """A galpy potential in kpc and km/s."""

    source: Any  # A potential, or a sum of potentials, of galpy's
    # The scales ro in kpc and vo in km/s.
    ro: float
    vo: float
    arrays: bool = True  # whether it takes arrays of positions
    static: bool = True  # whether it is static

    @classmethod
    def of(cls, source: Any, ro: float, vo: float) -> Evaluator:
        """Find out how the potential can be evaluated."""
        one = cls(source, ro, vo, arrays=False, static=False)
        q = np.array([[7.0, 1.5, -20.0], [2.0, 1.0, 9.0], [1.0, -0.7, 13.0]])
        single = one.acceleration(*q, 0.0)
        try:
            arrays = np.allclose(cls(source, ro, vo).acceleration(*q, 0.0), single, rtol=1e-9, atol=0, equal_nan=True)
        except Exception:  # whatever galpy raises for arrays: then it is called with numbers
            arrays = False
        x, y, z = q[:, 0]
        now = one.acceleration(x, y, z, 0.0)
        static = all(np.array_equal(one.acceleration(x, y, z, t), now) for t in TIMES)
        return cls(source, ro, vo, bool(arrays), static)

    def acceleration(self, x: Any, y: Any, z: Any, t: Any) -> Any:
        """Return (ax, ay, az) in (km/s)^2/kpc at positions in kpc and times in kpc/(km/s), numbers or (n,)."""
        from galpy.potential import evaluatephitorques, evaluateRforces, evaluatezforces

        radius = np.maximum(np.sqrt(x * x + y * y) / self.ro, AXIS)
        height, phi = z / self.ro, np.arctan2(y, x)
        outward, around, up = (
            self._all(force, radius, height, phi, t) for force in (evaluateRforces, evaluatephitorques, evaluatezforces)
        )
        scale, c, s = self.vo**2 / self.ro, np.cos(phi), np.sin(phi)
        around = around / radius
        return scale * (c * outward - s * around), scale * (s * outward + c * around), scale * up

    def potential(self, x: Any, y: Any, z: Any, t: Any) -> Any:
        """Return the potential in (km/s)^2."""
        from galpy.potential import evaluatePotentials

        radius = np.maximum(np.sqrt(x * x + y * y) / self.ro, AXIS)
        return self.vo**2 * self._all(evaluatePotentials, radius, z / self.ro, np.arctan2(y, x), t)

    def _all(self, function: Callable[..., Any], radius: Any, height: Any, phi: Any, t: Any) -> Any:
        """Return a function of galpy's everywhere: one call for each time, or for each position."""

        def at(r: Any, z: Any, angle: Any, time: float) -> Any:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")  # of galpy's own arithmetic; what is not finite, the engine sees
                return function(self.source, r, z, phi=angle, t=time * self.vo / self.ro, use_physical=False)

        if np.ndim(radius) == 0 or (self.arrays and (self.static or np.ndim(t) == 0)):
            return at(radius, height, phi, 0.0 if self.static else float(t)) + np.zeros(np.shape(radius))
        if not self.arrays:
            places = np.broadcast_arrays(radius, height, phi, 0.0 if self.static else t)
            return np.array([at(*(float(v) for v in place)) for place in zip(*places, strict=True)])
        values = np.empty(np.shape(radius))
        for time in np.unique(t):
            now = t == time
            values[now] = at(radius[now], height[now], phi[now], float(time))
        return values
