"""The warnings of a preflight: each names a cause of failing fits and its remedy."""

from __future__ import annotations

from functools import reduce

import numpy as np

from streamkit.errors import OutOfDomain
from streamkit.runfile import Spec, StreamInputs, Sun
from streamkit.study.preflight.draws import PriorDraws
from streamkit.study.preflight.orbit import HORIZON, OrbitSummary, summarise_orbit

# Ranges that hold every recent measurement of the Sun's place and of the rotation there.
USUAL_SUN = {"r0": (7.0, 9.0, "kpc"), "z": (-0.1, 0.1, "kpc"), "v_circ": (180.0, 280.0, "km/s")}


def orbit_warnings(spec: Spec, inputs: StreamInputs, orbit: OrbitSummary) -> list[str]:
    """Return the warnings about the progenitor's orbit as the source of a stream."""
    if len(orbit.apocentres) == 0:
        why = f"has no apocentre within the last {HORIZON:g} Gyr"
        if orbit.escapes:
            why = "is unbound: its energy is above the host's potential at infinity"
        return [f"The progenitor {why}, so there is no stream with apocentres.{_swapped(spec, inputs.name)}"]
    checks = [
        (not orbit.returns, "The progenitor has no apocentre in the next 6 Gyr: the leading arm cannot be measured."),
        (
            inputs.lookback < orbit.period,
            f"The look-back time, {inputs.lookback:.3g} Gyr, is shorter than the radial period, "
            f"{orbit.period:.3g} Gyr: the arms have not grown. Raise progenitor.lookback.",
        ),
        (
            inputs.lookback > HORIZON,
            f"The look-back time, {inputs.lookback:.3g} Gyr, exceeds the age of the Universe, {HORIZON:g} Gyr. "
            "Lower progenitor.lookback.",
        ),
        (
            np.isnan(orbit.r_tidal[0]),
            "The progenitor has no tidal radius somewhere on its track (Omega^2 <= d2Phi/dr2).",
        ),
    ]
    return [text for applies, text in checks if applies]


def short_lookback(orbit: OrbitSummary) -> str:
    """Advise a longer look-back time if it covers fewer than two apocentres of an orbit that has more."""
    if orbit.completed >= min(2, len(orbit.apocentres)):
        return ""
    covered = f"{orbit.completed} apocentre{'s' * (orbit.completed != 1)}"
    return f" The look-back time covers {covered} of the progenitor. Raise progenitor.lookback."


def _swapped(spec: Spec, stream: str) -> str:
    """Advise to exchange the two proper motions if that makes the orbit bound."""
    path = f"{spec.prefix(stream)}progenitor"
    section = reduce(dict.__getitem__, path.split("."), spec.document)
    names = [name for name in section if name.startswith("pm_")]
    if len(names) != 2:
        return ""
    pair = [f"{path}.{name}" for name in names]
    first, second = (section[name] for name in names)
    other = spec.with_values({pair[0]: second, pair[1]: first})
    try:
        turned = summarise_orbit(other.bind(other.centre(), stream))
    except OutOfDomain:
        return ""
    if len(turned.apocentres) == 0 or turned.escapes:
        return ""
    ends = f"{turned.pericentres[0]:.3g} to {turned.apocentres[0]:.3g} kpc"
    return (
        f" Are the two proper motions swapped? With {pair[0]} and {pair[1]} exchanged, the orbit is bound "
        f"and runs from {ends}."
    )


def prior_warnings(tried: PriorDraws | None) -> list[str]:
    """Return the warnings about a prior where streams are rare, or where some cost far more than most."""
    if tried is None:
        return []
    warnings = []
    good = len(tried.good)
    if good < 0.1 * tried.draws:
        warnings.append(
            f"Only {good} of {tried.draws} points drawn from the prior have a stream that can be measured: "
            "the walkers will be hard to start. Narrow the priors."
        )
    if good >= 8:
        middle, dear = np.percentile(tried.seconds, [50, 95])
        if dear > 5 * middle:
            warnings.append(
                f"Some points of the prior cost {dear / middle:.0f} times the usual call, and all walkers "
                "wait for the slowest."
            )
    return warnings


def sun_warnings(sun: Sun) -> list[str]:
    """Return the warnings about a position or motion of the Sun that no measurement supports."""
    values = {name: getattr(sun, name) for name in USUAL_SUN}
    return [
        f"sun.{name} = {values[name]:g} {unit}: measurements lie between {low:g} and {high:g} {unit}."
        for name, (low, high, unit) in USUAL_SUN.items()
        if not low <= values[name] <= high
    ]
