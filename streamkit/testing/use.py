"""One use of a component of any role, and what follows from repeating it: no hidden state, nothing printed."""

from __future__ import annotations

import numpy as np
from pydantic import ValidationError

import streamkit as sk
from streamkit.engine import build_field
from streamkit.testing import live, stripping
from streamkit.testing.common import require
from streamkit.testing.contained import printed
from streamkit.testing.host_data import FlattenedHost
from streamkit.testing.hosts import MASS, Isochrone, swarm
from streamkit.testing.reference import acceleration, drag
from streamkit.testing.streams import example_stream, select


def use(component: sk.Component, seed: int = 1) -> sk.Array:
    """Return what a component gives for one input: an acceleration, a release, a step, a measurement."""
    rng = np.random.default_rng(seed)
    if isinstance(component, sk.Potential):
        q = rng.standard_normal((3, 50)) * np.geomspace(1.0, 100.0, 50)
        t = np.linspace(-5.0, 0.0, 50)
        return acceleration([component], t, q) + drag([component], t, q, 10 * q)
    if isinstance(component, sk.Stripping):
        orbit, tail, normals = stripping.case(component, 50, seed)
        release = component.release(orbit, tail, MASS, normals)
        return np.concatenate([release.q, release.v])
    if isinstance(component, sk.LiveStripping):
        core, sphere = live.core_of_start(), live.PlummerSphere()
        people = component.populate(core, sphere, rng.random((component.draws, 50)))
        left = component.update_remnant(live.first_edge(people, core), sphere, None)
        return np.concatenate([people.q, people.v, np.array([left.bound, np.full(50, left.mass)])])
    if isinstance(component, sk.Integrator):
        q, v = swarm(7, seed)
        component.advance(build_field([Isochrone()]), q, v, np.zeros(7), 0.02 * sk.GYR)
        return np.concatenate([q, v])
    if isinstance(component, sk.HostData):
        return component.predict(FlattenedHost(component.example_host)).mean
    if isinstance(component, sk.Observable):
        return component.predict(select(example_stream(), slice(seed - 1, None))).mean
    raise TypeError(f"{type(component).__name__} is no component with this check: samplers have checks of their own")


def keeps_no_state(component: sk.Component) -> None:
    """Check that a call gives the same again, after calls with other input and of a component with other fields."""
    first = use(component)
    use(component, seed=2)
    other = _another(component)
    if other is not None:
        use(other)
    again = use(component)
    require(
        np.array_equal(first, again, equal_nan=True),
        "the same call gives something else the second time: draw no random numbers, and keep nothing between calls "
        "(no globals, no caches that depend on the last call)",
    )


def prints_nothing(component: sk.Component) -> None:
    """Check that a use prints nothing: a fit uses it 100 000 times."""

    def everything() -> None:
        use(component)
        if isinstance(component, sk.Potential) and component.compiled:
            build_field([component]).acceleration(np.zeros(3), swarm(3)[0])

    text = printed(everything).strip()
    require(not text, f"prints {text[:60]!r} at a call: take it out, a fit makes 100 000 of them")


def _another(component: sk.Component) -> sk.Component | None:
    """Return a component with other numbers, if its bounds allow some."""
    fields = component.model_dump()
    for name in type(component).parameters():
        if isinstance(fields[name], float):
            try:
                return type(component)(**{**fields, name: 0.97 * fields[name] + 0.01})
            except ValidationError:
                continue
    return None
