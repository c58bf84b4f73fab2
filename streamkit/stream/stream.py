"""The nouns of the pipeline as frozen dataclasses of arrays. Shapes and units are stated here once.

Engine units throughout: kpc, km/s, Msun; times in kpc/(km/s) with 0 today and the past negative.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from html import escape
from typing import TYPE_CHECKING, Literal

import numpy as np

from streamkit.stream.arrays import ARMS, Array, BoolArray, IntArray, freeze, read_only
from streamkit.stream.frames import Seen, axes, seen_from
from streamkit.stream.observer import GIBBONS14, Observer
from streamkit.stream.orbit import Orbit
from streamkit.stream.sky_coord import to_sky_coord
from streamkit.stream.sky_frames import Frame, sky_matrix
from streamkit.stream.sky_track import SkyTrack, even_grid, grid_from, track_of, within_half_turn
from streamkit.units import GYR

if TYPE_CHECKING:
    from astropy.coordinates import SkyCoord
    from astropy.table import QTable


@dataclass(frozen=True)
class Release:
    """Positions and velocities q, v (3, n) of the particles at their release."""

    q: Array
    v: Array


WIDEST = 45.0  # largest kernel of a track, degrees


def _return(orbit: Orbit | None) -> Orbit | None:
    return orbit


no_future = partial(_return, None)  # for streams whose progenitor is not followed beyond today


@dataclass(frozen=True, repr=False)
class Stream:
    """The particles today, with the history of each. The arrays are read-only.

    Attributes
    ----------
    q, v
        (3, n) Galactocentric positions and velocities today.
    t_release
        (n,) time of release.
    t_strip
        (n,) stripping time: the last time inside the instantaneous tidal radius; 0 for bound particles.
    dq_galactocentric, dv_galactocentric
        (3, n) position and velocity relative to the progenitor at the stripping time; today's for bound particles.
    tail
        (n,) Lagrange point of release: -1 inner ("leading"), +1 outer ("trailing").
    winding
        (n,) angle swept in the progenitor's orbital plane minus the angle swept by the progenitor, radians;
        positive = leading.
    chi
        (n,) the phase of Gibbons+ 2014: time-weighted sum of ``|x| - |x_p|`` since release, kpc * kpc/(km/s);
        negative = leading.
    bound
        (n,) True for particles that are inside the tidal radius today.
    weight
        (n,) statistical weight of each particle relative to the scheme's release rate; the mean is 1.
    orbit
        The progenitor's track from the look-back time to today.
    parameters
        The free parameters it was made with, by name, in the units of the run file.
    sun
        The Sun it is seen from; that of Gibbons+ 2014 unless given.
    ahead
        Computes `future` on first use.
    mass
        Mass of the progenitor at the look-back time in Msun; NaN if unknown.
    """

    q: Array
    v: Array
    t_release: Array
    t_strip: Array
    dq_galactocentric: Array
    dv_galactocentric: Array
    tail: IntArray
    winding: Array
    chi: Array
    bound: BoolArray
    weight: Array
    orbit: Orbit
    parameters: dict[str, float] = field(default_factory=dict)
    sun: Observer = GIBBONS14
    ahead: Callable[[], Orbit | None] = no_future
    mass: float = float("nan")

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return int(self.q.shape[1])

    def __repr__(self) -> str:
        counts = ", ".join(f"{int((self.arm == arm).sum())} {name}" for name, arm in ARMS.items())
        return f"<Stream of {len(self)} particles: {counts}, {int(self.bound.sum())} bound>"

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self))}</p>{self.table()[:5]._repr_html_()}"

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "ahead": partial(_return, self.future)}  # the function holds machine code

    @cached_property
    def future(self) -> Orbit | None:
        """The progenitor's track from today to just past its next apocentre; None where it has none."""
        return self.ahead()

    @cached_property
    def r(self) -> Array:
        """(n,) Galactocentric distance in kpc."""
        return np.asarray(read_only(np.sqrt((self.q**2).sum(axis=0))))

    @property
    def bound_share(self) -> float:
        """The share of the particles' mass that is bound to the progenitor today."""
        return float(self.weight[self.bound].sum() / self.weight.sum())

    @cached_property
    def arm(self) -> IntArray:
        """(n,) 1 leading, -1 trailing, by the sign of the winding; 0 bound."""
        arm = np.where(self.bound, 0, np.where(self.winding > 0, 1, -1)).astype(np.int64)
        return np.asarray(read_only(arm))

    @cached_property
    def dq_strip(self) -> Array:
        """(3, n) ``dq_galactocentric`` in the progenitor's frame then: radial, tangential, out of the plane."""
        return self._turned(self.dq_galactocentric)

    @cached_property
    def dv_strip(self) -> Array:
        """(3, n) ``dv_galactocentric`` in the progenitor's frame then: radial, tangential, out of the plane."""
        return self._turned(self.dv_galactocentric)

    def _turned(self, x: Array) -> Array:
        frame = np.stack(self.orbit.at(self.t_strip).frame)  # on first use: no likelihood call needs it
        return np.asarray(read_only(np.einsum("fcn,cn->fn", frame, x)))

    def seen(self, frame: Frame = None) -> Seen:
        """Return the particles on the sky as plain arrays: degrees, kpc, mas/yr, km/s.

        Parameters
        ----------
        frame
            None for ICRS (lon and lat are then RA and Dec); a name such as "GD1Koposov10"; a pole and an origin,
            ``{"pole": [ra, dec], "origin": [ra, dec]}``; a (3, 3) matrix from ICRS; or a `SkyFrame`.

        Raises ValueError for a frame that does not exist.
        """
        return seen_from(self.sun, self.q, self.v, sky_matrix(frame))

    def unwrapped_longitude(self, frame: Frame = None) -> Array:
        """(n,) Longitude in degrees in a frame, as in `seen`, without jumps at whole turns along the stream.

        The longitude of the progenitor is in (-180, 180]. Whole turns are counted by the angle between particle and
        progenitor at the Galactic centre. The frame should therefore lie along the stream, and the debris should be
        farther from the centre than the Sun.
        """
        matrix = sky_matrix(frame)
        core = self.orbit.q[:, -1:], self.orbit.v[:, -1:]
        longitude_of_core = float(seen_from(self.sun, *core, matrix).lon[0])
        turn = matrix @ (self.sun.tilt @ axes("icrs")).T
        (x, y, _), (u, v, _) = ((turn @ each[:, 0]).tolist() for each in core)
        centred = np.degrees(np.arctan2(y, x)) + np.sign(x * v - y * u) * np.degrees(self.winding)
        shift = np.round((np.degrees(np.arctan2(y, x)) - longitude_of_core) / 360.0)
        longitude = self.seen(frame).lon
        return np.asarray(longitude + 360.0 * (np.round((centred - longitude) / 360.0) - shift))

    def track(
        self,
        frame: Frame = None,
        phi1: Sequence[float] | Array | None = None,
        *,
        kernel: float = 2.0,
        arm: Literal["leading", "trailing", "both"] = "both",
        unwrapped: bool = False,
    ) -> SkyTrack:
        """Return the mean track of the debris on the sky, with the covariance of the debris about it.

        At every longitude a line is fitted with a Gaussian kernel in phi1, as the observable ``track`` does. Bound
        particles are left out.

        Parameters
        ----------
        frame
            As in `seen`.
        phi1
            (k,) longitudes in degrees; by default in steps of half a kernel along nearly all of the debris.
        kernel
            Standard deviation of the kernel, degrees.
        arm
            Which debris.
        unwrapped
            Whether phi1 continues beyond whole turns, as in `unwrapped_longitude`.

        Raises ValueError for a frame that does not exist, an arm without debris, and a kernel or phi1 that is no
        positive number, or no list of numbers.
        """
        if not 0 < kernel <= WIDEST:
            raise ValueError(f"kernel is {kernel:g} deg, expected a positive number up to {WIDEST:g}")
        if arm not in ("both", *ARMS):
            raise ValueError(f"found arm = {arm!r}, expected both, {' or '.join(ARMS)}")
        chosen = np.flatnonzero(~self.bound if arm == "both" else self.arm == ARMS[arm])
        if not len(chosen):
            raise ValueError("the stream has no debris in this arm: no track")
        seen, weight = Seen(*(part[chosen] for part in self.seen(frame))), self.weight[chosen]
        given = None if phi1 is None else grid_from(phi1)
        if unwrapped:
            longitude = self.unwrapped_longitude(frame)[chosen]
            at = even_grid(longitude, kernel) if given is None else given
            return track_of(longitude, seen, weight, at, kernel, turn=False)
        # the seam is opposite to the grid, or to the progenitor
        core = seen_from(self.sun, self.orbit.q[:, -1:], self.orbit.v[:, -1:], sky_matrix(frame)).lon
        middle = float(np.degrees(np.angle(np.exp(1j * np.radians(core if given is None else given)).sum())))
        longitude = within_half_turn(seen.lon, middle)
        at = even_grid(longitude, kernel) if given is None else given
        track = track_of(longitude, seen, weight, within_half_turn(at, middle), kernel, turn=True)
        return replace(track, phi1=at)

    def toward(self, velocity: Array) -> Array:
        """(n,) Component of a Galactocentric velocity (3,) along the line of sight from the Sun to each particle."""
        away = self.q - self.sun.q[:, None]
        return np.asarray(velocity @ away / np.sqrt((away**2).sum(axis=0)))

    def sky(self, frame: Frame = None) -> SkyCoord:
        """Return the particles as an astropy SkyCoord with distance, proper motions and radial velocity.

        The frame is as in `seen`. It is ICRS, with ra and dec, or one with phi1 and phi2.

        Raises ValueError for a frame that does not exist.
        """
        return to_sky_coord(self.seen(frame), None if frame is None else sky_matrix(frame))

    def table(self, frame: Frame = None) -> QTable:
        """Return one row per particle with units, as an astropy QTable.

        Galactocentric positions and velocities, times, angle and arm; then what the Sun sees in ICRS, and in a frame
        as in `seen` if one is given: phi1, phi2 and the proper motions along them.
        """
        from astropy import units as u
        from astropy.table import QTable

        kpc, kms = u.kpc, u.km / u.s
        table = QTable()
        for name, row in zip("xyz", self.q, strict=True):
            table[name] = row * kpc
        for name, row in zip(("vx", "vy", "vz"), self.v, strict=True):
            table[name] = row * kms
        table["t_release"] = self.t_release / GYR * u.Gyr
        table["t_strip"] = np.where(self.bound, np.nan, self.t_strip) / GYR * u.Gyr
        table["winding"] = np.degrees(self.winding) * u.deg
        table["phase"] = self.chi / GYR * kpc * u.Gyr
        table["arm"] = np.array(["trailing", "bound", "leading"])[self.arm + 1]
        table["lagrange_point"] = np.where(self.tail < 0, "inner", "outer")
        table["bound"] = self.bound
        deg, pm = u.deg, u.mas / u.yr
        sky = self.seen()
        table["ra"], table["dec"] = sky.lon % 360.0 * deg, sky.lat * deg
        table["distance"] = sky.distance * kpc
        table["pm_ra_cosdec"], table["pm_dec"] = sky.pm_lon_coslat * pm, sky.pm_lat * pm
        table["radial_velocity"] = sky.radial_velocity * kms
        table["radial_velocity_gsr"] = sky.radial_velocity_gsr * kms
        if frame is not None:
            sky = self.seen(frame)
            table["phi1"], table["phi2"] = sky.lon * deg, sky.lat * deg
            table["pm_phi1_cosphi2"], table["pm_phi2"] = sky.pm_lon_coslat * pm, sky.pm_lat * pm
        table.meta["parameters"] = dict(self.parameters)
        return table
