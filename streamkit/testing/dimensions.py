"""Checks of a potential's units: the mass by Gauss's law, dimensional analysis, the conversion of time."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
from pydantic import ValidationError

from streamkit import GYR, Array, G, Potential
from streamkit.testing.common import require
from streamkit.testing.reference import acceleration

# Factor on the right force -> what an author may have done.
LIKELY = {
    GYR**2: "it is in kpc/Gyr^2",
    GYR**-2: "it is converted from kpc/Gyr^2 the wrong way",
    GYR / 1e3: "it is in km/s/Myr",
    1e-3: "lengths are in parsec, or it is in (km/s)^2/pc",
    1e3: "lengths are in parsec, or it is in m",
    1e-6: "positions are read as parsec",
    1e6: "positions are read as parsec, or velocities are in m/s",
    1.0 / G: "G is missing",
    4 * math.pi: "a factor 4 pi is too many",
    0.25 / math.pi: "a factor 4 pi is missing",
}
OUTER = 1e5  # kpc: it contains every finite total mass, and ten times the scale mass of an NFW halo


def enclosed_mass(potential: Potential, r: Array, t: float = 0.0) -> Array:
    """(k,) Mass in Msun inside spheres of radii r (k,) in kpc: Gauss's law, by the mean radial force."""
    u, weights = np.polynomial.legendre.leggauss(24)
    angle = (np.arange(24) + 0.5) * np.pi / 12
    side = np.sqrt(1 - u**2)[:, None]
    n = np.stack([side * np.cos(angle), side * np.sin(angle), np.broadcast_to(u[:, None], (24, 24))]).reshape(3, -1)
    share = np.repeat(weights, 24) / 48
    mass = [-(x**2) / G * (share * (acceleration([potential], t, x * n) * n).sum(axis=0)).sum() for x in r]
    return np.array(mass)


def profile(potential: Potential) -> str:
    """Return M(<r) and v_c at a few radii, today and 1 Gyr ago, for the eye of its author."""
    radii = np.array([1.0, 8.0, 20.0, 50.0, 100.0, 200.0])
    lines = ["  r/kpc   M(<r)/Msun   v_c/(km/s)   M(<r)/Msun 1 Gyr ago"]
    now, then = enclosed_mass(potential, radii), enclosed_mass(potential, radii, -GYR)
    for r, m, before in zip(radii, now, then, strict=True):
        lines.append(f"  {r:5.0f}   {m:10.4g}   {np.sign(m) * math.sqrt(G * abs(m) / r):10.4g}   {before:10.4g}")
    return "\n".join(lines)


def mass_agrees_with_force(potential: Potential) -> None:
    """Check that M(<r) from the force has the size of the field ``mass``, if there is one."""
    unit = type(potential).parameters().get("mass")
    if unit is None or unit.name != "Msun":
        return
    mass = float(getattr(potential, "mass"))  # noqa: B009  a field of this class, not of all
    inside, outside = enclosed_mass(potential, np.array([1e3, OUTER])) / mass
    wrong = next((why for factor, why in LIKELY.items() if abs(outside / factor - 1) < 2e-3), "")
    finding = f"M(<1000 kpc) from the force is {inside:.4g} times the mass, and M(<{OUTER:g} kpc) {outside:.4g} times"
    require(
        not wrong and 0.02 < inside < 50,
        f"{finding}: the force must be in (km/s)^2/kpc for kpc, Msun and streamkit.G"
        + (f". Perhaps {wrong}" if wrong else ". If mass is no total mass, call the field something else"),
    )


def powers_of(unit: str) -> tuple[float, float]:
    """Return the powers of the length and of the mass in a unit, G being fixed: a time is L^(3/2) M^(-1/2)."""
    from astropy import units as u  # slow to import

    base = u.Unit(unit).decompose(bases=[u.kpc, u.Msun, u.Gyr, u.rad])
    power = {str(name): float(exponent) for name, exponent in zip(base.bases, base.powers, strict=True)}
    time = power.get("Gyr", 0.0)
    return power.get("kpc", 0.0) + 1.5 * time, power.get("solMass", 0.0) - 0.5 * time


HIDDEN = {
    "a length in kpc (Length)": (1, 0),
    "a mass in Msun (Mass)": (0, 1),
    "a speed in km/s (Speed)": (-0.5, 0.5),
    "a time (Duration; in acceleration it is in kpc/(km/s))": (1.5, -0.5),
    "one over a time (declare the time, a Duration, and divide by it; or Annotated[float, Unit(...)])": (-1.5, 0.5),
    "a density (Annotated[float, Unit('Msun/kpc3')])": (-3, 1),
    "a mass over a length (Annotated[float, Unit('Msun/kpc')], or a Speed)": (-1, 1),
}
# A description with a unit that no type has, such as km/s/kpc.
NAMED = re.compile(r"\b(kpc|pc|Mpc|km/s|km / s|Msun|Gyr|Myr|mas|deg|rad)\b")
LENGTH, MASS = 2.0, 3.0  # factors on the units of length and mass


def has_dimensions(potential: Potential) -> None:
    """Check, by another choice of units, that no field declared as a plain number is a length, a mass, ...

    A force with dimensional constants of its own, such as a table, is not homogeneous and cannot be looked at.
    """
    units = type(potential).parameters()
    values = [getattr(potential, name) for name in type(potential).model_fields]
    if not all(value is None or isinstance(value, float | int) for value in values):  # tables, text
        return
    if _homogeneous(potential, {}):
        return
    fields = type(potential).model_fields
    plain = [name for name, unit in units.items() if not unit.name and not NAMED.search(fields[name].description or "")]
    for name in plain:
        for what, powers in HIDDEN.items():
            require(
                not _homogeneous(potential, {name: powers}),
                f"the field {name} is declared as a plain number, and the force scales as if it were {what}. "
                "If no type has its unit, say the unit in the field's description",
            )


def _homogeneous(potential: Potential, assumed: dict[str, tuple[float, float]]) -> bool:
    """Return whether the force in other units is the same force, with the dimensions of some numbers assumed."""
    fields: dict[str, Any] = potential.model_dump()
    for name, unit in type(potential).parameters().items():
        length, mass = assumed.get(name, powers_of(unit.name))
        if fields[name] is not None:
            fields[name] = fields[name] * LENGTH**length * MASS**mass
    try:
        scaled = type(potential)(**fields)
    except ValidationError:  # a bound that is a length, say
        return not assumed
    rng = np.random.default_rng(7)
    q = rng.standard_normal((3, 40)) * np.geomspace(0.3, 100, 40)
    t = np.linspace(-5.0, 0.0, 40)
    here = acceleration([potential], t, q)
    there = acceleration([scaled], t * LENGTH**1.5 / MASS**0.5, q * LENGTH)
    return bool(np.allclose(there, here * MASS / LENGTH**2, rtol=1e-8, atol=0))


def time_is_not_converted_twice(potential: Potential) -> None:
    """Check that a force whose fields hold times does not convert Gyr itself: t and they come in one unit."""
    times = [name for name, unit in type(potential).parameters().items() if unit.name == "Gyr"]
    code = type(potential).acceleration.__code__
    numbers = [c for c in code.co_consts if isinstance(c, float) and c != 0]
    converts = "GYR" in code.co_names or any(abs(c * f - 1) < 2e-3 for c in numbers for f in (GYR, 1 / GYR))
    require(
        not (times and converts),
        f"acceleration converts with GYR, though t and {', '.join(times)} arrive in kpc/(km/s) alike: leave it out",
    )
