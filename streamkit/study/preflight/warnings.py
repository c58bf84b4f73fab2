"""The warnings of a preflight: each names a cause of failing fits and its remedy."""

from __future__ import annotations

import contextlib
import io
from functools import reduce

import numpy as np

from streamkit.components import Component, HostCentre, LiveStripping, Total
from streamkit.errors import OutOfDomain
from streamkit.model import Host
from streamkit.runfile import Body, ModelInputs, Spec, StreamInputs, Sun
from streamkit.stream import Stream, sky_matrix
from streamkit.study.preflight.draws import PriorDraws
from streamkit.study.preflight.header_warnings import SAME_FRAME, angle_between, header_warnings, unread_warnings
from streamkit.study.preflight.orbit import HORIZON, OrbitSummary, summarise_orbit
from streamkit.study.preflight.size_warnings import size_warnings
from streamkit.testing import quick_failures

# Ranges that contain all recent measurements of the Sun's position and of the rotation speed there.
USUAL_SUN = {"r0": (7.0, 9.0, "kpc"), "z": (-0.1, 0.1, "kpc"), "v_circ": (180.0, 280.0, "km/s")}

LOGS = 1.0, 20.0  # Msun: a mass between them is more likely a decimal logarithm of one
RARE = 0.1  # share of the points of a prior that have a stream, below which a sampler is hard to start
FEWEST_PARTICLES = 100  # with fewer particles the remedy for rare streams is more of them
# A progenitor is not bound if its speed is more than so many times the host's circular speed. No galaxy has a circular
# speed above the limit in km/s.
SLOW_HOST, SPEED_LIMIT = 10.0, 2000.0
PULLS = 1e-3  # mass of a body that moves its host, in units of the host's mass within `WITHIN` kpc
WITHIN = 30.0
LIFT = "uniform_acceleration"  # kind of the part that is the acceleration of the frame
OFF_CENTRE = 0.1  # distance of a galaxy's centre from the origin, in units of the progenitor's distance from it
DISSOLVED = 0.01  # share of a progenitor's mass, bound today, below which it has dissolved
FEW = 300.0  # smallest effective number of particles of a live progenitor, by their weights


def stream_warnings(spec: Spec, inputs: StreamInputs, orbit: OrbitSummary) -> list[str]:
    """Return the warnings about one stream: its orbit, its progenitor, its frames and its stripping scheme."""
    about_orbit, about_progenitor = orbit_warnings(spec, inputs, orbit), progenitor_warnings(inputs, orbit)
    about_frames = (
        frame_warnings(spec, inputs)
        + header_warnings(spec, inputs)
        + unread_warnings(spec, inputs)
        + origin_warnings(spec, inputs)
    )
    return [*about_orbit, *about_progenitor, *about_frames, *size_warnings(inputs, orbit), *live_warnings(spec, inputs)]


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
    """Advise a longer look-back time if the present one covers fewer than two apocentres of an orbit that has more."""
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


def progenitor_warnings(inputs: StreamInputs, orbit: OrbitSummary) -> list[str]:
    """Return the warnings about a progenitor that is too large or too heavy for a stream."""
    warnings = []
    body = Body(inputs.satellite, inputs.q, inputs.v)
    size, (least, largest) = body.extent, orbit.r_tidal
    if np.isfinite(largest) and size > largest:
        shown = f"{least:.3g} to {largest:.3g} kpc"
        warnings.append(
            f"The progenitor is larger than its tidal radius: its scale radius is {size:.3g} kpc, and its tidal radius "
            f"{shown}. It is not bound, and no stream of it is realistic.{_slip(size, inputs.mass, least)}"
        )
    here = float(np.sqrt(inputs.q @ inputs.q))
    radius = max([here, *orbit.apocentres.tolist()])
    host = float(Host(inputs.potentials).mass_inside(np.array([radius]))[0])
    if inputs.mass > host:
        warnings.append(
            f"The progenitor is heavier than its host: {inputs.mass:.3g} Msun, and the host has {max(host, 0.0):.3g} "
            f"Msun inside {radius:.3g} kpc, the farthest that the progenitor gets. Check the exponent of "
            "progenitor.mass, and the units of the potential."
        )
    return warnings


def _slip(size: float, mass: float, tidal: float) -> str:
    """Return the likely mistake in a size in kpc or a mass in Msun, for a tidal radius in kpc."""
    if LOGS[0] <= mass < LOGS[1]:
        return f" Is its mass, {mass:.3g} Msun, a logarithm? Masses are in Msun, such as 1e4."
    if size / 1000 <= tidal:
        return f" Is the radius in pc? Write it with its unit, such as '{size:.3g} pc'."
    return f" Check the radius, and the exponent of the mass, {mass:.3g} Msun."


