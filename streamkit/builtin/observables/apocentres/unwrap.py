"""Unwrapping by the phase chi of Gibbons, Belokurov & Evans 2014, for comparison with the winding."""

from __future__ import annotations

import numpy as np

from streamkit import Array, BoolArray

WINDOW = 101  # particles in the running circular mean


def unwrap_by_phase(angle: Array, chi: Array, bound: BoolArray) -> Array:
    """Return angles (n,) in degrees unwrapped along chi, positive where chi < 0 (leading).

    Only the angle on the sky, ``angle`` modulo 360 degrees, is used. Within each arm the particles are sorted by
    |chi|, along which the angle grows approximately; a running circular mean, unwrapped outwards from the
    progenitor, says which turn each particle is on.
    """
    out = np.zeros_like(angle)
    for arm in (1.0, -1.0):
        member = np.flatnonzero(~bound & (arm * chi < 0))
        if len(member) == 0:
            continue
        member = member[np.argsort(np.abs(chi[member]), kind="stable")]
        turn = np.exp(1j * np.radians(arm * angle[member]))
        kernel = np.ones(min(WINDOW, len(member)))
        mean = np.unwrap(np.angle(np.convolve(turn, kernel, mode="same")))
        mean -= 2 * np.pi * np.floor(mean[0] / (2 * np.pi) + 0.5)  # the innermost debris is near the progenitor
        sky = np.angle(turn)
        out[member] = arm * np.degrees(sky + 2 * np.pi * np.round((mean - sky) / (2 * np.pi)))
    return out
