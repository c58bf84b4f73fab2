"""Between the sky and Galactocentric axes."""

from __future__ import annotations

import functools
import math
from typing import Literal, NamedTuple

import numpy as np

from streamkit.renamed import Renamed
from streamkit.stream.arrays import Array
from streamkit.stream.observer import GIBBONS14, Observer
from streamkit.units import KMS_PER_MASYR_KPC

Sky = Literal["icrs", "galactic"]

# RA, Dec of the Galactic centre in degrees: Reid & Brunthaler 2004, ApJ 616, 872 (astropy's default too).
CENTRE_ICRS = (266.4051, -28.936175)


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


def to_galactocentric(
    sky: Sky | Array,
    lon: float,
    lat: float,
    distance: float,
    pm_lon_cos_lat: float,
    pm_lat: float,
    v_los: float,
    sun: Observer,
) -> tuple[Array, Array]:
    """Return Galactocentric position (3,) in kpc and velocity (3,) in km/s of one object on the sky.

    Its heliocentric angles are in degrees, its distance in kpc, motions in mas/yr and km/s. ``sky`` is the frame of
    angles and proper motions: a name, or the matrix (3, 3) that leads to it from ICRS.
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
    turn = sun.tilt @ (axes(sky) if isinstance(sky, str) else axes("icrs") @ sky.T)
    return turn @ place + sun.q, turn @ motion + sun.v


def place_on_sky(phi1: Array, phi2: Array, distance: Array, matrix: Array, sun: Observer = GIBBONS14) -> Array:
    """(3, n) Galactocentric positions in kpc of angles (n,) in degrees and distances (n,) in kpc.

    The matrix (3, 3) leads from ICRS to the frame of the angles, as `sky_matrix` gives it.
    """
    a, d = np.radians(phi1), np.radians(phi2)
    place = distance * np.array([np.cos(a) * np.cos(d), np.sin(a) * np.cos(d), np.sin(d)])
    return np.asarray(sun.tilt @ axes("icrs") @ matrix.T @ place + sun.q[:, None])


class Seen(NamedTuple):
    """Particles on the sky, heliocentric, in one frame; (n,) each.

    Attributes
    ----------
    lon, lat
        Longitude in (-180, 180] and latitude in degrees: RA and Dec in ICRS, phi1 and phi2 in a stream's own frame.
    distance
        kpc.
    pm_lon_coslat, pm_lat
        Proper motions, mas/yr.
    radial_velocity
        Heliocentric, km/s.
    radial_velocity_gsr
        The same in the Galactic standard of rest: the Galactocentric velocity along the line of sight from the Sun.
    """

    lon: Array
    lat: Array
    distance: Array
    pm_lon_coslat: Array
    pm_lat: Array
    radial_velocity: Array
    radial_velocity_gsr: Array


# Former names, from the frame of a stream: plugins of contract 1 may use them.
for _former, _name in (("phi1", "lon"), ("phi2", "lat"), ("pm_phi1_cosphi2", "pm_lon_coslat"), ("pm_phi2", "pm_lat")):
    setattr(Seen, _former, Renamed(_former, _name))


def seen_from(sun: Observer, q: Array, v: Array, matrix: Array) -> Seen:
    """Return particles at Galactocentric q (3, n) in kpc, v (3, n) in km/s as the Sun sees them.

    The matrix (3, 3) leads from ICRS to the frame of the angles, as `sky_matrix` gives it.
    """
    turn = matrix @ (sun.tilt @ axes("icrs")).T
    x, y, z = turn @ (q - sun.q[:, None])
    u, v_y, w = turn @ (v - sun.v[:, None])
    flat2 = x * x + y * y
    flat, distance = np.sqrt(flat2), np.sqrt(flat2 + z * z)
    with np.errstate(divide="ignore", invalid="ignore"):  # a particle at the Sun, or at a pole
        along = (x * u + y * v_y) / flat
        v_r = (flat * along + z * w) / distance
        per_kpc = 1.0 / (KMS_PER_MASYR_KPC * distance)
        pm_lon = (x * v_y - y * u) / flat * per_kpc
        pm_lat = (flat * w - z * along) / distance * per_kpc
        gsr = v_r + (turn @ sun.v) @ np.stack([x, y, z]) / distance
    lon, lat = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, flat))
    return Seen(lon, lat, distance, pm_lon, pm_lat, v_r, gsr)
