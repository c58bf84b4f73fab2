"""Remarks on the data of a track: longitudes without debris, and longitudes that are likely in radians."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

import streamkit as sk
from streamkit.builtin.observables.track.lines import is_gap, warning_of_gaps

Given = Mapping[str, tuple[sk.Array, sk.Array, sk.Array]]
FEW = 3  # longitudes between which debris is counted, at least
FAR = 0.6  # share of the debris that may be elsewhere without a remark
SHORT = 0.1  # of the range of the other data: data over a shorter one may be in radians
ALIKE = 0.3  # of that range, which they cover at least if they are


def remarks_of(given: Given, rows: Mapping[str, sk.IntArray], coverage: sk.Array, kernel: float) -> tuple[str, ...]:
    """Return the remarks on data, (phi1, value, error) by column.

    ``rows`` are those of a column in ``coverage``, ln of the chance of debris at each datum; ``kernel`` is in degrees.
    """
    empty = {name: np.unique(part[0][is_gap(coverage[rows[name]])]) for name, part in given.items()}
    gaps = (
        warning_of_gaps(f"{name}: {len(phi1)} of its longitudes", phi1, kernel)
        for name, phi1 in empty.items()
        if len(phi1)
    )
    return (*in_radians(given), *gaps)


def remark_of_debris(near: float, places: int) -> tuple[str, ...]:
    """Return a remark if too little of the debris is between so many longitudes of the data."""
    if near >= 1 - FAR or places < FEW:
        return ()
    return (
        "Most of the debris is beyond the longitudes of the data: most particles cost time and tell nothing. If the "
        "age of the stream may be chosen, a shorter progenitor.lookback leaves less noise, in less time.",
    )


def in_radians(given: Given) -> list[str]:
    """Return a remark on each column whose longitudes, taken as radians, run over the degrees of the other columns."""
    found = []
    for name, (phi1, _, _) in given.items():
        others = [other for each, (other, _, _) in given.items() if each != name]
        if not others or np.abs(phi1).max() > np.pi:
            continue
        rest = np.concatenate(others)
        low, high, length = rest.min(), rest.max(), np.ptp(rest)
        turned = np.degrees(phi1)
        inside = (turned > low - SHORT * length) & (turned < high + SHORT * length)
        if np.ptp(phi1) < SHORT * length and np.ptp(turned) > ALIKE * length and inside.all():
            found.append(
                f"{name}: its phi1 runs from {phi1.min():.3g} to {phi1.max():.3g} deg, that of the other data from "
                f'{low:.3g} to {high:.3g} deg. Is it in radians? Then its unit is phi1 = "rad".'
            )
    return found
