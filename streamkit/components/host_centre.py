"""The centre of a host whose parts all move: streams are made about it, in a frame that moves along."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from pydantic import PrivateAttr

from streamkit import engine
from streamkit.components.potential import Potential
from streamkit.components.total import Total
from streamkit.stream import Array
from streamkit.units import GYR, Unit

WITHIN = 30.0  # kpc: the galaxy with most mass inside is the host
MASSLESS = 1e-6  # share of the largest mass below which a part has none
LOOKS = 513  # times at which the path is looked at
AT_REST = 1e-9  # (km/s)^2/kpc: in 10 Gyr this moves nothing by more than 1e-7 kpc

_ACCELERATION = Unit("km2 / (kpc s2)")


class FrameForce(Potential):
    """Minus the acceleration of the frame, which is the same at every place. It is no component of run files."""

    kind = "moving_frame"

    ax: Annotated[float, _ACCELERATION] = 0.0
    ay: Annotated[float, _ACCELERATION] = 0.0
    az: Annotated[float, _ACCELERATION] = 0.0
    _pieces: tuple[Array, ...] = PrivateAttr(())

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, ax: Any, ay: Any, az: Any) -> Any:
        """Return it at every place."""
        return ax + 0.0 * x, ay + 0.0 * y, az + 0.0 * z

    @classmethod
    def along(cls, pieces: tuple[Array, ...]) -> FrameForce:
        """Return the force with the pieces of its three components in time, as `engine.Changes` has them."""
        ax, ay, az = (float(engine.values_at(np.zeros(1), each)[0]) for each in pieces)
        force = cls(ax=ax, ay=ay, az=az)
        force._pieces = pieces
        return force

    def changes(self) -> engine.Changes:
        """Return its three components in time."""
        return tuple(enumerate(self._pieces))


@dataclass(frozen=True)
class HostCentre:
    """The path of a host's centre in the coordinates of the run file.

    Attributes
    ----------
    path
        (k, 13) its cubics in time, as `engine.Motion.centre` has them.
    """

    path: Array

    @cached_property
    def today(self) -> tuple[Array, Array]:
        """Its position (3,) in kpc and its velocity (3,) in km/s today."""
        return engine.Motion(centre=self.path).state_at(0.0)

    def farthest(self, lookback: float) -> tuple[float, float]:
        """Return its largest distance from the origin in kpc over a look-back time in Gyr, and how many Gyr ago."""
        times = np.linspace(-lookback * GYR, 0.0, LOOKS)
        away = np.sqrt((engine.Motion(centre=self.path).centres_at(times) ** 2).sum(axis=0))
        farthest = int(np.argmax(away))
        return float(away[farthest]), -float(times[farthest]) / GYR

    @cached_property
    def force(self) -> FrameForce | None:
        """The force in the frame that moves along; None if the centre moves evenly."""
        pieces = engine.Motion(centre=self.path).pushes()
        return FrameForce.along(pieces) if max(np.abs(each[:, 1:]).max() for each in pieces) > AT_REST else None


def find_host_centre(potentials: Iterable[Potential]) -> HostCentre | None:
    """Return the centre of the host: that of its heaviest galaxy, which is all parts with one path.

    None if a part with mass has no `centre`: it is at the origin, which is then the centre of the host.
    """
    parts = list(potentials)
    if all(part.centre is None for part in parts):
        return None
    masses = np.nan_to_num([_mass(part) for part in parts])
    heavy = masses > MASSLESS * masses.max()
    if any(part.centre is None for part, has_mass in zip(parts, heavy, strict=True) if has_mass):
        return None
    paths = [part.motion().centre for part in parts]
    galaxies = [masses[[np.array_equal(path, other) for other in paths]].sum() for path in paths]
    return HostCentre(paths[int(np.argmax(np.where(heavy, galaxies, -np.inf)))]) if heavy.any() else None


def _mass(part: Potential) -> float:
    """Return the mass in Msun within 30 kpc of a part's own centre today."""
    with np.errstate(all="ignore"):
        return float(Total((part.model_copy(update={"centre": None}),)).mass_inside(np.array([WITHIN]))[0])
