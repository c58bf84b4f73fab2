"""Frames on the sky: named ones of known streams, or a great circle by its pole and origin, or a matrix."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Protocol

import numpy as np
from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from streamkit.errors import nearest
from streamkit.stream.arrays import Array, read_only
from streamkit.stream.frames import axes


class HasMatrix(Protocol):
    """An object that numpy can convert to a matrix, such as a `SkyFrame`."""

    def __array__(self, dtype: Any = None, copy: Any = None) -> Array:
        """Return the matrix (3, 3) from ICRS."""


class _FrameField:
    """Reads a frame where `Frame` is the type of a component's field: as a run file writes it, and checked."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Read a name, a pole and an origin, or three rows; None is left alone, as the default of a field."""
        point = tuple[float, float]
        written = str | dict[str, point | tuple[point, point]] | tuple[tuple[float, float, float], ...]
        return core_schema.no_info_wrap_validator_function(self._read, handler.generate_schema(written))

    @staticmethod
    def _read(value: Any, read: Callable[[Any], Any]) -> Any:
        if value is None:
            return None
        value = np.asarray(value).tolist() if hasattr(value, "__array__") else value
        sky_matrix(value)  # first: its errors name the part of the frame
        return read(value)


# A name, ``{"pole": [ra, dec], "origin": [ra, dec]}``, ``{"ends": [[ra, dec], [ra, dec]]}``, a (3, 3) matrix from
# ICRS or a `SkyFrame`, or None for ICRS itself. It may be the type of a component's field.
Frame = Annotated[str | Mapping[str, Any] | Sequence[Sequence[float]] | Array | HasMatrix | None, _FrameField()]

# Rows are the axes of the frame in ICRS.
FROM_ICRS: dict[str, list[list[float]]] = {
    # Koposov, Rix & Hogg 2010, ApJ 712, 260, appendix
    "GD1Koposov10": [
        [-0.4776303088, -0.1738432154, 0.8611897727],
        [0.510844589, -0.8524449229, 0.111245042],
        [0.7147776536, 0.4930681392, 0.4959603976],
    ],
    # Koposov+ 2019, MNRAS 485, 4726, appendix B
    "OrphanKoposov19": [
        [-0.44761231, -0.08785756, -0.88990128],
        [-0.84246097, 0.37511331, 0.38671632],
        [0.29983786, 0.92280606, -0.2419219],
    ],
    # Bonaca+ 2019, ApJ 881, L37
    "JhelumBonaca19": [
        [0.6173151074, -0.0093826715, -0.7866600433],
        [-0.0151801852, -0.9998847743, 0.0000135163],
        [-0.7865695266, 0.0119333013, -0.6173864075],
    ],
    # Shipp+ 2020, AJ 160, 244
    "Pal13Shipp20": [
        [0.94906836, -0.22453560, 0.22102719],
        [-0.06325861, 0.55143610, 0.83181523],
        [-0.30865450, -0.80343138, 0.50914675],
    ],
    # Lambda~, B~ of Belokurov+ 2014, MNRAS 437, 116, appendix A: leading positive, left-handed; it is
    # diag(1, -1, -1) times that of Law & Majewski 2010
    "SagittariusBelokurov14": [
        [0.21215555, -0.84846291, -0.48487186],
        [-0.93595354, -0.31910658, 0.14886895],
        [0.28103559, -0.42223415, 0.86182209],
    ],
}

# Price-Whelan+ 2019, AJ 158, 223: along the stream, then the cluster to the origin.
PAL5 = (
    [
        [9.99938314e-01, 1.57847502e-03, -1.09943927e-02],
        [-1.57837962e-03, 9.99998754e-01, 1.73543959e-05],
        [1.09944064e-02, 0.0, 9.99939560e-01],
    ],
    [
        [-0.65019243, -0.75969758, -0.01045969],
        [-0.62969142, 0.54652698, -0.55208422],
        [0.42513354, -0.3523746, -0.83372274],
    ],
)

# Price-Whelan+ 2016, MNRAS 455, 1079, from Galactic coordinates.
OPHIUCHUS = [
    [0.84922096554, 0.07001279040, 0.52337554476],
    [-0.27043653641, -0.79364259852, 0.54497294023],
    [0.45352820359, -0.60434231606, -0.65504391727],
]

FARTHEST = 10.0  # degrees: an origin may be so far from the great circle of its pole, and is moved onto it
WORST = 1e-3  # largest deviation of a matrix from an orthonormal one: papers print few digits


@functools.cache
def named_matrices() -> dict[str, Array]:
    """Return the (3, 3) matrix of every named frame; the names are gala's where it has the frame."""
    galactic = axes("galactic").T @ axes("icrs")
    matrices = {name: np.array(rows) for name, rows in FROM_ICRS.items()}
    matrices["icrs"], matrices["galactic"] = np.eye(3), galactic
    matrices["Pal5PriceWhelan18"] = np.array(PAL5[0]) @ np.array(PAL5[1])
    matrices["OphiuchusPriceWhelan16"] = np.array(OPHIUCHUS) @ galactic
    # Newberg+ 2010, ApJ 711, 32
    matrices["OrphanNewberg10"] = _euler(128.79, 54.39, 90.70) @ galactic
    # Law & Majewski 2010, ApJ 714, 229: left-handed, trailing positive
    law = _euler(183.75, 76.54, 194.111534)
    matrices["SagittariusLaw10"] = np.diag([1.0, 1.0, -1.0]) @ law @ galactic
    # Vasiliev, Belokurov & Erkal 2021, MNRAS 501, 2279: right-handed, leading positive
    matrices["SagittariusVasiliev21"] = np.diag([1.0, -1.0, -1.0]) @ law @ galactic
    # Nidever, Majewski & Burton 2008, ApJ 679, 432: pole at (l, b) = (188.5, -7.5) deg
    nidever = _about("z", 57.275785782128686) @ _about("y", 97.5) @ _about("z", 188.5)
    matrices["MagellanicStreamNidever08"] = nidever @ galactic
    return {name: read_only(_nearest_rotation(matrix)) for name, matrix in matrices.items()}


