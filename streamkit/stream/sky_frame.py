"""A frame on the sky as an object: made in five ways, and to and from ICRS with proper motions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from streamkit.stream.arrays import Array, freeze
from streamkit.stream.sky_coord import stream_frame
from streamkit.stream.sky_frames import Frame, on_sphere, place_of, sky_matrix

if TYPE_CHECKING:
    from astropy.coordinates import BaseCoordinateFrame

LONGER = 2.0  # smallest ratio of the scatter of stars along a great circle to their scatter across it


class InFrame(NamedTuple):
    """Places in the frame of a stream, (n,) each: degrees with phi1 in (-180, 180], and mas/yr."""

    phi1: Array
    phi2: Array
    pm_phi1_cosphi2: Array
    pm_phi2: Array


class InICRS(NamedTuple):
    """Places in ICRS, (n,) each: degrees with ra in [0, 360), and mas/yr."""

    ra: Array
    dec: Array
    pm_ra_cosdec: Array
    pm_dec: Array


@dataclass(frozen=True, eq=False)
class SkyFrame:
    """A frame of heliocentric angles phi1 and phi2; made by `sky_frame`.

    All functions with a frame accept it: ``stream.seen(frame)``, ``stream.track(frame)``.

    Attributes
    ----------
    matrix
        (3, 3) rotation from ICRS. Its determinant is -1 for a left-handed frame. Read-only.
    """

    matrix: Array

    def __post_init__(self) -> None:
        freeze(self)

    def __array__(self, dtype: Any = None, copy: Any = None) -> Array:
        """Return the matrix."""
        return np.array(self.matrix, dtype=dtype)

    def __repr__(self) -> str:
        pole, origin = (f"({ra:.6f}, {dec:.6f})" for ra, dec in (self.pole, self.origin))
        hand = "" if self.right_handed else ", left-handed"
        return f"<SkyFrame: pole {pole}, origin {origin}{hand}>"

    @property
    def right_handed(self) -> bool:
        """Whether phi1 grows to the left as seen from inside with the pole upwards, as ra does."""
        return bool(np.linalg.det(self.matrix) > 0)

    @property
    def pole(self) -> tuple[float, float]:
        """(ra, dec) of phi2 = 90, degrees."""
        return place_of(self.matrix[2])

    @property
    def origin(self) -> tuple[float, float]:
        """(ra, dec) of phi1 = phi2 = 0, degrees."""
        return place_of(self.matrix[0])

    def to_toml(self) -> str:
        """Return the line of a run file: ``frame = { pole = [ra, dec], origin = [ra, dec] }``, or three rows."""
        if self.right_handed:
            pole, origin = (f"[{ra:.8f}, {dec:.8f}]" for ra, dec in (self.pole, self.origin))
            return f"frame = {{ pole = {pole}, origin = {origin} }}"
        return f"frame = [{', '.join(f'[{x:.12f}, {y:.12f}, {z:.12f}]' for x, y, z in self.matrix.tolist())}]"

    def to_astropy(self) -> BaseCoordinateFrame:
        """Return the frame for astropy: ``SkyCoord(...).transform_to(frame.to_astropy())`` has phi1 and phi2."""
        return stream_frame()(matrix=tuple(tuple(row) for row in self.matrix.tolist()))

    def from_icrs(self, ra: Any, dec: Any, pm_ra_cosdec: Any = None, pm_dec: Any = None) -> InFrame:
        """Return places in this frame.

        Parameters
        ----------
        ra, dec
            (n,) or numbers, degrees, or astropy quantities.
        pm_ra_cosdec, pm_dec
            (n,) or numbers, mas/yr, or quantities; without them the proper motions are NaN.

        Raises ValueError for arrays of different shapes, and for a dec beyond 90 deg.
        """
        return InFrame(*_turned(self.matrix, (ra, dec), (pm_ra_cosdec, pm_dec)))

    def to_icrs(self, phi1: Any, phi2: Any, pm_phi1_cosphi2: Any = None, pm_phi2: Any = None) -> InICRS:
        """Return places of this frame in ICRS; arguments as in `from_icrs`."""
        ra, *others = _turned(self.matrix.T, (phi1, phi2), (pm_phi1_cosphi2, pm_phi2))
        return InICRS(ra % 360.0, *others)

    def turn(self, ra: Any, dec: Any) -> Array:
        """(n, 2, 2) Rotations of proper motions: (pm_phi1_cosphi2, pm_phi2) = turn @ (pm_ra_cosdec, pm_dec).

        The covariance C (n, 2, 2) of the proper motions becomes ``turn @ C @ turn.swapaxes(1, 2)``.
        """
        _, *here = on_sphere(*_angles(ra, dec))
        _, *there = on_sphere(*_angles(*self.from_icrs(ra, dec)[:2]))
        return np.asarray(np.einsum("ain,ij,bjn->nab", np.array(there), self.matrix, np.array(here)))


def sky_frame(
    frame: Frame | SkyFrame = None,
    *,
    pole: Sequence[float] | None = None,
    origin: Sequence[float] | None = None,
    ends: Sequence[Sequence[float]] | None = None,
    stars: Any = None,
) -> SkyFrame:
    """Return a frame on the sky, made in one of five ways.

    Parameters
    ----------
    frame
        The name of a published frame, or a matrix (3, 3) from ICRS, or the mapping of a run file.
    pole, origin
        (ra, dec) in degrees: of phi2 = 90, and of phi1 = phi2 = 0. An origin that is less than 10 deg off the great
        circle of the pole is moved onto it.
    ends
        Two points (ra, dec) in degrees on the great circle phi2 = 0; phi1 grows from the first to the second along the
        shorter arc. It is zero in the middle between them, or at `origin`.
    stars
        (ra, dec), arrays (n,) in degrees, or a SkyCoord: phi2 = 0 is the great circle with the least squares of the
        stars' distances from it, and the pole is the northern one. phi1 is zero in the middle of the stars, or at
        `origin`.

    Raises ValueError for an unknown name (the message has the nearest one), for a value that is no frame, for an origin
    far off the great circle, and for stars that do not lie along a great circle.
    """
    ways = {"frame": frame, "pole": pole, "ends": ends, "stars": stars}
    given = [name for name, value in ways.items() if value is not None]
    if len(given) != 1:
        raise ValueError(f"expected one of frame, pole, ends and stars; found {' and '.join(given) or 'none'}")
    if frame is not None and origin is not None:
        raise ValueError("a frame by its name or matrix has an origin of its own; leave out origin")
    if isinstance(frame, SkyFrame):
        return frame
    if stars is not None:
        ra, dec = _of_stars(stars)
        pole, middle = _circle_of(ra, dec)
        origin = middle if origin is None else origin
    by_name: Mapping[str, Any] = {"pole": pole, "ends": ends, "origin": origin}
    written = frame if frame is not None else {name: value for name, value in by_name.items() if value is not None}
    return SkyFrame(sky_matrix(written))


def _of_stars(stars: Any) -> tuple[Array, Array]:
    if hasattr(stars, "transform_to"):
        stars = (stars.icrs.ra, stars.icrs.dec)
    try:
        ra, dec = (np.atleast_1d(np.asarray(_plain(each, "deg"), dtype=float)) for each in stars)
    except (TypeError, ValueError):
        raise ValueError("expected stars = (ra, dec), two arrays in degrees, or a SkyCoord") from None
    if ra.shape != dec.shape or ra.ndim != 1 or len(ra) < 2:
        raise ValueError(f"found {ra.size} ra and {dec.size} dec of stars, expected the same number, 2 or more")
    if not (np.isfinite(ra).all() and np.isfinite(dec).all() and (np.abs(dec) <= 90).all()):
        raise ValueError("an ra or dec of the stars is no finite number, or a dec is beyond 90 deg")
    return ra, dec


def _circle_of(ra: Array, dec: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the northern pole of the great circle nearest to stars (n,), and the middle of the stars on it.

    The pole has the least squares of sin phi2: the eigenvector of the least eigenvalue.
    """
    star = on_sphere(*_angles(ra, dec))[0]
    _, vectors = np.linalg.eigh(star @ star.T)
    normal = vectors[:, 0] * (1.0 if vectors[2, 0] >= 0 else -1.0)
    middle = star.sum(axis=1)
    middle -= (middle @ normal) * normal
    middle = middle / np.linalg.norm(middle) if np.linalg.norm(middle) > 1e-6 * len(ra) else vectors[:, 2]
    across, ahead = normal @ star, np.cross(normal, middle) @ star
    width = float(np.sqrt((across**2).mean()))
    length = float(np.sqrt((np.arctan2(ahead, middle @ star) ** 2).mean()))
    if not length > LONGER * width or not length > 1e-9:
        raise ValueError(
            f"the stars lie along no great circle: they scatter by {np.degrees(length):.3g} deg along the best one "
            f"and by {np.degrees(width):.3g} deg across it"
        )
    return place_of(normal), place_of(middle)