def frame_warnings(spec: Spec, inputs: StreamInputs) -> list[str]:
    """Return a warning for each observable whose frame differs from that of the progenitor's phi1 and phi2."""
    frame = getattr(spec.sections.streams[inputs.name].phase.centre, "frame", None)
    if frame is None:
        return []
    warnings = []
    for name, observable in inputs.observables.items():
        other = observable.sky_frame()
        if other is None:
            continue
        angle = angle_between(sky_matrix(frame), sky_matrix(other))
        if angle > SAME_FRAME:
            prefix = spec.prefix(inputs.name)
            warnings.append(
                f"{prefix}progenitor.frame and the frame of {prefix}observable ({observable.kind}"
                f"{'' if len(inputs.observables) == 1 else ' ' + name}) differ, their axes by up to {angle:.3g} deg: "
                f"{_shown(frame)} and {_shown(other)}. phi1 = 0 of one is another place in the other. Give both the "
                "same frame, unless the two are meant."
            )
    return warnings


def origin_warnings(spec: Spec, inputs: StreamInputs) -> list[str]:
    """Return a warning about a galaxy that leaves the host's centre, if it is the one that holds the progenitor today.

    It is the part of the host, among those that are elsewhere, that pulls the progenitor most, and more than all other
    parts together. Steps, tidal radii and apocentres are measured from the host's centre: see `find_host_centre`.
    """
    own = {name: p for name, p in inputs.potentials.items() if len(p.motion().centre)}
    if not own:
        return []
    place = inputs.q[:, None]
    pull = {name: float(np.linalg.norm(Total((p,)).acceleration(place))) for name, p in own.items()}
    name = max(pull, key=lambda one: pull[one])
    rest = Total(tuple(p for p in inputs.potentials.values() if p is not own[name]))
    if pull[name] <= float(np.linalg.norm(rest.acceleration(place))):
        return []
    path = HostCentre(own[name].motion().centre)
    (away, ago), here = path.farthest(inputs.lookback), float(np.linalg.norm(inputs.q - path.today[0]))
    if away <= OFF_CENTRE * here:
        return []
    where, why, remedy = (
        "the origin", "Other parts have no centre, and", "If they belong to the same galaxy, give them the same centre."
    ) if spec.sections.host_centre is None else (
        "the centre of the host",
        "The host is the galaxy with most mass within 30 kpc of its centre, and",
        "Make a run file in which this galaxy is at the origin: subtract its centre from all others, and give minus "
        "its acceleration by a part of the kind 'uniform_acceleration'.",
    )  # fmt: skip
    return [
        f"potential.{name}.centre is up to {away:.3g} kpc from {where}, {ago:.3g} Gyr ago, "
        f"and the progenitor is {here:.3g} kpc from that centre today. {why} the steps of the integrator, tidal radii "
        f"and apocentres are measured from {where}: steps may be too long, and the other two are wrong. {remedy}"
    ]


def moved_twice_warnings(spec: Spec, bound: ModelInputs) -> list[str]:
    """Return a warning where the host's own motion is given, and a body or a progenitor pulls the host too.

    Its motion is a path or a uniform acceleration. ``bound`` is the run file at the prior's centre. A path without
    acceleration moves nothing twice, see `HostCentre`.
    """
    sections, centre = spec.sections, spec.sections.host_centre
    given = []
    if centre is not None and centre.force is not None:
        given += [
            f"{section.path}.centre"
            for section in sections.potentials.values()
            if section.centre.centre is not None
            and not len(section.centre.motion().centre)  # seen from the host's centre, it is at rest
        ]
    for name, section in sections.potentials.items():
        part = bound.potentials[name]
        if part.kind == LIFT and (section.priors or part.changes() or any(part.in_engine_units())):
            given.append(section.path)
    least = PULLS * float(Host(bound.potentials).mass_inside(np.array([WITHIN]))[0]) if given else 0.0
    bodies = (name.partition(",")[0] for name, body in bound.bodies.items() if body.reflex and body.mass > least)
    moving = [sections.bodies[name][0].path for name in dict.fromkeys(bodies)]
    streams = bound.streams.items()
    moving += [sections.streams[name].phase.path for name, each in streams if each.reflex and each.mass > least]
    if not given or not moving:
        return []
    return [
        f"The motion of the host is given ({' and '.join(given)}), and the host is moved by the pull of "
        f"{' and '.join(moving)} too. If its motion is that of a simulation with the same body, the pull on the host "
        f"counts twice: leave out {' and '.join(given)}, or set "
        f"{' and '.join(f'{path}.reflex' for path in moving)} = false."
    ]


def _shown(frame: object) -> str:
    return repr(frame) if isinstance(frame, str) else "a frame of its own"


