"""Splitting methods: compositions of drifts and kicks, as coefficients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit.stream import Array


@dataclass(frozen=True)
class Splitting:
    """A composition method: fractions of the step drifted (s + 1) and kicked (s) in turn."""

    drift: Array
    kick: Array
    order: int


LEAPFROG = Splitting(np.array([0.5, 0.5]), np.array([1.0]), 2)

_XI, _LAMBDA, _CHI = 0.1786178958448091, -0.2123418310626054, -0.6626458266981849e-1
# Position-extended Forest-Ruth-like method, Omelyan, Mryglod & Folk 2002, Comput. Phys. Commun. 146, 188, eq. 22.
PEFRL = Splitting(
    np.array([_XI, _CHI, 1 - 2 * (_CHI + _XI), _CHI, _XI]),
    np.array([(1 - 2 * _LAMBDA) / 2, _LAMBDA, _LAMBDA, (1 - 2 * _LAMBDA) / 2]),
    4,
)


def _symmetric(kick: list[float], drift: list[float], order: int) -> Splitting:
    """A method that kicks first, from the first half of its coefficients; the middle one completes the sum."""
    if len(kick) == len(drift):  # the middle one is a kick: b1 a1 ... bs as | 1 - 2 sum b | as bs ... a1 b1
        drift = [*drift[:-1], 0.5 - sum(drift[:-1])]
        kicks = [*kick, 1 - 2 * sum(kick), *kick[::-1]]
        drifts = [*drift, *drift[::-1]]
    else:  # the middle one is a drift
        kick = [*kick[:-1], 0.5 - sum(kick[:-1])]
        kicks = [*kick, *kick[::-1]]
        drifts = [*drift, 1 - 2 * sum(drift), *drift[::-1]]
    return Splitting(np.array([0.0, *drifts, 0.0]), np.array(kicks), order)


# Runge-Kutta-Nystroem splitting SRKN_6^b of Blanes & Moan 2002, J. Comput. Appl. Math. 142, 313, table 3.
RKN4 = _symmetric(
    [0.0829844064174052, 0.396309801498368, -0.0390563049223486], [0.245298957184271, 0.604872665711080, 0.0], 4
)
