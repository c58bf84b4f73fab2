"""Frames: from the sky to Galactocentric axes, and the Sagittarius stream's own frame."""

from __future__ import annotations

import functools
import math
from typing import Literal

import numpy as np

from streamkit.stream.arrays import Array
from streamkit.units import KMS_PER_MASYR_KPC

Sky = Literal["icrs", "galactic"]

CENTRE_ICRS = (266.4051, -28.936175)
"""RA, Dec of the Galactic centre in degrees: Reid & Brunthaler 2004, ApJ 616, 872 (astropy's default too)."""


@functools.cache
def axes(sky: Sky) -> Array:
    """(3, 3) Rotation from heliocentric axes to Galactocentric ones for a Sun in the plane, from astropy.

    The position and velocity of the Sun do not enter, so a free ``sun.r0`` costs no astropy call either.
    """
    from astropy import coordinates as c  # slow to import
    from astropy import units as u

    ra, dec = CENTRE_ICRS
    target = c.Galactocentric(
        galcen_coord=c.ICRS(ra * u.deg, dec * u.deg), galcen_distance=8.0 * u.kpc, z_sun=0.0 * u.pc,
        roll=0.0 * u.deg, galcen_v_sun=c.CartesianDifferential([0.0, 0.0, 0.0] * u.km / u.s),
    )  # fmt: skip
    points = np.hstack([np.zeros((3, 1)), np.eye(3)]) * u.kpc
    frame = c.ICRS if sky == "icrs" else c.Galactic
    seen = frame(c.CartesianRepresentation(points)).transform_to(target).cartesian.xyz.to_value(u.kpc)
    return np.asarray(seen[:, 1:] - seen[:, :1])


def sun_tilt(r0: float, z: float) -> Array:
    """(3, 3) Rotation about y that lifts the Sun from (-r0, 0, 0) to height z, as astropy does."""
    s = z / r0
    c = math.sqrt(1.0 - s * s)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def to_galactocentric(
    sky: Sky,
    lon: float,
    lat: float,
    distance: float,
    pm_lon_cos_lat: float,
    pm_lat: float,
    v_los: float,
    r0: float,
    z: float,
    v_sun: Array,
) -> tuple[Array, Array]:
    """Transform one object from the sky.

    Parameters
    ----------
    sky
        Frame of the coordinates and of the proper motions.
    lon, lat
        Degrees.
    distance, pm_lon_cos_lat, pm_lat, v_los
        kpc, mas/yr, mas/yr, km/s; heliocentric.
    r0, z
        Distance of the Sun from the Galactic centre and its height above the plane, kpc.
    v_sun
        (3,) Galactocentric velocity of the Sun, km/s.

    Returns
    -------
    q, v
        (3,) Galactocentric position in kpc and velocity in km/s; the Sun is at (-r0, 0, 0) if z = 0.
    """
    a, d = math.radians(lon), math.radians(lat)
    ca, sa, cd, sd = math.cos(a), math.sin(a), math.cos(d), math.sin(d)
    east, north = (KMS_PER_MASYR_KPC * distance * pm for pm in (pm_lon_cos_lat, pm_lat))
    place = distance * np.array([ca * cd, sa * cd, sd])
    motion = np.array(
        [
            v_los * ca * cd - east * sa - north * ca * sd,
            v_los * sa * cd + east * ca - north * sa * sd,
            v_los * sd + north * cd,
        ]
    )
    tilt = sun_tilt(r0, z)
    turn = tilt @ axes(sky)
    return turn @ place + tilt @ np.array([-r0, 0.0, 0.0]), turn @ motion + v_sun
