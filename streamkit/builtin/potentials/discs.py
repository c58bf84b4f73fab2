"""Built-in exponential discs, each as three Miyamoto-Nagai discs (Smith et al. 2015, MNRAS 448, 2934).

Smith et al. give two sets. One has a density that is positive everywhere (their table 2). The other is closer to the
exponential beyond five scale lengths, and negative farther out. The first set is used here, as in gala. The force in
the plane is that of the exponential disc to 1 per cent up to five scale lengths. Far out the three discs are 10 to 15
per cent heavier.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from streamkit import G, Length, Potential, Symbol, TotalMass, sqrt

# Smith et al., table 2: masses over that of the disc, as polynomials of b/rd, the highest power first.
MASSES = (
    (0.0036, -0.0330, 0.1117, -0.1335, 0.1749),
    (-0.0131, 0.1090, -0.3035, 0.2921, -5.7976),
    (-0.0048, 0.0454, -0.1425, 0.1012, 6.7120),
)
# Scale lengths over that of the disc, likewise.
LENGTHS = (
    (-0.0158, 0.0993, -0.2070, -0.7089, 0.6445),
    (-0.0319, 0.1514, -0.1279, -0.9325, 2.6836),
    (-0.0326, 0.1816, -0.2943, -0.6329, 2.3193),
)

DiscMass = Annotated[
    TotalMass, Field(description="Mass of the exponential disc: 2 pi rd^2 times its central surface density.")
]
ScaleLength = Annotated[Length, Symbol(r"$R_{\rm d}$"), Field(description="Scale length.")]


def _three_discs(c3: float, c2: float, c1: float) -> tuple[Any, Any]:
    """Return acceleration and potential, for b/rd = c3 h^3 + c2 h^2 + c1 h with h the scale height over rd."""

    def acceleration(x: Any, y: Any, z: Any, t: Any, mass: Any, rd: Any, height: Any) -> Any:  # noqa: ARG001
        """Return minus the gradient of the potential."""
        h = height / rd
        p = ((c3 * h + c2) * h + c1) * h
        b = p * rd
        s = sqrt(z * z + b * b)
        total, vertical = 0.0 * s, 0.0 * s
        for i in range(3):
            m, a = MASSES[i], LENGTHS[i]
            share = (((m[0] * p + m[1]) * p + m[2]) * p + m[3]) * p + m[4]
            scale = (((a[0] * p + a[1]) * p + a[2]) * p + a[3]) * p + a[4]
            d = scale * rd + s
            d2 = x * x + y * y + d * d
            k = -G * mass * share / (d2 * sqrt(d2))
            total = total + k
            vertical = vertical + k * d
        return total * x, total * y, vertical * z / s

    def potential(x: Any, y: Any, z: Any, t: Any, mass: Any, rd: Any, height: Any) -> Any:  # noqa: ARG001
        """Return the sum of -G M / sqrt(R^2 + (a + sqrt(z^2 + b^2))^2)."""
        p = np.polyval([c3, c2, c1, 0.0], height / rd)
        s = np.sqrt(z * z + (p * rd) ** 2)
        return sum(
            -G * mass * np.polyval(m, p) / np.sqrt(x * x + y * y + (np.polyval(a, p) * rd + s) ** 2)
            for m, a in zip(MASSES, LENGTHS, strict=True)
        )

    return acceleration, potential


# With the fits of b to the height of an exponential and of a sech^2 (Smith et al. 2015).
_EXPONENTIAL, _ISOTHERMAL = _three_discs(-0.269, 1.080, 1.092), _three_discs(-0.033, 0.262, 0.659)


class ExponentialDisc(Potential):
    """Double exponential disc, ``rho ~ exp(-R/rd - |z|/height)``, as three Miyamoto-Nagai discs.

    Within 1 per cent of it up to R = 5 rd, and up to 15 per cent heavier far out; for a height of up to 0.76 rd.
    """

    kind = "exponential_disc"
    example = {"mass": 4.0e10, "rd": 2.6, "height": 0.3}
    reference = "Smith et al. 2015, MNRAS 448, 2934"

    mass: DiscMass
    rd: ScaleLength
    height: Annotated[Length, Symbol("$h_z$")] = Field(description="Scale height of the vertical exponential.")

    acceleration: ClassVar[Any] = staticmethod(_EXPONENTIAL[0])
    potential: ClassVar[Any] = staticmethod(_EXPONENTIAL[1])


class Sech2Disc(Potential):
    """Exponential disc, isothermal in height: ``rho ~ exp(-R/rd) sech^2(z/height)``, as three Miyamoto-Nagai discs.

    The disc of gala's MilkyWayPotential2022. Up to 15 per cent heavier far out; for a height of up to 1.4 rd.
    """

    kind = "sech2_disc"
    example = {"mass": 4.7717e10, "rd": 2.6, "height": 0.3}
    reference = "Smith et al. 2015, MNRAS 448, 2934"

    mass: DiscMass
    rd: ScaleLength
    height: Annotated[Length, Symbol("$h_z$")] = Field(
        description="Scale height: the density falls as sech^2(z/height)."
    )

    acceleration: ClassVar[Any] = staticmethod(_ISOTHERMAL[0])
    potential: ClassVar[Any] = staticmethod(_ISOTHERMAL[1])
