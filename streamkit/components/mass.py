"""The total mass of one potential: of a progenitor, or of a body."""

from __future__ import annotations

import numpy as np

from streamkit.components.potential import Potential
from streamkit.components.total import add_up
from streamkit.units import G

FAR = 1e5, 1e6  # radii in kpc far beyond every galaxy: what is missing of a mass that ends falls at least as 1/r there
ENDS = 3e-3  # most that such a mass grows between them


def total_mass(potential: Potential) -> float:
    """Return the total mass in Msun: the field ``mass``, or of what has none, by its force at great distances.

    NaN where there is no end to the mass. A field ``mass`` may be a scale mass, as that of an NFW halo.
    """
    unit = potential.parameters().get("mass")
    if unit is not None and unit.name == "Msun":
        return float(getattr(potential, "mass"))  # noqa: B009  a field of this class, not of all
    axes = np.concatenate([np.eye(3), -np.eye(3)], axis=1)
    with np.errstate(all="ignore"):
        near, far = (-(r**2) / G * (add_up("acceleration", [potential], r * axes) * axes).sum() / 6 for r in FAR)
        share = FAR[0] / (FAR[1] - FAR[0])  # of what is missing at the first that is missing at the second
        ended = far > 0 and abs(far - near) <= ENDS * far
    return float(far + share * (far - near)) if ended else float("nan")
