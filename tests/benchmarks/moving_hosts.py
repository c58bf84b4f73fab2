"""A stream beside the Large Magellanic Cloud: streamkit, and gala in the same host, side by side on one core.

    python tests/benchmarks/moving_hosts.py [--particles 400] [--rounds 3] [--no-gala]

First the cost of what moves: the run file's stream, with its progenitor's gravity, in a static Milky Way, beside the
Large Magellanic Cloud, and beside both clouds; with the Milky Way compiled, written in NumPy and expanded, and written
in NumPy; and one call of the posterior, in turn.

Then gala. The run file is examples/lmc/sagittarius_lmc.toml without progenitor gravity. gala gets the particles as
streamkit releases them, in the inertial frame: its `TimeInterpolatedPotential` carries the Milky Way and the cloud
along their orbits, which are ours; forces and moving frame are independent. For the differences, relative to the
distance and the speed of each particle, SciPy's DOP853 integrates gala's gradient: gala 1.11.0's own integrators go
wrong in a sum of two such potentials (two halves of a halo, at rest, are not the halo), so they are timed only.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from reference_stream import in_numpy, least, renewed

import streamkit as sk
from streamkit.builtin.integrators.adaptive import Adaptive
from streamkit.builtin.integrators.reference import Reference
from streamkit.components import Integrator
from streamkit.model import Host, progenitor_track, simulate, standard_normals
from streamkit.model.release import Start, release_particles
from streamkit.runfile import StreamInputs

RUN = Path(__file__).parents[2] / "examples" / "lmc" / "sagittarius_lmc.toml"
ALONE = {"stripping.progenitor_gravity": False, "body.lmc.mass": "1.4e11 Msun"}


def inputs_of(particles: int, integrator: Integrator, **changes: Any) -> StreamInputs:
    """The run file at the centres of its priors, with test particles."""
    spec = sk.load(RUN).with_values(ALONE | {"stripping.particles": particles} | changes)
    return replace(spec.bind(), integrator=integrator)


def released(inputs: StreamInputs) -> tuple[Host, Start]:
    """Host and release states."""
    host = Host(inputs.potentials, inputs.bodies, inputs.companion)
    track = progenitor_track(host, inputs)
    return host, release_particles(inputs, track, standard_normals(inputs.stripping, inputs.seed))


def gala_host(host: Host, start: float) -> tuple[Any, Any]:
    """The same host in gala, from a time in kpc/(km/s) to today, and the path of its centre (a spline of 6 numbers)."""
    import gala.potential as gp
    from astropy import units as u
    from gala.units import UnitSystem
    from scipy.interpolate import CubicHermiteSpline

    units = UnitSystem(u.kpc, u.Myr, u.Msun, u.rad, u.kpc / u.Myr**2)  # what is not named, gala composes at each call
    result = {
        "hernquist": lambda p: (gp.HernquistPotential, {"m": p.mass * u.Msun, "c": p.a * u.kpc}),
        "hernquist_vcirc": lambda p: (
            gp.HernquistPotential,
            {"m": p.mass * u.Msun, "c": (np.sqrt(sk.G * p.mass * p.r) / p.v_circ - p.r) * u.kpc},
        ),
        "miyamoto_nagai": lambda p: (
            gp.MiyamotoNagaiPotential,
            {"m": p.mass * u.Msun, "a": p.a * u.kpc, "b": p.b * u.kpc},
        ),
        "nfw": lambda p: (gp.NFWPotential, {"m": p.mass * u.Msun, "r_s": p.rs * u.kpc}),
    }
    paths = host.paths(start)
    order = np.argsort(paths.centre.t)
    t = paths.centre.t[order] * u.kpc / (u.km / u.s)
    total = gp.CCompositePotential()

    def add(name: str, potential: Any, path: np.ndarray) -> None:
        cls, parameters = result[potential.kind](potential)
        origin = path[:, order].T * u.kpc
        total[name] = gp.TimeInterpolatedPotential(cls, t.to(u.Myr), origin=origin, units=units, **parameters)

    for name, potential in host.potentials.items():
        add(name, potential, paths.centre.q)
    for name, body in host.bodies.items():
        add(name, body.potential, paths.centre.q + paths.bodies[name].q)
    return total, CubicHermiteSpline(paths.centre.t[order], paths.centre.q.T[order], paths.centre.v.T[order])


def in_inertial_frame(path: Any, start: Start) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    """Yield the release times, which particles leave then, and their states (6, k)."""
    times, velocity = start.at_release.t, path.derivative()
    for t in np.unique(times):
        here = times == t
        q, v = start.q[:, here] + path(t)[:, None], start.v[:, here] + velocity(t)[:, None]
        yield float(t), here, np.concatenate([q, v])


def by_gradient(total: Any, path: Any, start: Start) -> np.ndarray:
    """(6, n) The particles today, about the Milky Way: SciPy's DOP853 with gala's forces."""
    from astropy import units as u
    from scipy.integrate import solve_ivp

    myr = (1 * u.kpc / (u.km / u.s)).to_value(u.Myr)
    result = np.empty((6, len(start.tail)))

    def rates(t: float, w: np.ndarray) -> np.ndarray:
        state = w.reshape(6, -1)
        pull = total.gradient(np.ascontiguousarray(state[:3]), t=t * myr).value * (u.kpc / u.Myr).to(u.km / u.s)
        return np.concatenate([state[3:], -pull * myr]).ravel()

    for t, here, w in in_inertial_frame(path, start):
        done = solve_ivp(rates, (t, 0.0), w.ravel(), method="DOP853", rtol=1e-11, atol=1e-11)
        result[:, here] = done.y[:, -1].reshape(6, -1)
    return result - np.concatenate([path(0.0), path.derivative()(0.0)])[:, None]


def by_integrator(total: Any, path: Any, start: Start) -> None:
    """Let gala's own DOP853 carry the particles, at its default tolerance."""
    import gala.integrate as gi
    from astropy import units as u
    from gala.dynamics import PhaseSpacePosition

    for t, _, w in in_inertial_frame(path, start):
        times = (np.array([t, 0.0]) * u.kpc / (u.km / u.s)).to(u.Myr)
        place = PhaseSpacePosition(w[:3] * u.kpc, w[3:] * u.km / u.s)
        total.integrate_orbit(place, t=times, Integrator=gi.DOPRI853Integrator)


