"""The force of a live progenitor: a sphere, given by the mass in its shells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, ClassVar

import numpy as np

from streamkit import engine
from streamkit.elementary import sqrt
from streamkit.stream import Array
from streamkit.units import G

DEGREE = 8  # degree of the polynomial that approximates the mass in the shells
SHELLS = 64  # number of shells of the mass, equal in d^2 / (d^2 + b^2)
INNERMOST_WEIGHT, TOTAL_WEIGHT = 0.3, 5.0  # weights in the fit: the first shell has few particles, the last all mass
EDGES = np.arange(1, SHELLS + 1) / SHELLS  # d^2 / (d^2 + b^2) at the outer edges of the shells
ODD = 2 * np.arange(DEGREE + 1) + 1  # exponents of s = (d^2 + b^2)^(-1/2) in the potential


@dataclass(frozen=True, eq=False)
class Monopole:
    """A sphere whose force is a Plummer sphere's, or a cusp's, times a polynomial in y = b^2 / (d^2 + b^2).

    The force is ``-G F(y) d / [(d^2 + b^2) (d^2 + e^2)^(1/2)]`` with e = b without a cusp, and with a small e for a
    cusp. For a Plummer sphere, and for a sphere with an inner density r^-1, F is then its first coefficient alone. The
    engine has compiled code for this force: another one in each block of time costs nothing. It is no component of a
    run file.

    Attributes
    ----------
    sphere
        (11,) the coefficients c_0 ... c_8 of F in Msun, b and e in kpc.
    """

    sphere: Array
    kind: ClassVar[str] = "monopole"
    compiled: ClassVar[bool] = True

    @property
    def b(self) -> float:
        """The scale radius in kpc."""
        return float(self.sphere[-2])

    @property
    def e(self) -> float:
        """The softening of the cusp in kpc; b without a cusp."""
        return float(self.sphere[-1])

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, c0: Any, c1: Any, c2: Any, c3: Any, c4: Any, c5: Any, c6: Any,
                     c7: Any, c8: Any, b: Any, e: Any) -> Any:  # fmt: skip
        """Return the force; one division and one root serve both factors."""
        d2 = x * x + y * y + z * z
        wide, narrow = d2 + b * b, d2 + e * e
        inverse = 1.0 / (wide * narrow)
        u = b * b * narrow * inverse
        f = c0 + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * (c5 + u * (c6 + u * (c7 + u * c8)))))))
        k = -G * f * sqrt(narrow) * inverse
        return k * x, k * y, k * z

    @staticmethod
    def drag(x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any, t: Any, *parameters: Any) -> Any:
        """Return no force: no part depends on velocity."""
        return 0.0, 0.0, 0.0

    @classmethod
    def has_drag(cls) -> bool:
        """Return False: no part depends on velocity."""
        return False

    def in_engine_units(self) -> tuple[Any, ...]:
        """Return the arguments of `acceleration` after t."""
        return tuple(self.sphere.tolist())

    def changes(self) -> tuple[()]:
        """Return nothing: the force does not change within a block."""
        return ()

    def rotation(self) -> None:
        """Return None: a sphere has no axes."""

    @property
    def drifts(self) -> bool:
        """Return False: see `motion`."""
        return False

    def motion(self) -> engine.Motion:
        """Return none: a progenitor moves along its orbit."""
        return engine.Motion()

    def in_loop(self) -> Monopole:
        """Return itself."""
        return self

    @classmethod
    def of_shells(cls, inside: Array, b: float, e: float) -> Monopole:
        """Return the sphere of masses (64,) in Msun inside d^2 = b^2 k / (64 - k), k from 1 to 64, by least squares."""
        return cls(np.array([*(_fit()[0] @ (inside / _shape(b, e))), b, e]))

    @cached_property
    def depth(self) -> Array:
        """(9,) Coefficients of its potential, as `engine.bound_shells` takes them: exact if e = b, else fitted."""
        c = self.sphere[: DEGREE + 1]
        if self.e == self.b:
            return np.asarray(c / ODD)
        matrix, powers = _fit()
        pull = powers @ c * _shape(self.b, self.e) / EDGES**1.5  # d Phi / ds over -G, with s = (d^2 + b^2)^(-1/2)
        s = np.sqrt(1 - EDGES)  # in units of 1 / b
        steps = 0.5 * (pull[1:] + pull[:-1]) * (s[:-1] - s[1:])
        depth = np.cumsum(steps[::-1])[::-1]
        return np.asarray(matrix @ np.append(depth / s[:-1], pull[-1]))


@cache
def _fit() -> tuple[Array, Array]:
    """(9, 64) least-squares matrix from the polynomial's values at `EDGES` to coefficients; and (64, 9) back."""
    powers = np.vander(1 - EDGES, DEGREE + 1, increasing=True)
    weight = np.ones(SHELLS)
    weight[0], weight[-1] = INNERMOST_WEIGHT, TOTAL_WEIGHT
    return np.linalg.pinv(powers * weight[:, None]) * weight, powers


@cache
def _shape(b: float, e: float) -> Array:
    """(64,) Ratio of mass and polynomial at `EDGES`, the last of which is infinity, with the ratio 1."""
    softened = np.sqrt(EDGES + (1 - EDGES) * (e / b) ** 2)  # (d^2 + e^2)^(1/2) / (d^2 + b^2)^(1/2)
    return np.asarray(EDGES**1.5 / softened)
