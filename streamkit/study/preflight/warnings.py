"""The warnings of a preflight: each names a cause of failing fits and its remedy."""

from __future__ import annotations

import contextlib
import io
from functools import reduce

import numpy as np

from streamkit.components import Component
from streamkit.errors import OutOfDomain
from streamkit.model import Host
from streamkit.runfile import ModelInputs, Spec, StreamInputs, Sun
from streamkit.study.preflight.draws import PriorDraws
from streamkit.study.preflight.orbit import HORIZON, OrbitSummary, summarise_orbit
from streamkit.testing import quick_failures

# Ranges that hold every recent measurement of the Sun's place and of the rotation there.
USUAL_SUN = {"r0": (7.0, 9.0, "kpc"), "z": (-0.1, 0.1, "kpc"), "v_circ": (180.0, 280.0, "km/s")}

FEWEST_PARTICLES = 100  # particles below which the remedy for rare streams is more of them
# A progenitor is not bound to a host whose circular speed is so many times smaller than its own speed; no galaxy has a
# circular speed above the limit in km/s.
SLOW_HOST, SPEED_LIMIT = 10.0, 2000.0


def orbit_warnings(spec: Spec, inputs: StreamInputs, orbit: OrbitSummary) -> list[str]:
    """Return the warnings about the progenitor's orbit as the source of a stream."""
    if len(orbit.apocentres) == 0:
        why = f"has no apocentre within the last {HORIZON:g} Gyr"
        if orbit.escapes:
            why = "is unbound: its energy is above the host's potential at infinity"
        hint = _swapped(spec, inputs.name) or _odd_host(inputs)
        return [f"The progenitor {why}, so there is no stream with apocentres.{hint}"]
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


def prior_warnings(spec: Spec, bound: ModelInputs, tried: PriorDraws | None) -> list[str]:
    """Return the warnings about a prior where streams are rare, or where some cost far more than most.

    ``bound`` is the run file at the prior's centre.
    """
    if tried is None:
        return []
    warnings = []
    good = len(tried.good)
    if good < 0.1 * tried.draws:
        warnings.append(
            f"Only {good} of {tried.draws} points drawn from the prior have a stream that can be measured: "
            f"the walkers will be hard to start. {_remedy(spec, bound, tried)}"
        )
    if good >= 8:
        middle, dear = np.percentile(tried.seconds, [50, 95])
        if dear > 5 * middle:
            warnings.append(
                f"Some points of the prior cost {dear / middle:.0f} times the usual call, and all walkers "
                "wait for the slowest."
            )
    return warnings


def _remedy(spec: Spec, bound: ModelInputs, tried: PriorDraws) -> str:
    """Return the likely reason why streams are rare, and the change that helps."""
    for name, inputs in bound.streams.items():
        if inputs.stripping.particles < FEWEST_PARTICLES:
            path = f"{spec.prefix(name)}stripping.particles"
            return f"{path} = {inputs.stripping.particles} is too few for any measurement: take some thousand."
    for inputs in bound.streams.values():
        if hint := _odd_host(inputs):
            return hint.strip()
    most, count = next(iter(tried.reasons.most_common(1)), ("", 0))
    why = f"Most often ({count} of {tried.draws}): {most}. " if most else ""
    return f"{why}Narrow the priors about streams that can be measured."


def _odd_host(inputs: StreamInputs) -> str:
    """Name the likely mistake in the units of a host that is far too light or too heavy; empty for another host."""
    radius, speed = (float(np.sqrt(x @ x)) for x in (inputs.q, inputs.v))
    circular = float(Host(inputs.potentials).circular_velocity(np.array([radius]))[0])
    if speed / SLOW_HOST < circular < max(SPEED_LIMIT, speed):
        return ""
    return (
        f" The host's circular speed is {circular:.3g} km/s at the progenitor's {radius:.3g} kpc, and the progenitor's "
        f"speed {speed:.3g} km/s. Is a speed in m/s, or the exponent of a mass wrong? Speeds are in km/s, masses in "
        "Msun, unless they have a unit."
    )


def sun_warnings(sun: Sun) -> list[str]:
    """Return the warnings about a position or motion of the Sun that no measurement supports."""
    values = {name: getattr(sun, name) for name in USUAL_SUN}
    return [
        f"sun.{name} = {values[name]:g} {unit}: measurements lie between {low:g} and {high:g} {unit}."
        for name, (low, high, unit) in USUAL_SUN.items()
        if not low <= values[name] <= high
    ]


def conformance_warnings(inputs: StreamInputs) -> list[str]:
    """Return a paragraph for each failure; what the components print meanwhile is dropped."""
    used: dict[str, Component] = {f"potential {name}": one for name, one in inputs.potentials.items()}
    used |= {f"body {name}": body.potential for name, body in inputs.bodies.items()}
    used |= {"progenitor": inputs.satellite, "stripping": inputs.stripping}
    failures = []
    for where, component in used.items():
        if not type(component).__module__.startswith("streamkit."):
            with contextlib.redirect_stdout(io.StringIO()), np.errstate(all="ignore"):
                lines = quick_failures(component)
            failures += [f"{where.removeprefix('potential ')} ({component.kind}): {line}" for line in lines]
    head = "A component of this run fails a conformance test, and its streams may be wrong. "
    return [f"{head}{line}. All tests: streamkit.testing.check." for line in failures]
