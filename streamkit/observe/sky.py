"""Streams on the sky."""

from __future__ import annotations

from typing import Any

import numpy as np

from streamkit.stream import Array


def sagittarius(ra: Any, dec: Any) -> tuple[Array, Array]:
    """Turn RA, Dec (degrees, any shape) into the Sagittarius stream frame of Belokurov+ 2014.

    Returns
    -------
    lambda_tilde, beta_tilde
        Degrees, of the same shape; longitude in (-180, 180], increasing along the Sgr motion. Left-handed.

    Notes
    -----
    Belokurov+ 2014, MNRAS 437, 116, appendix A. It equals diag(1, -1, -1) times the matrix of Law & Majewski
    2010: both longitude and latitude have the opposite sign there.
    """
    a, d = np.radians(np.asarray(ra, dtype=float)), np.radians(np.asarray(dec, dtype=float))
    x, y, z = np.cos(a) * np.cos(d), np.sin(a) * np.cos(d), np.sin(d)
    lon = np.arctan2(
        -0.93595354 * x - 0.31910658 * y + 0.14886895 * z, 0.21215555 * x - 0.84846291 * y - 0.48487186 * z
    )
    lat = np.arcsin(np.clip(0.28103559 * x - 0.42223415 * y + 0.86182209 * z, -1.0, 1.0))
    return np.degrees(lon), np.degrees(lat)
