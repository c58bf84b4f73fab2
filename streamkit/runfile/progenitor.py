"""The Sun, and the position and velocity today of the progenitor or a body, in one of several sets of coordinates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from functools import cache
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, create_model, model_validator

from streamkit.components import Potential, circular_speed
from streamkit.errors import OutOfDomain, StreamkitError
from streamkit.stream import Array, Frame, Observer, sky_matrix, to_galactocentric
from streamkit.units import Angle, Coordinate, Duration, Length, ProperMotion, Symbol, Unit, Velocity

MOST_LOOKBACK = 100.0  # the longest look-back time in Gyr
# Other names of coordinates, in run files, schema and paths: the names of tracks, which are astropy's too.
OTHER_NAMES = {"radial_velocity": "v_los"}


class _OrHost(Unit):
    """A unit whose fields may hold the text "host" in place of a number."""

    def parse(self, value: Any) -> Any:
        """Read a quantity as any unit does, and leave "host" alone."""
        try:
            return value if value == "host" else super().parse(value)
        except ValueError as error:
            raise ValueError(f'{error}; or "host"') from None


# A speed in km/s, zero or more, or the text "host".
TiedSpeed = Annotated[Annotated[float, Field(ge=0)] | Literal["host"], _OrHost("km/s")]


class Sun(BaseModel):
    """The Sun: right-handed Galactocentric axes, the Sun at (-r0, 0, 0) with velocity (u, v_circ + v, w).

    The defaults are those of Gibbons+ 2014; v_circ is not tied to the potential of the model, unless it is "host".
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    r0: Annotated[Length, Symbol("$R_0$")] = Field(default=8.0, description="Distance from the Galactic centre.")
    v_circ: Annotated[TiedSpeed, Symbol(r"$v_{\rm c}(R_0)$")] = Field(
        default=237.0,
        description='Rotation speed of the local standard of rest; "host": the circular speed of the potentials at r0.',
    )
    u: Annotated[Velocity, Symbol(r"$U_\odot$")] = Field(
        default=11.1, description="Peculiar velocity towards the Galactic centre."
    )
    v: Annotated[Velocity, Symbol(r"$V_\odot$")] = Field(
        default=12.24, description="Peculiar velocity along the rotation."
    )
    w: Annotated[Velocity, Symbol(r"$W_\odot$")] = Field(
        default=7.25, description="Peculiar velocity towards the north Galactic pole."
    )
    z: Annotated[Coordinate, Symbol(r"$z_\odot$")] = Field(default=0.0, description="Height above the plane.")
    _host_centre: tuple[Any, Any] = PrivateAttr(((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))

    @model_validator(mode="after")
    def _near_the_plane(self) -> Sun:
        if abs(self.z) >= self.r0:
            raise ValueError(f"|z| must be less than r0, found z = {self.z:g} kpc and r0 = {self.r0:g} kpc")
        return self

    @property
    def velocity(self) -> Array:
        """(3,) Galactocentric velocity in km/s."""
        if isinstance(self.v_circ, str):
            raise StreamkitError('sun.v_circ = "host" has no value before it is bound to a host')
        return np.array([self.u, self.v_circ + self.v, self.w])

    @property
    def observer(self) -> Observer:
        """The Sun as an observer."""
        place, motion = self._host_centre
        u, v, w = (self.velocity - np.array(motion)).tolist()
        return Observer(self.r0, self.z, (u, v, w), place)

    def beside(self, q: Array, v: Array) -> Sun:
        """Return the Sun as seen from a host's centre with position q (3,) in kpc and velocity v (3,) in km/s today."""
        sun = self.model_copy()
        sun._host_centre = tuple(q.tolist()), tuple(v.tolist())
        return sun

    def tied(self, potentials: Iterable[Potential]) -> Sun:
        """Return the Sun with v_circ = "host" replaced by the circular speed of the potentials at R0 in the plane.

        OutOfDomain if they have none there.
        """
        if not isinstance(self.v_circ, str):
            return self
        speed = circular_speed(potentials, self.r0)
        if not speed > 0:
            raise OutOfDomain("the host has no circular speed at the Sun, to which sun.v_circ is tied")
        return self.model_copy(update={"v_circ": speed})


class Place(BaseModel, ABC):
    """Position and velocity today."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    title: ClassVar[str]

    @abstractmethod
    def today(self, sun: Sun) -> tuple[Array, Array]:
        """Return the Galactocentric position (3,) in kpc and velocity (3,) in km/s."""

    @classmethod
    @cache
    def coordinates(cls) -> tuple[str, ...]:
        """Return the names of the six coordinates."""
        return tuple(name for name in cls.fields() if name != "frame")

    @classmethod
    @cache
    def fields(cls) -> tuple[str, ...]:
        """Return the names of the coordinates, and of their frame if that is a field."""
        return tuple(name for name in cls.model_fields if name not in ("lookback", "friction", "reflex"))


# The fields that several sets of coordinates have, each with its symbol and its description.
_Distance = Annotated[Length, Symbol("$d$"), Field(description="Heliocentric distance.")]
_LineOfSight = Annotated[
    Velocity,
    Symbol(r"$v_{\rm los}$"),
    Field(description="Heliocentric line-of-sight velocity; radial_velocity is another name of it."),
]
_Longitude = Annotated[Angle, Field(ge=-360, le=360)]
_Latitude = Annotated[Angle, Field(ge=-90, le=90)]


class _OnSky(Place, ABC):
    """Two angles, the distance, two proper motions and the line-of-sight velocity, in this order."""

    sky: ClassVar[Literal["icrs", "galactic"] | None] = None
    """The frame of the angles; None if it is the field ``frame``."""

    def today(self, sun: Sun) -> tuple[Array, Array]:
        """Transform from the sky."""
        frame = sky_matrix(getattr(self, "frame")) if self.sky is None else self.sky  # noqa: B009  not every class has it
        lon, lat, distance, pm_lon, pm_lat, v_los = (getattr(self, name) for name in self.coordinates())
        return to_galactocentric(frame, lon, lat, distance, pm_lon, pm_lat, v_los, sun.observer)


class _GalacticSky(_OnSky):
    """Galactic coordinates and proper motions."""

    title = "Galactic sky"
    sky = "galactic"

    l: Annotated[_Longitude, Symbol("$l$")] = Field(description="Galactic longitude.")  # noqa: E741  the field's own name
    b: Annotated[_Latitude, Symbol("$b$")] = Field(description="Galactic latitude.")
    distance: _Distance
    pm_l_cosb: Annotated[ProperMotion, Symbol(r"$\mu_l \cos b$")] = Field(
        description="Proper motion in l, times cos b."
    )
    pm_b: Annotated[ProperMotion, Symbol(r"$\mu_b$")] = Field(description="Proper motion in b.")
    v_los: _LineOfSight


class _EquatorialSky(_OnSky):
    """Equatorial (ICRS) coordinates and proper motions."""

    title = "equatorial sky (ICRS)"
    sky = "icrs"

    ra: Annotated[_Longitude, Symbol(r"${\rm RA}$")] = Field(description="Right ascension.")
    dec: Annotated[_Latitude, Symbol(r"${\rm Dec}$")] = Field(description="Declination.")
    distance: _Distance
    pm_ra_cosdec: Annotated[ProperMotion, Symbol(r"$\mu_\alpha \cos \delta$")] = Field(
        description="Proper motion in right ascension, times cos dec."
    )
    pm_dec: Annotated[ProperMotion, Symbol(r"$\mu_\delta$")] = Field(description="Proper motion in declination.")
    v_los: _LineOfSight


class _StreamSky(_OnSky):
    """Coordinates and proper motions along and across a stream."""

    title = "stream's own sky"

    frame: Frame = Field(
        description='Frame of phi1, phi2: a name such as "GD1Koposov10", { pole = [ra, dec], origin = [ra, dec] } in '
        "degrees, or the three rows of a matrix from ICRS."
    )
    phi1: Annotated[_Longitude, Symbol(r"$\phi_1$")] = Field(description="Longitude along the stream.")
    phi2: Annotated[_Latitude, Symbol(r"$\phi_2$")] = Field(description="Latitude across the stream.")
    distance: _Distance
    pm_phi1_cosphi2: Annotated[ProperMotion, Symbol(r"$\mu_{\phi_1} \cos \phi_2$")] = Field(
        description="Proper motion in phi1, times cos phi2."
    )
    pm_phi2: Annotated[ProperMotion, Symbol(r"$\mu_{\phi_2}$")] = Field(description="Proper motion in phi2.")
    v_los: _LineOfSight


class _Galactocentric(Place):
    """Galactocentric Cartesian coordinates; the Sun does not enter."""

    title = "Galactocentric"

    x: Annotated[Coordinate, Symbol("$x$")] = Field(
        description="Position away from the Sun, through the Galactic centre."
    )
    y: Annotated[Coordinate, Symbol("$y$")] = Field(description="Position along the Galactic rotation at the Sun.")
    z: Annotated[Coordinate, Symbol("$z$")] = Field(description="Position towards the north Galactic pole.")
    vx: Annotated[Velocity, Symbol("$v_x$")] = Field(description="Velocity along x.")
    vy: Annotated[Velocity, Symbol("$v_y$")] = Field(description="Velocity along y.")
    vz: Annotated[Velocity, Symbol("$v_z$")] = Field(description="Velocity along z.")

    def today(self, sun: Sun) -> tuple[Array, Array]:
        """Return the coordinates themselves."""
        return np.array([self.x, self.y, self.z]), np.array([self.vx, self.vy, self.vz])


SETS: tuple[type[Place], ...] = (_GalacticSky, _EquatorialSky, _StreamSky, _Galactocentric)


class PhaseSpace(Place, ABC):
    """The progenitor today, in one of the sets of coordinates, and the time over which its orbit is integrated back."""

    lookback: Annotated[Duration, Symbol(r"$t_{\rm back}$")] = Field(
        le=MOST_LOOKBACK, description="Time over which the progenitor has been stripped."
    )
    friction: Literal["chandrasekhar", "none"] | None = Field(
        default=None, description="Dynamical friction of the Milky Way on the whole mass of the progenitor. Or none."
    )
    reflex: bool | None = Field(
        default=None, description="Whether the Milky Way moves because of the progenitor. By default it does not."
    )


class BodyPlace(Place, ABC):
    """A body today, in one of the sets of coordinates, and the forces between it and the Milky Way."""

    friction: Literal["chandrasekhar", "none"] = Field(
        default="chandrasekhar", description="Dynamical friction of the Milky Way on the mass of the body."
    )
    reflex: bool = Field(default=True, description="Whether the Milky Way moves because of the body.")


P = TypeVar("P", bound=Place)


def _ways(prefix: str, owner: Any) -> Any:
    """Return, for each set of coordinates, the class of a position with the fields of its owner."""
    return tuple(
        create_model(f"{prefix}{one.__name__.lstrip('_')}", __base__=(one, owner), __doc__=one.__doc__) for one in SETS
    )


WAYS: tuple[type[PhaseSpace], ...] = _ways("", PhaseSpace)
BODY_WAYS: tuple[type[BodyPlace], ...] = _ways("Body", BodyPlace)


def choose_coordinates(
    given: Iterable[str],
    taken: Iterable[str] = (),
    ways: tuple[type[P], ...] = WAYS,  # type: ignore[assignment]  # the default of P
) -> type[P]:
    """Return the set of coordinates that a section gives; ValueError if it gives none or several of the ``ways``.

    ``given`` are the keys of the section without the fields of its potential. The fields of the potential are
    ``taken``: a set of coordinates with one of these names is not available. ``ways`` are the sets of the progenitor,
    or of a body.
    """
    given, taken = set(given), set(taken)
    free = [way for way in ways if not taken & way.model_fields.keys()]
    owner = "progenitor" if ways is WAYS else "body"
    shared = {"distance", "v_los"}
    fits = [way for way in free if given & (set(way.coordinates()) - shared)]
    if len(fits) == 1:
        return fits[0]
    sets = "; ".join(f"{way.title}: {', '.join(way.fields())}" for way in free)
    clash = "".join(
        f" ({way.title} is not available here: the {owner}'s potential has a field "
        f"{', '.join(sorted(taken & way.model_fields.keys()))} of its own.)"
        for way in ways
        if way not in free
    )
    problem = "coordinates of several sets" if fits else "no phase-space coordinates"
    names = ", ".join(sorted(given & {name for way in free for name in way.coordinates()}))
    listed = f" ({names})" if names else ""
    raise ValueError(f"found {problem}{listed}, expected exactly one of the sets {sets}.{clash}")
