"""The warnings of a preflight about numbers that change in time."""

from __future__ import annotations

import numpy as np

from streamkit.runfile import ModelInputs, Spec


def knot_warnings(spec: Spec, bound: ModelInputs) -> list[str]:
    """Return a warning for each free knot in time that is beyond the times of all streams, with its neighbour.

    Such a knot acts by the slope at its neighbour at most.
    """
    begin = -max((inputs.lookback for inputs in bound.streams.values()), default=np.inf)
    warnings = []
    for section in spec.sections.all:
        for field, knots in section.knots.items():
            times, paths = knots.centre.times, knots.paths(field)
            for k in knots.priors:
                what = f"{section.path}.{paths[k]} is its value at {times[k]:g} Gyr"
                if k > 0 and times[k - 1] >= 0:
                    warnings.append(f"{what}, which is to come: the past is negative.")
                elif k + 1 < len(times) and times[k + 1] <= begin:
                    warnings.append(f"{what}, and the streams begin at {begin:g} Gyr.")
    return warnings
