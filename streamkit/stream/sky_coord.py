"""A stream as an astropy SkyCoord, in ICRS or in a frame of its own."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from streamkit.stream.arrays import Array
from streamkit.stream.frames import Seen

if TYPE_CHECKING:
    from astropy.coordinates import SkyCoord


def to_sky_coord(seen: Seen, matrix: Array | None) -> SkyCoord:
    """Return a SkyCoord with distance, proper motions and radial velocity, in ICRS or in the frame of a matrix (3, 3).

    Coordinates in such a frame are called phi1 and phi2, and astropy transforms them to any other frame.
    """
    from astropy import units as u  # slow to import
    from astropy.coordinates import ICRS, SkyCoord

    lon, lat, distance, pm_lon, pm_lat, v_r = (
        value * unit
        for value, unit in zip(seen[:6], (u.deg, u.deg, u.kpc, u.mas / u.yr, u.mas / u.yr, u.km / u.s), strict=True)
    )
    if matrix is None:
        frame = ICRS(
            ra=lon, dec=lat, distance=distance, pm_ra_cosdec=pm_lon, pm_dec=pm_lat, radial_velocity=v_r
        )  # fmt: skip
    else:
        rows = tuple(tuple(row) for row in np.asarray(matrix).tolist())
        frame = stream_frame()(
            phi1=lon, phi2=lat, distance=distance, pm_phi1_cosphi2=pm_lon, pm_phi2=pm_lat, radial_velocity=v_r,
            matrix=rows,
        )  # fmt: skip
    return SkyCoord(frame)


@functools.cache
def stream_frame() -> Any:
    """Return the class `StreamFrame` of astropy frames by their matrix from ICRS; made on first use."""
    from astropy import coordinates as c
    from astropy import units as u
    from astropy.coordinates.transformations import DynamicMatrixTransform

    class StreamFrame(c.BaseCoordinateFrame):  # type: ignore[misc]
        """Heliocentric angles phi1, phi2 along and across a stream.

        Parameters
        ----------
        matrix
            Three rows of three numbers: the axes of the frame in ICRS.
        """

        matrix = c.Attribute(default=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
        default_representation = c.SphericalRepresentation
        default_differential = c.SphericalCosLatDifferential
        frame_specific_representation_info = {
            c.SphericalRepresentation: [
                c.RepresentationMapping("lon", "phi1"), c.RepresentationMapping("lat", "phi2"),
                c.RepresentationMapping("distance", "distance"),
            ],
        }  # fmt: skip

        def represent_as(self, base: Any, s: Any = "base", in_frame_units: bool = False) -> Any:
            """Represent as the base class does, with phi1 in (-180, 180]."""
            represented = super().represent_as(base, s=s, in_frame_units=in_frame_units)
            if hasattr(represented, "lon"):
                represented.lon.wrap_angle = 180 * u.deg
            return represented

    @c.frame_transform_graph.transform(DynamicMatrixTransform, c.ICRS, StreamFrame)  # type: ignore[untyped-decorator]
    def _from_icrs(_: Any, to: Any) -> Array:
        return np.array(to.matrix)

    @c.frame_transform_graph.transform(DynamicMatrixTransform, StreamFrame, c.ICRS)  # type: ignore[untyped-decorator]
    def _to_icrs(of: Any, _: Any) -> Array:
        return np.array(of.matrix).T

    @c.frame_transform_graph.transform(  # type: ignore[untyped-decorator]
        c.FunctionTransform, StreamFrame, StreamFrame
    )
    def _between(of: Any, to: Any) -> Any:
        return of.transform_to(c.ICRS()).transform_to(to)

    StreamFrame.__module__, StreamFrame.__qualname__ = __name__, "StreamFrame"  # needed for pickle
    return StreamFrame


def __getattr__(name: str) -> Any:
    if name == "StreamFrame":
        return stream_frame()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