def differences(particles: int) -> np.ndarray:
    """(2, n) Relative differences of positions and velocities today."""
    inputs = inputs_of(particles, Reference(rtol=1e-11, atol=1e-11))
    host, start = released(inputs)
    stream = simulate(inputs, standard_normals(inputs.stripping, inputs.seed))
    result = by_gradient(*gala_host(host, float(start.orbit.t[0])), start)

    def size(vectors: np.ndarray) -> np.ndarray:
        return np.sqrt((vectors**2).sum(axis=0))

    return np.array([size(result[:3] - stream.q) / size(stream.q), size(result[3:] - stream.v) / size(stream.v)])


# About where the Small Magellanic Cloud is: any second body would do.
SMC = {
    "kind": "hernquist", "mass": "6e9 Msun", "a": "1.5 kpc", "ra": "13.158 deg", "dec": "-72.8 deg",
    "distance": "62.4 kpc", "pm_ra_cosdec": "0.772 mas/yr", "pm_dec": "-1.117 mas/yr", "v_los": "145.6 km/s",
}  # fmt: skip


def beside(bodies: int, particles: int) -> sk.Spec:
    """The run file with none, one or both of the clouds."""
    document = dict(sk.load(RUN).document)
    clouds = document.pop("body") | {"smc": SMC}
    document["body"] = dict(list(clouds.items())[:bodies])
    return sk.load(document).with_values({"stripping.particles": particles})


def stream_job(spec: sk.Spec, evaluation: str) -> Callable[[], Any]:
    """A whole stream: the Milky Way's expansion is made anew for each, as in a fit."""
    inputs = spec.bind(spec.centre())
    normals = standard_normals(inputs.stripping, inputs.seed)
    if evaluation == "compiled":
        return lambda: simulate(inputs, normals)
    host = in_numpy(*inputs.potentials.values(), expansion="auto" if evaluation == "expanded" else "none")
    return lambda: simulate(replace(inputs, potentials={"host": renewed(host)}), normals)


def posterior_job(spec: sk.Spec) -> Callable[[], Any]:
    """One call at the centres of the priors."""
    posterior = sk.Posterior(spec)
    return lambda: posterior.evaluate(spec.centre())


def costs(particles: int, rounds: int) -> None:
    """Print CPU seconds and their ratios to the compiled static host."""
    clouds = {0: "static", 1: "one body", 2: "two bodies"}
    specs = {name: beside(count, particles) for count, name in clouds.items()}
    ways = "compiled", "expanded", "NumPy"
    jobs = {(name, way): stream_job(spec, way) for name, spec in specs.items() for way in ways}
    jobs |= {(name, "posterior"): posterior_job(spec) for name, spec in specs.items()}
    best = least(jobs, rounds)
    print(f"{particles} particles    " + "".join(f"{way:>20s}" for way in (*ways, "posterior")))
    for name in specs:
        cells = []
        for way in (*ways, "posterior"):
            of = best["static", "posterior" if way == "posterior" else "compiled"]
            cells.append(f"{best[name, way]:12.3f} s {best[name, way] / of:5.2f}")
        print(f"{name:17s}" + "".join(cells))


def main() -> None:
    """Print the costs, the differences, and gala's CPU seconds beside ours."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--particles", type=int, default=400)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--no-gala", action="store_true", help="only the cost of what moves")
    given = parser.parse_args()
    costs(4000, given.rounds)
    if given.no_gala:
        return
    for name, values in zip(("positions", "velocities"), differences(given.particles), strict=True):
        print(f"{name}: relative difference, median {np.median(values):.1e}, largest {values.max():.1e}")
    inputs = inputs_of(given.particles, Adaptive())
    host, start = released(inputs)
    total, path = gala_host(host, float(start.orbit.t[0]))
    normals = standard_normals(inputs.stripping, inputs.seed)
    jobs = {
        "streamkit, whole stream, default": lambda: simulate(inputs, normals),
        "gala, the particles alone, DOP853": lambda: by_integrator(total, path, start),
    }
    best = least(jobs, given.rounds)
    for name, value in best.items():
        print(f"{name:36s} {value:7.3f} CPU s {1e3 * value / given.particles:8.3f} ms a particle")


if __name__ == "__main__":
    main()
