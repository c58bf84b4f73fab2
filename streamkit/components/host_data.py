"""Data on the host alone, and the host as they see it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

from streamkit.components.bases import Measurement
from streamkit.stream import Array, Prediction


class HostView(Protocol):
    """The host today as `HostData` sees it, without the bodies that move about it."""

    @property
    def numbers(self) -> Mapping[str, float]:
        """The numbers of the run file that `HostData.reads` names, by their paths, in the units of the run file."""

    def circular_velocity(self, radii: Array) -> Array:
        """(n,) Circular velocity in km/s at radii (n,) in kpc in the plane."""

    def mass_inside(self, radii: Array) -> Array:
        """(n,) Mass in Msun inside radii (n,) in kpc."""

    def flattening(self, radii: Array, z: Array) -> Array:
        """(n,) Flattening of the potential at cylindrical radii and heights (n,) in kpc."""

    def acceleration(self, q: Array) -> Array:
        """(3, n) Acceleration in (km/s)^2/kpc at positions (3, n) in kpc."""

    def potential(self, q: Array) -> Array | None:
        """(n,) Potential in (km/s)^2 at positions (3, n) in kpc; None where a component gives none."""


class HostData(Measurement):
    """Data on the host alone, without a stream: a rotation curve, a mass, the prior of a derived number.

    streamkit calls `predict` once for each set of parameters, and compares the result (m,) with `data`. The host's
    numbers are in kpc, km/s and Msun. Where the host has no such number, `predict` returns a ``why_not``.
    """

    role: ClassVar[str] = "data"
    example_host: ClassVar[dict[str, float]] = {}
    """The numbers that `reads` names, of a host that the example can be compared with: the conformance tests use it."""

    def reads(self) -> Mapping[str, str]:
        """Return the numbers of the host that `predict` reads, by their paths in the run file, with their units.

        Such as ``{"potential.halo.mass": "Msun"}``; '' is the unit of a plain number. The sections are potential, body
        and sun. `predict` finds the numbers in ``host.numbers``, whether they are free or fixed. A run file without one
        of them is refused. Optional: data that ask for forces and masses of any host read none.
        """
        return {}

    def assumes(self) -> Mapping[str, Any]:
        """Return what the sections of the host must say besides: values by their paths, as `Spec.document` has them.

        Such as ``{"potential.halo.kind": "nfw", "sun.r0": "8.0 kpc"}``. A run file with another value is refused, and
        one where the number is free. So is one whose host has a section of which `assumes` and `reads` say nothing.
        Optional.
        """
        return {}

    @abstractmethod
    def predict(self, host: HostView) -> Prediction:
        """Return the numbers (m,) of the host, with zero variances if they are exact; a ``why_not`` without a value."""

    def at_edge(self, prediction: Prediction) -> bool:
        """Return whether a prediction is at the edge of the hosts that these data know of. Optional."""
        return False
