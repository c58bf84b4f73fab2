"""What the other factors say of the host, as a Gaussian."""

from __future__ import annotations

import numpy as np

from streamkit import Array
from streamkit.builtin.samplers.emulator.walk.density import Factor

# Factor by which the covariance of the posterior is widened.
WIDER = 2.0


def tilt(factor: Factor, samples: Array, z: Array) -> Array:
    """(n,) What samples (..., d) of all factors' posterior say of hosts: ln of a Gaussian at coordinates z of a factor.

    A stream in tension with the others is learned where the joint posterior is, and not where it alone would be. The
    Gaussian is that of the shared coordinates, wider by `WIDER` in variance; z (n, p) are the factor's own coordinates
    with the shared ones. Nothing is said of a factor without shared coordinates.
    """
    shared = factor.shared
    if not len(shared):
        return np.zeros(len(z))
    h = samples[..., shared].reshape(-1, len(shared))
    covariance = WIDER * np.atleast_2d(np.cov(h.T))
    covariance[np.diag_indices(len(shared))] *= 1 + 1e-9
    hosts = z[:, np.isin(factor.columns, shared)]
    white = np.linalg.solve(np.linalg.cholesky(covariance), (hosts - h.mean(axis=0)).T)
    return np.asarray(-0.5 * np.sum(white**2, axis=0))
