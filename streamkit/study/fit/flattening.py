"""The flattening of the potential at places of the host, for the samples of a run."""

from __future__ import annotations

import numpy as np

from streamkit.model import Host
from streamkit.runfile import Spec
from streamkit.stream import Array
from streamkit.study.fit.results import Results

MOST = 300  # samples that the flattening is computed for


def flattening_at(spec: Spec, theta: Array, radii: Array, z: Array) -> Array:
    """(k,) `Host.flattening` at parameters (d,), at cylindrical radii and heights (k,) in kpc."""
    return Host(spec.host(theta)).flattening(radii, z)


def flattenings(results: Results, radii: Array, z: Array) -> Array:
    """(n, k) The same for at most `MOST` samples of a run, evenly spaced."""
    chosen = np.linspace(0, len(results.samples) - 1, min(len(results.samples), MOST)).astype(int)
    return np.array([flattening_at(results.spec, theta, radii, z) for theta in results.samples[chosen]])
