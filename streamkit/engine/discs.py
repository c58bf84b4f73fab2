"""The heights of a host's disc: a thin disc is crossed in less than a dynamical time, which limits the steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamkit.engine.field import Field
from streamkit.errors import ComponentError, OutOfDomain
from streamkit.stream import Array

# Radii in kpc of the heights: each is twice the one before, which `streamkit.engine.levels` relies on.
RADII = 2.0 ** np.arange(9)
AZIMUTHS = np.radians([0.0, 90.0])  # a bar is thin in one direction
STEPS = 12  # trial heights at each radius: the radius divided by powers of two
# A host whose height exceeds this fraction of the radius has no disc there. For a sphere the trial heights give 1/2.
THIN = 0.3


def with_disc(field: Field) -> Field:
    """Return the field with the heights of its disc, so that `adaptive_step` takes short steps where it is crossed."""
    heights = disc_heights(field)
    return replace(field, heights=heights) if len(heights) else field


def disc_heights(field: Field) -> Array:
    """(9,) Heights in kpc of the disc of a field at rest, at R = 1, 2, 4, ... 256 kpc; (0,) if it has none.

    The height is where the pull to the plane, divided by z, has fallen to half of that at the plane.
    """
    shape = len(AZIMUTHS), len(RADII), STEPS
    r = np.broadcast_to(RADII[:, None], shape)
    z = r * 0.5 ** np.arange(STEPS)  # falling
    angle = AZIMUTHS[:, None, None]
    q = np.stack([r * np.cos(angle), r * np.sin(angle), z])
    q = np.concatenate([q, q * [[[[1.0]]], [[[1.0]]], [[[-1.0]]]]], axis=1)  # both sides: a frame may accelerate
    with np.errstate(all="ignore"):
        try:
            above, below = field.acceleration(0.0, q.reshape(3, -1))[2].reshape(2, *shape)
            pull = 0.5 * (below - above) / z
        except (ComponentError, OutOfDomain):  # raised again if a particle goes where there is no force
            return np.empty(0)
        share = pull / pull[..., -1:]  # of that next to the plane
        index = np.argmax(share > 0.5, axis=-1)  # the greatest height that has more than half
    heights = np.take_along_axis(z, index[..., None], axis=-1)[..., 0]
    heights = np.where((index > 0) & np.isfinite(share).all(axis=-1), heights, np.inf).min(axis=0)
    thin = heights <= THIN * RADII
    return np.where(thin, heights, np.inf) if thin.any() else np.empty(0)
