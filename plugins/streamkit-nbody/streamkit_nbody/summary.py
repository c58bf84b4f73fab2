"""The plan and the result of a run as text."""

from __future__ import annotations

import numpy as np

from streamkit import GYR
from streamkit.report import columns, number
from streamkit.stream import angle_in_plane
from streamkit_nbody.gravity import PAIRS
from streamkit_nbody.simulation import Simulation
from streamkit_nbody.state import State


def describe_plan(simulation: Simulation) -> str:
    """Return what the run is made of."""
    plan, inputs = simulation.plan, simulation.inputs
    rows = [
        ("host", " + ".join([*(p.kind for p in inputs.potentials.values()), *inputs.bodies])),
        ("satellite", f"{number(inputs.mass, 'Msun')} in {plan.particles} particles"),
        ("softening", f"{number(plan.softening, 'kpc')}, spline; opening angle {plan.theta:g}"),
        ("step", f"{1e3 * plan.step / GYR:.3g} Myr, {plan.steps * plan.records} of them in {plan.span / GYR:.3g} Gyr"),
    ]
    if inputs.values:
        rows.append(("at prior's centre", ", ".join(f"{name} = {value:.5g}" for name, value in inputs.values.items())))
    if plan.particles > PAIRS:
        rows.append(("", "compiling the tree, which takes some 20 s of every run"))
    return columns(rows)


def describe(simulation: Simulation, state: State) -> str:
    """Return what became of the satellite, how well the energy is kept, and how far the core is from the orbit."""
    track, plan = state.track, simulation.plan
    stripped = int((~state.bound & (state.gap > 0.0)).sum())
    rows = [
        ("bound mass", f"{number(track.mass[-1], 'Msun')}, {track.mass[-1] / track.mass[0]:.3f} of the first"),
        ("stripped", f"{stripped} of {plan.particles} particles"),
        ("energy", _energy(simulation, state)),
    ]
    if track.mass[-1] == 0.0:
        gone = track.t[np.argmax(track.mass == 0.0)] - plan.span
        rows.append(("satellite", f"gone {-gone / GYR:.3g} Gyr before today; a point mass from there on"))
    rows.append(("core", _offset(simulation, state)))
    return columns(rows)


def _energy(simulation: Simulation, state: State) -> str:
    if simulation.host.bodies:
        return "not monitored: the host moves"
    if simulation.without_energy:
        names = ", ".join(simulation.without_energy)
        return f"not monitored: the potential {names} gives no potential energy"
    total = np.abs(state.track.energy - state.track.energy[0]).max() / abs(state.track.energy[0])
    return (
        f"kept to {total:.1e} of the total, and to {state.energy_error:.1e} of the satellite's own binding energy "
        "(of a host that does not change in time)"
    )


def _offset(simulation: Simulation, state: State) -> str:
    """Compare the core's place today with the point mass's."""
    track, inputs = state.track, simulation.inputs
    distance = float(np.sqrt(((track.q[:, -1] - inputs.q) ** 2).sum()))
    speed = float(np.sqrt(((track.v[:, -1] - inputs.v) ** 2).sum()))
    there, here = (angle_in_plane(simulation.plane, q)[0] for q in (track.q[:, -1:], inputs.q[:, None]))
    ahead = there - here
    degrees = float(np.degrees(np.mod(ahead + np.pi, 2.0 * np.pi) - np.pi))
    place = ", ".join(f"{x:.6g}" for x in (*track.q[:, -1], *track.v[:, -1]))
    return (
        f"{distance:.3g} kpc and {speed:.3g} km/s from the run file's place today, {abs(degrees):.3g} deg "
        f"{'ahead of' if degrees > 0 else 'behind'} it: the mass loss moves it off a point mass's orbit. "
        f"x, y, z, vx, vy, vz = {place}: start a model of this stream from there"
    )
