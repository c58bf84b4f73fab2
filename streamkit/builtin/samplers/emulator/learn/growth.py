"""How the lack of fit grows with the distance from the middle of the calls: measured, and beyond the calls assumed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from streamkit import Array

# |x|^2 below this fraction of its mean over the calls has the lack of fit at this fraction: few calls are nearer to the
# middle.
INNERMOST = 0.5
# Fraction of the calls near the data beyond which the growth is assumed.
MEASURED = 0.95


@dataclass(frozen=True)
class Growth:
    """Factors of the lack of fit by |x|^2: one in the mean of the calls near the data, with those beyond ``far`` there.

    Attributes
    ----------
    typical, power
        The factor is proportional to (|x|^2 / typical)^power among the calls.
    far, guard
        |x|^2 beyond which few calls are, and the power beyond it.
    mean
        What all of this is divided by. What is assumed beyond has no part in it: few calls there would make the lack
        of fit of all others smaller.
    """

    typical: float
    power: float
    far: float
    guard: float
    mean: float = 1.0

    @classmethod
    def of(cls, r2: Array, excess: Array, guard: float) -> Growth:
        """Measure the growth at calls with |x|^2 (n,) near the data.

        ``excess`` (n,) is the squared residual minus the variance of the noise there, summed over the data. The power
        is that between the inner and the outer half of the calls, and `guard` at most.
        """
        outer = r2 > np.median(r2)
        inside, outside = (max(float(excess[half].mean()), 0.0) for half in (~outer, outer))
        apart = np.log(r2[outer].mean() / r2[~outer].mean()) if outer.any() and r2[~outer].any() else 0.0
        power = 0.0
        if outside > inside and apart > 0:
            power = min(float(np.log(outside / inside) / apart), guard) if inside > 0 else guard
        growth = cls(float(r2.mean()) or 1.0, power, float(np.quantile(r2, MEASURED)) or 1.0, guard)
        return replace(growth, mean=float(growth.at(np.minimum(r2, growth.far)).mean()))

    def at(self, r2: Array) -> Array:
        """(n,) Return the factors at |x|^2 (n,)."""
        among = np.maximum(np.minimum(r2, self.far) / self.typical, INNERMOST) ** self.power
        return np.asarray(among * np.maximum(r2 / self.far, 1.0) ** self.guard / self.mean)
