"""Warnings about the progenitor itself: its size, its mass, and the frame of its coordinates."""

from __future__ import annotations

import numpy as np

from streamkit.model import Host
from streamkit.runfile import Body, Spec, StreamInputs
from streamkit.stream import sky_matrix
from streamkit.study.preflight.orbit import OrbitSummary

SAME_FRAME = 0.01  # degrees by which the axes of one frame may differ: papers print few digits


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
        turn = sky_matrix(frame) @ sky_matrix(other).T
        angle = float(np.degrees(np.arccos(np.clip(np.diag(turn).min(), -1.0, 1.0))))
        if angle > SAME_FRAME:
            prefix = spec.prefix(inputs.name)
            warnings.append(
                f"{prefix}progenitor.frame and the frame of {prefix}observable ({observable.kind}"
                f"{'' if len(inputs.observables) == 1 else ' ' + name}) differ, their axes by up to {angle:.3g} deg: "
                f"{_shown(frame)} and {_shown(other)}. phi1 = 0 of one is another place in the other. Give both the "
                "same frame, unless the two are meant."
            )
    return warnings


def _shown(frame: object) -> str:
    return repr(frame) if isinstance(frame, str) else "a frame of its own"
