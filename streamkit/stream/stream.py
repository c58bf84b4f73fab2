"""The nouns of the pipeline as frozen dataclasses of arrays. Shapes and units are stated here once.

Engine units throughout: kpc, km/s, Msun; times in kpc/(km/s) with 0 today and the past negative.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from streamkit.stream.arrays import ARMS, Array, BoolArray, IntArray, freeze, read_only
from streamkit.stream.orbit import Orbit
from streamkit.units import GYR

if TYPE_CHECKING:
    from astropy.table import QTable


@dataclass(frozen=True)
class Release:
    """Where the particles start: q, v (3, n), at the release times they were asked for."""

    q: Array
    v: Array


def _known(orbit: Orbit | None) -> Orbit | None:
    return orbit


no_future = partial(_known, None)
"""For streams whose progenitor is not followed beyond today."""


@dataclass(frozen=True, repr=False)
class Stream:
    """The particles today, and what happened to each. The arrays are read-only.

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
        (n,) how many particles of the scheme's own release rate each one stands for; their mean is 1.
    orbit
        The progenitor's track from the look-back time to today.
    parameters
        The free parameters it was made with, by name, in the units of the run file.
    ahead
        Finds `future`, when somebody asks for it.
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
    ahead: Callable[[], Orbit | None] = no_future

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
        return {**self.__dict__, "ahead": partial(_known, self.future)}  # what finds it holds machine code

    @cached_property
    def future(self) -> Orbit | None:
        """The progenitor's track from today to just past its next apocentre; None where it has none."""
        return self.ahead()

    @cached_property
    def r(self) -> Array:
        """(n,) Galactocentric distance in kpc."""
        return np.asarray(read_only(np.sqrt((self.q**2).sum(axis=0))))

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
        frame = np.stack(self.orbit.at(self.t_strip).frame)  # when asked for: no likelihood call needs it
        return np.asarray(read_only(np.einsum("fcn,cn->fn", frame, x)))

    def table(self) -> QTable:
        """Return one row per particle with units, as an astropy QTable."""
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
        table.meta["parameters"] = dict(self.parameters)
        return table
