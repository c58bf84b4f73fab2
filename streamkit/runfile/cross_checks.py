"""Checks across sections: drag and integrator, number of steps, masses of the progenitor and of bodies."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from streamkit.components import Component, Integrator, Potential, total_mass
from streamkit.errors import StreamkitError
from streamkit.runfile.encounter import ENCOUNTER
from streamkit.runfile.progenitor import Place
from streamkit.runfile.section import Section
from streamkit.runfile.sections import StreamSections
from streamkit.units import Unit

# Largest number of steps of a particle: ten particles in the fastest host would take seconds.
MOST_STEPS = 1e7


def drag_unknown(
    potentials: Iterable[Section[Any]], integrator: type[Integrator], installed: Mapping[str, Any]
) -> list[str]:
    """Return a sentence for each part of a host with a drag that the integrator does not support.

    ``installed`` are the registry's entries of integrators.
    """
    if integrator.drag:
        return []
    able = ", ".join(sorted(kind for kind, entry in installed.items() if getattr(entry.cls, "drag", False)))
    return [
        f"integrator: {integrator.kind!r} does not support forces that depend on velocity, and {section.path} "
        f"({section.cls.kind!r}) has one; these support it: {able}"
        for section in potentials
        if section.cls.has_drag()
    ]


def unfit_for_lookback(
    potentials: Iterable[Section[Potential]], integrator: Section[Integrator], streams: Iterable[StreamSections]
) -> list[str]:
    """Return a sentence for each field that makes too many steps, and each part of the host that is not known so long.

    The longest look-back time counts.
    """
    path, longest = max((stream.lookback for stream in streams), key=lambda pair: pair[1], default=("", 0.0))
    return [
        *_too_many_steps(integrator, path, longest),
        *(error for section in potentials for error in _not_covered(section, path, longest)),
    ]


def _too_many_steps(integrator: Section[Integrator], path: str, longest: float) -> list[str]:
    return [
        f"{integrator.path}.{name}: found {getattr(integrator.centre, name):g}, with which a particle would take about "
        f"{count:.2g} steps over the {longest:g} Gyr of {path}; expected at most {MOST_STEPS:.0e}"
        for name, count in integrator.centre.steps(longest).items()
        if count > MOST_STEPS
    ]


def _not_covered(section: Section[Potential], path: str, longest: float) -> list[str]:
    potential, kind = section.centre, section.cls.kind
    centre = potential.centre["t"] if potential.centre is not None and potential.drifts else None
    known = (section.path, f"the {kind}", potential.known_times()), (f"{section.path}.centre", "it", centre)
    return [
        f"{place}: {what} is known from {times[0]:g} to {times[-1]:g} Gyr; expected all times from {-longest:g} Gyr, "
        f"where {path} begins, to 0, today"
        for place, what, times in known
        if times is not None and not (times[0] <= -longest and times[-1] >= 0.0)
    ]


def no_part_of_a_host(path: str, cls: type[Potential]) -> str:
    """Return the reason why a potential cannot be a progenitor or a body; an empty text if it can."""
    if cls.has_drag():
        return f"{path}.kind: {cls.kind!r} has a force that depends on velocity, which only the host may have"
    if cls.asks_for_host():
        return f"{path}.kind: {cls.kind!r} depends on the other parts of the host, so it can only be one of them"
    return ""


def varies(cls: type[Component]) -> bool:
    """Return whether the fields of a component depend on its section."""
    return cls.for_section.__func__ is not Component.for_section.__func__  # type: ignore[attr-defined]


def massless(path: str, cls: type[Potential], potential: Section[Potential] | None, progenitor: bool) -> str:
    """Return the reason why the potential of a progenitor or a body has no mass; an empty text if it has one.

    ``potential`` is None where its fields could not be read, or depend on the section.
    """
    of_its_own = cls.parameters().get("mass", Unit("")).name == "Msun"
    try:
        if of_its_own or (varies(cls) if potential is None else not np.isnan(total_mass(potential.centre))):
            return ""
    except StreamkitError as error:
        return f"{path}: {error}"
    what = f"{path}.kind: the potential {cls.kind!r} has no field 'mass' in Msun"
    what += ", and its force " + ("gives an infinite mass" if potential else "could not be computed")
    return f"{what}; " + (
        "the tidal radius of a progenitor needs a mass, plummer has one"
        if progenitor
        else "a body needs a mass, hernquist has one"
    )


def own_keys(table: Mapping[str, Any], ways: Sequence[type[Place]]) -> dict[str, Any]:
    """Return the keys of a section that belong to its potential: without the kind and the coordinates."""
    whole = [way for way in ways if set(way.coordinates()) <= table.keys()] or ways
    taken = {"kind", ENCOUNTER, *(name for way in whole for name in way.model_fields)}
    return {key: value for key, value in table.items() if key not in taken}