def sky_matrix(frame: Frame = None) -> Array:
    """Return the (3, 3) matrix from ICRS to a frame; a left-handed frame has a determinant of -1.

    Parameters
    ----------
    frame
        None for ICRS; a name; ``{"pole": [ra, dec], "origin": [ra, dec]}`` in degrees, for a great circle about the
        pole with longitude zero at the origin; ``{"ends": [[ra, dec], [ra, dec]]}`` for one through two points, with
        longitude zero between them or at an ``origin``; or the matrix itself.

    Raises ValueError for an unknown name (the message has the nearest one), for a value that is no frame, and for an
    origin more than 10 deg off the great circle.
    """
    if frame is None:
        return named_matrices()["icrs"]
    if isinstance(frame, str):
        if frame not in (matrices := named_matrices()):
            close = nearest(frame, matrices)
            raise ValueError(f"there is no frame {frame!r}.{close} Known: {', '.join(sorted(matrices))}")
        return matrices[frame]
    if isinstance(frame, Mapping):
        return _great_circle(frame)
    try:
        matrix = np.array(frame, dtype=float)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise ValueError(
            f"found {frame!r}, expected the name of a frame, {{ pole = [ra, dec], origin = [ra, dec] }} in degrees, "
            "or a matrix of three rows of three numbers"
        )
    if not np.abs(matrix @ matrix.T - np.eye(3)).max() < WORST:
        raise ValueError("the matrix of the frame is no rotation: its rows must be unit vectors at right angles")
    return np.asarray(read_only(_nearest_rotation(matrix)))


def _great_circle(given: Mapping[str, Any]) -> Array:
    if set(given) not in ({"pole", "origin"}, {"ends"}, {"ends", "origin"}):
        raise ValueError(
            "a frame of a great circle takes pole and origin, each [ra, dec], or ends, two of [ra, dec]; found "
            f"{', '.join(given) or 'nothing'}"
        )
    if "ends" in given:
        z, towards = _through(given["ends"])
        towards = _unit("origin", given["origin"]) if "origin" in given else towards
    else:
        z, towards = (_unit(name, given[name]) for name in ("pole", "origin"))
    off = abs(math.degrees(math.asin(max(-1.0, min(1.0, float(towards @ z))))))
    if off > 90.0 - 1e-4:
        raise ValueError("the origin of the frame is at its pole, where there is no longitude")
    if off > FARTHEST:
        raise ValueError(
            f"the origin of the frame is {off:.3g} deg off the great circle of its pole, expected at most "
            f"{FARTHEST:g}. The origin is 90 deg from the pole; both are [ra, dec], not galactic"
        )
    x = towards - (towards @ z) * z
    x = x / math.sqrt(x @ x)
    return np.asarray(read_only(np.array([x, np.cross(z, x), z])))


def _through(ends: Any) -> tuple[Array, Array]:
    """Return the pole of the great circle through two points, and the middle of the shorter arc between them."""
    try:
        pairs = list(ends)
    except TypeError:
        pairs = []
    if isinstance(ends, str) or len(pairs) != 2:
        raise ValueError(f"found {ends!r} for the ends of the frame, expected [[ra, dec], [ra, dec]] in degrees")
    first, second = (_unit("ends", pair) for pair in pairs)
    z = np.cross(first, second)
    if not math.sqrt(z @ z) > 1e-6:
        raise ValueError("the ends of the frame are one place, or opposite: many great circles go through them")
    return z / math.sqrt(z @ z), (first + second) / math.sqrt((first + second) @ (first + second))


def _unit(name: str, pair: Any) -> Array:
    try:
        lon, lat = (math.radians(float(value)) for value in pair)
    except (TypeError, ValueError):
        raise ValueError(f"found {pair!r} for the {name} of the frame, expected [ra, dec] in degrees") from None
    if not (math.isfinite(lon) and abs(lat) <= math.pi / 2):
        raise ValueError(f"found {pair!r} for the {name} of the frame: dec must be within -90 and 90")
    return on_sphere(np.array(lon), np.array(lat))[0]


def on_sphere(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
    """Return unit vectors outwards, in longitude and in latitude, (3, ...) each, at angles in radians."""
    a, b, c, d = np.cos(lon), np.sin(lon), np.cos(lat), np.sin(lat)
    zero = np.zeros_like(a)
    return np.array([a * c, b * c, d]), np.array([-b, a, zero]), np.array([-a * d, -b * d, c])


def place_of(vector: Array) -> tuple[float, float]:
    """Return the longitude in [0, 360) and the latitude of a direction (3,), degrees."""
    x, y, z = np.asarray(vector, dtype=float).tolist()
    return math.degrees(math.atan2(y, x)) % 360.0, math.degrees(math.atan2(z, math.hypot(x, y)))


def _about(axis: str, degrees: float) -> Array:
    """Turn the axes (not the vectors) about one of them."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    out = np.eye(3)
    out[i, i] = out[j, j] = c
    out[i, j], out[j, i] = s, -s
    return out


def _euler(phi: float, theta: float, psi: float) -> Array:
    """(3, 3) Euler angles in the x-convention (Goldstein), degrees."""
    return np.asarray(_about("z", psi) @ _about("x", theta) @ _about("z", phi))


def _nearest_rotation(matrix: Array) -> Array:
    """Return the orthonormal matrix nearest to one that was printed with few digits."""
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)