def live_warnings(spec: Spec, inputs: StreamInputs) -> list[str]:
    """Return the warnings about the stripping scheme and the data, and about the start of a live progenitor."""
    prefix, scheme = spec.prefix(inputs.name), inputs.stripping
    if isinstance(scheme, LiveStripping):
        path = f"{prefix}progenitor.lookback"
        if scheme.passages is not None or path not in spec.names:
            return []
        return [
            f"{path} is free, and ln L of a live progenitor has a step where it passes an apocentre. Give "
            f"{prefix}stripping.passages, make a fit for each number of passages, and compare their ln L."
        ]
    return [
        f"The observable {name} ({observable.kind}) depends on the rate at which debris leaves. "
        f"{prefix}stripping.kind = '{scheme.kind}' assumes a rate: its densities differ from those of live satellites "
        "by factors of 2 to 7. Choose the kind 'restricted_nbody'."
        for name, observable in inputs.observables.items()
        if observable.wants_live
    ]


def weight_warnings(spec: Spec, inputs: StreamInputs, stream: Stream) -> list[str]:
    """Return a warning where few particles represent most stars of a live progenitor, or of its debris."""
    if not isinstance(inputs.stripping, LiveStripping):
        return []
    for which, weight in (("those that have left it", stream.weight[~stream.bound]), ("all of them", stream.weight)):
        if not weight.any():
            continue
        worth = weight.sum() ** 2 / (weight**2).sum()  # Kish 1965
        if worth < min(FEW, 0.5 * len(weight)):
            return [
                f"Few particles of the progenitor stand for most of its stars: by their weights, {which} "
                f"({len(weight)}) are worth {worth:.0f} equal ones, and have the noise of so few. Raise "
                f"{spec.prefix(inputs.name)}stripping.particles."
            ]
    return []


def dissolved_warnings(spec: Spec, inputs: StreamInputs, stream: Stream) -> list[str]:
    """Return a warning where a live progenitor dissolves before today."""
    if not isinstance(inputs.stripping, LiveStripping) or stream.bound_share >= DISSOLVED:
        return []
    prefix = spec.prefix(inputs.name)
    return [
        f"The progenitor dissolves before today: {100 * stream.bound_share:.2g} % of its mass is bound to it. If there "
        f"is one on the sky, raise {prefix}progenitor.mass, or lower its radius or {prefix}progenitor.lookback."
    ]


def prior_warnings(spec: Spec, bound: ModelInputs, tried: PriorDraws | None) -> list[str]:
    """Return the warnings about a prior where streams are rare, or where a few streams cost far more than most.

    ``bound`` is the run file at the prior's centre.
    """
    if tried is None:
        return []
    warnings = []
    good, names = len(tried.good), list(bound.streams)
    if len(names) > 1 and spec.sampler.emulates:  # which starts with each stream alone
        warnings += [
            f"{name}: Only {count} of {tried.draws} points drawn from the prior have a stream that can be measured: "
            f"its emulator will be hard to start. {_remedy(spec, bound, tried, name)}"
            for name in names
            if (count := tried.measured(name)) < RARE * tried.draws
        ]
    elif good < RARE * tried.draws:
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


def _remedy(spec: Spec, bound: ModelInputs, tried: PriorDraws, stream: str = "") -> str:
    """Return the likely reason why streams, or those of one name, are rare, and the change that helps."""
    streams = {name: inputs for name, inputs in bound.streams.items() if stream in ("", name)}
    for name, inputs in streams.items():
        if inputs.stripping.particles < FEWEST_PARTICLES:
            path = f"{spec.prefix(name)}stripping.particles"
            return f"{path} = {inputs.stripping.particles} is too few for any measurement: take some thousand."
    if mass_warnings(spec, bound):
        return "The mass named above is the likely reason."
    for inputs in streams.values():
        if hint := _odd_host(inputs):
            return hint.strip()
    reasons = ((why, n) for why, n in tried.reasons.most_common() if why.startswith(f"{stream}: ") or not stream)
    most, count = next(reasons, ("", 0))
    why = f"Most often ({count} of {tried.draws}): {most}. " if most else ""
    return f"{why}Narrow the priors about streams that can be measured."


def mass_warnings(spec: Spec, bound: ModelInputs) -> list[str]:
    """Return a warning for each free mass that is as small as the logarithm of one, at the prior's centre."""
    masses = (name for name, unit in zip(spec.names, spec.units, strict=True) if unit == "Msun")
    return [
        f"{name} = {bound.values[name]:.3g} Msun at the prior's centre: is that a logarithm? Masses are in Msun; a "
        "prior that is even in the logarithm is log_uniform = [1e11, 1e12]."
        for name in masses
        if LOGS[0] <= bound.values[name] < LOGS[1]
    ]


def _odd_host(inputs: StreamInputs) -> str:
    """Return the likely mistake in the units of a host that is far too light or too heavy; empty for any other host."""
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