def _turned(matrix: Array, place: tuple[Any, Any], motion: tuple[Any, Any]) -> tuple[Array, Array, Array, Array]:
    """Turn places in degrees, and their proper motions if there are any, by a matrix (3, 3)."""
    radial, east, north = on_sphere(*_angles(*place))
    x, y, z = np.einsum("ij,j...->i...", matrix, radial)
    lon, lat = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    if motion[0] is None and motion[1] is None:
        none = np.full(lon.shape, np.nan)
        return np.degrees(lon), np.degrees(lat), none, none
    if motion[0] is None or motion[1] is None:
        raise ValueError("a proper motion has two components; only one is given")
    pm_lon, pm_lat = (np.asarray(_plain(each, "mas / yr"), dtype=float) for each in motion)
    _expect_one_shape("places and proper motions", [lon, pm_lon, pm_lat])
    along = np.einsum("ij,j...->i...", matrix, pm_lon * east + pm_lat * north)
    _, new_east, new_north = on_sphere(lon, lat)
    parts = ((along * way).sum(axis=0) for way in (new_east, new_north))
    return np.degrees(lon), np.degrees(lat), *parts


def _angles(lon: Any, lat: Any) -> tuple[Array, Array]:
    """Return both in radians, in a common shape.

    Raises ValueError for arrays of different shapes, and for latitudes beyond 90 deg.
    """
    degrees = [np.asarray(_plain(each, "deg"), dtype=float) for each in (lon, lat)]
    _expect_one_shape("places", degrees)
    if (np.abs(degrees[1]) > 90).any():
        raise ValueError(
            f"a latitude (dec or phi2) of {degrees[1].flat[np.nanargmax(np.abs(degrees[1]))]:g} deg is beyond 90 deg; "
            "are longitude and latitude exchanged?"
        )
    both = np.broadcast_arrays(*map(np.radians, degrees))
    return both[0], both[1]


def _expect_one_shape(what: str, arrays: Sequence[Array]) -> None:
    """Raise ValueError for arrays of different shapes; a number goes with any."""
    shapes = sorted({each.shape for each in arrays if each.ndim})
    if len(shapes) > 1:
        found = " and ".join(str(shape) for shape in shapes)
        raise ValueError(f"the {what} are arrays of the shapes {found}: one shape is wanted, or a number for all")


def _plain(value: Any, unit: str) -> Any:
    """Return the numbers of a quantity in a unit; leave numbers alone."""
    return value.to_value(unit) if hasattr(value, "to_value") else value
