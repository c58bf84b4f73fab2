"""A built-in rotating bar."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from streamkit import Angle, Coordinate, G, Length, Potential, Symbol, TotalMass, Unit, sqrt


class Bar(Potential):
    """Rotating bar: a needle of half-length a, softened by b and c as a Miyamoto-Nagai disc is (Long & Murali 1992).

    ``Phi = (G M / 2a) ln[(s - 2a) / (s + 2a)]``, s the sum of the distances from the needle's ends, each with
    ``b + sqrt(z^2 + c^2)`` in place of z. It is prolate with b = 0. A bar that slows down has a
    ``pattern_speed`` in time, or a pattern speed of 0 and an ``angle`` in time.
    Where the Sun is at x < 0 and moves towards y > 0 the Galaxy turns clockwise: the pattern speed is then negative,
    and the angle of a bar whose near end is 27 deg away from the Sun, at positive longitudes, is -27 deg.
    """

    kind = "bar"
    rates = {"pattern_speed": "angle"}
    example = {"mass": 1.0e10, "a": 3.5, "b": 0.5, "c": 0.6, "pattern_speed": -39.0, "angle": -27.0}
    reference = "Long & Murali 1992, ApJ 397, 44"

    mass: TotalMass
    a: Annotated[Length, Symbol("$a$")] = Field(description="Half-length.")
    b: Annotated[Coordinate, Symbol("$b$")] = Field(
        default=0.0, ge=0, description="Softening within the plane: the bar's thickness there."
    )
    c: Annotated[Length, Symbol("$c$")] = Field(description="Softening in height.")
    pattern_speed: Annotated[float, Unit("km/(s kpc)"), Symbol(r"$\Omega_{\rm b}$")] = Field(
        description="Pattern speed, positive from x towards y."
    )
    angle: Annotated[Angle, Symbol(r"$\phi_{\rm b}$")] = Field(
        default=0.0, description="Direction of the bar today, from x towards y."
    )

    @staticmethod
    def acceleration(
        x: Any, y: Any, z: Any, t: Any, mass: Any, a: Any, b: Any, c: Any, pattern_speed: Any, angle: Any
    ) -> Any:
        """Return minus the gradient of the potential."""
        # Cosine and sine of the angle at t as polynomials, so that the loop vectorises: of a quarter of the angle from
        # -pi to pi, then doubled twice.
        turns = (angle + pattern_speed * t) * 0.15915494309189535
        q = 1.5707963267948966 * (turns - np.floor(turns + 0.5))
        w = q * q
        cos = 1.0 + w * (-1 / 2 + w * (1 / 24 + w * (-1 / 720 + w * (1 / 40320 + w * (-1 / 3628800 + w * (
            1 / 479001600 - w / 87178291200))))))  # fmt: skip
        sin = q * (1.0 + w * (-1 / 6 + w * (1 / 120 + w * (-1 / 5040 + w * (1 / 362880 + w * (-1 / 39916800 + w * (
            1 / 6227020800 - w / 1307674368000)))))))  # fmt: skip
        cos, sin = cos * cos - sin * sin, 2.0 * sin * cos
        cos, sin = cos * cos - sin * sin, 2.0 * sin * cos
        along, across = cos * x + sin * y, cos * y - sin * x
        h = sqrt(z * z + c * c)
        d2 = across * across + (b + h) * (b + h)
        one, other = sqrt((along - a) * (along - a) + d2), sqrt((along + a) * (along + a) + d2)
        s = one + other
        k = -2.0 * G * mass / (one * other)
        f, g = k * along / s, k * s / (s * s - 4.0 * a * a)
        return cos * f - sin * g * across, sin * f + cos * g * across, g * z * (b + h) / h

    @staticmethod
    def potential(
        x: Any, y: Any, z: Any, t: Any, mass: Any, a: Any, b: Any, c: Any, pattern_speed: Any, angle: Any
    ) -> Any:
        """Return (G M / 2a) ln[(s - 2a) / (s + 2a)]."""
        cos, sin = np.cos(angle + pattern_speed * t), np.sin(angle + pattern_speed * t)
        along, across = cos * x + sin * y, cos * y - sin * x
        d2 = across**2 + (b + np.sqrt(z * z + c * c)) ** 2
        s = np.sqrt((along - a) ** 2 + d2) + np.sqrt((along + a) ** 2 + d2)
        return G * mass / (2 * a) * np.log((s - 2 * a) / (s + 2 * a))
