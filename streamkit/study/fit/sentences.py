"""Numbers and lists as text in verdicts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def number(value: float, form: str, unit: str = "") -> str:
    """Return a number in a format, with its unit; "unknown" for NaN and infinity."""
    return f"{value:{form}}{unit}" if np.isfinite(value) else "unknown"


def listed(names: Sequence[str], most: int = 4) -> str:
    """Return "a, b and c", and how many more there are."""
    if len(names) > most + 1:
        return f"{', '.join(names[:most])} and {len(names) - most} more"
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)
