"""The warnings of a preflight about numbers that change in time."""

from __future__ import annotations

from typing import Any

import numpy as np

from streamkit.fields import times_of
from streamkit.runfile import ModelInputs, Spec


def knot_warnings(spec: Spec, bound: ModelInputs) -> list[str]:
    """Return a warning for each free knot in time that acts at no time of a stream: its prior decides it alone."""
    begin = -max((inputs.lookback for inputs in bound.streams.values()), default=np.inf)
    warnings = []
    for name in spec.names:
        path, is_knot, number = name.partition(".values.")
        if not is_knot:
            continue
        table: Any = spec.document
        for key in path.split("."):
            table = table[int(key) if isinstance(table, list) else key]
        times, k = times_of(table), int(number)
        if k > 0 and times[k - 1] >= 0:
            warnings.append(f"{name} is its value at {times[k]:g} Gyr, which is to come: the past is negative.")
        elif k + 1 < len(times) and times[k + 1] <= begin:
            warnings.append(f"{name} is its value at {times[k]:g} Gyr, and the streams begin at {begin:g} Gyr.")
    return warnings
