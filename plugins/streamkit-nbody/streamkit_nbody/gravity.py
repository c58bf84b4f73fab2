"""The gravity of the particles: a sum over all pairs, or the tree of pytreegrav, for arrays of shape (3, n)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from streamkit import Array, G
from streamkit.errors import StreamkitError

# Support of the cubic spline kernel per softening length: both have the central potential -G m / softening.
SUPPORT = 2.8
GROUP = 16  # neighbouring particles that share one walk of the tree
DIRECT = 1000  # largest number of particles for the sum over pairs in double precision
PAIRS = 20000  # the same in single precision: faster and more accurate than the tree, which takes long to compile


class NotFinite(StreamkitError):  # noqa: N818  it names the finding
    """A particle has left the numbers: a host without a force somewhere, or a step that is far too long."""


@dataclass(frozen=True)
class Gravity:
    """Forces between equal particles, softened by the cubic spline of Monaghan & Lattanzio 1985, A&A 149, 135."""

    mass: float  # mass of each particle, Msun
    softening: float  # Plummer-equivalent softening length, kpc; forces are exact beyond `SUPPORT` times as much
    theta: float  # opening angle of the tree; its nodes have quadrupoles
    workers: int = 1  # Threads. Each force is summed by one thread, in the same order for any number of them.

    def forces(self, q: Array) -> Array:
        """(3, n) accelerations in (km/s)^2/kpc of particles at q (3, n), with no net force."""
        return _without_net_force(self._evaluate(q, accel=True)["accel"])

    def forces_and_potential(self, q: Array) -> tuple[Array, Array]:
        """Return the accelerations (3, n) and the potentials (n,) in (km/s)^2, from one walk."""
        values = self._evaluate(q, accel=True, potential=True)
        return _without_net_force(values["accel"]), values["potential"]

    def potential(self, q: Array) -> Array:
        """(n,) Potentials in (km/s)^2 of particles at q (3, n)."""
        return self._evaluate(q, potential=True)["potential"]

    def _evaluate(self, q: Array, *, accel: bool = False, potential: bool = False) -> dict[str, Array]:
        """Return accelerations (n, 3), potentials (n,), or both. Raises NotFinite if a position is not finite."""
        import numba
        from pytreegrav import frontend  # type: ignore[import-untyped]  # slow to import

        n = q.shape[1]
        if not np.isfinite(q).all():
            lost = int((~np.isfinite(q).all(axis=0)).sum())
            raise NotFinite(
                f"the positions of {lost} of {n} particles are not finite: either the host has no force somewhere on "
                "their way, or the step is far too long"
            )
        particles = np.ascontiguousarray(q.T), np.full(n, self.mass), np.full(n, SUPPORT * self.softening)
        if n <= DIRECT:
            wanted: dict[str, Any] = {}
            if accel:
                wanted["accel"] = frontend.Accel(*particles, G=G, method="bruteforce")
            if potential:
                wanted["potential"] = frontend.Potential(*particles, G=G, method="bruteforce")
            return wanted
        if n <= PAIRS:
            return self._over_pairs(q, accel, potential)
        numba.set_num_threads(self.workers)
        tree = frontend.Field(
            *particles, G=G, theta=self.theta, quadrupole=True, group_size=GROUP, parallel=self.workers > 1
        )
        return dict(tree.evaluate(accel=accel, potential=potential))

    def _over_pairs(self, q: Array, accel: bool, potential: bool) -> dict[str, Array]:
        """Return accelerations, potentials, or both by a sum over all pairs in single precision, accurate to 1e-6."""
        from streamkit_nbody.pairs import sum_accelerations, sum_potentials

        unit, support, wanted = G * self.mass, SUPPORT * self.softening, {}
        if accel:
            wanted["accel"] = unit * sum_accelerations(q, support, self.workers).T
        if potential:
            wanted["potential"] = unit * sum_potentials(q, support, self.workers)
        return wanted


def _without_net_force(accelerations: Array) -> Array:
    """(3, n) The accelerations (n, 3) of equal particles without their mean.

    A force from a node has no reaction, so a tree's forces do not quite add up to nothing. What is left, some 1e-5 of
    the mean force, would push the satellite off its orbit over some Gyr.
    """
    return np.ascontiguousarray((accelerations - accelerations.mean(axis=0)).T)
