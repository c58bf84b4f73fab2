"""CPU seconds of one stream: streamkit, gala and galpy side by side, in alternation, on one core.

    python tests/benchmarks/reference_stream.py [--rounds 3] [--only NumPy]

The job is section 3.2 of Gibbons, Belokurov & Evans 2014: an NFW halo (M200 = 7.5e11 Msun, c = 20), a Plummer
progenitor (6.4e8 Msun, 0.85 kpc) on an orbit of 18 to 70 kpc, 12 660 particles over 4.31 Gyr, progenitor gravity on.
Everything counts: track, release, integration, stripping times, winding. streamkit's position errors are those of the
escaped particles of tests/data/nfw_stream.npz against an independent code's converged answer. gala runs its leapfrog
at the release spacing, as its DOP853 with progenitor gravity fails for most seeds in 1.11.0 (its issue 466). galpy
integrates every 40th particle by hand and is scaled up. What is not installed is left out, and said so.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

from snapshots import reference_errors

import streamkit as sk
from streamkit.builtin.integrators.adaptive import Adaptive
from streamkit.builtin.integrators.fixed_step import ForestRuth, Leapfrog
from streamkit.builtin.potentials.closed_forms import NFW, Hernquist, MiyamotoNagai, Plummer, TruncatedFlat
from streamkit.builtin.potentials.halos import NFWTriaxial
from streamkit.builtin.stripping.lagrange import LagrangeCloud
from streamkit.builtin.stripping.restricted_nbody import RestrictedNbody
from streamkit.components import Integrator, Potential, StrippingScheme
from streamkit.engine import build_field
from streamkit.model import NODE, random_numbers
from streamkit.model.model import simulate
from streamkit.runfile import StreamInputs
from streamkit.units import Number

MASS, RADIUS, LOOKBACK, PARTICLES = 6.4e8, 0.85, 4.31, 12660
HALO = NFW(mass=3.584843593e11, rs=9.370845158)
FLAT = TruncatedFlat(v0=210.0, rs=12.0, alpha=0.45)
with np.load(Path(__file__).parents[1] / "data" / "nfw_stream.npz") as opened:
    DATA = dict(opened)
START = DATA["progenitor_start"]


BULGE, DISC = Hernquist(mass=3e10, a=0.5), MiyamotoNagai(mass=3.3e10, a=4.0, b=0.4)
TRIAXIAL = NFWTriaxial(mass=HALO.mass, rs=HALO.rs, p=0.9, q=0.8)


def in_numpy(*potentials: Potential, expansion: str) -> Potential:
    """Return the sum of potentials as a plug-in author without numba writes it: NumPy on whole batches."""

    class InNumpy(Potential):
        kind = "in_numpy"
        compiled = False
        factor: Number = 1.0

        @staticmethod
        def acceleration(x: Any, y: Any, z: Any, t: Any, factor: Any) -> Any:
            """Add up the accelerations."""
            forces = [type(p).acceleration(x, y, z, t, *p.in_engine_units()) for p in potentials]
            return tuple(factor * sum(force[k] for force in forces) for k in range(3))

    return InNumpy(expansion=expansion)  # type: ignore[call-arg]


HOSTS: dict[str, tuple[Potential, ...]] = {
    "TF host": (FLAT,),
    "NFW in NumPy": (in_numpy(HALO, expansion="none"),),
    "NFW in NumPy, expanded": (in_numpy(HALO, expansion="auto"),),
    "bulge + disc + halo": (BULGE, DISC, HALO),
    "bulge + disc + halo in NumPy": (in_numpy(BULGE, DISC, HALO, expansion="none"),),
    "bulge + disc + halo in NumPy, expanded": (in_numpy(BULGE, DISC, HALO, expansion="auto"),),
    "triaxial NFW": (TRIAXIAL,),
    "triaxial NFW in NumPy": (in_numpy(TRIAXIAL, expansion="none"),),
    "triaxial NFW in NumPy, expanded": (in_numpy(TRIAXIAL, expansion="auto"),),
}


def today(*host: Potential) -> tuple[np.ndarray, np.ndarray]:
    """The progenitor at the end of the job."""
    orbit = build_field(host).orbit(START[:3], START[3:], -LOOKBACK * sk.GYR, 0.0, NODE)
    return orbit.q[:, -1].copy(), orbit.v[:, -1].copy()


def streamkit_job(
    integrator: Integrator, *host: Potential, gravity: bool = True, live: int = 0, seed: int = 1
) -> Callable[[], sk.Stream]:
    """One whole stream: by mLCS, or by a live progenitor of so many particles."""
    q, v = today(*host)
    stripping: StrippingScheme = LagrangeCloud(particles=PARTICLES, sigma=10.0, progenitor_gravity=gravity)
    if live:
        stripping = RestrictedNbody(particles=live)
    satellite = Plummer(mass=MASS, radius=RADIUS)
    potentials = {p.kind: p for p in host}
    inputs = StreamInputs(potentials, satellite, MASS, q, v, LOOKBACK, stripping, integrator, None, seed, {})
    numbers = random_numbers(stripping, seed)

    def job() -> sk.Stream:
        return simulate(replace(inputs, potentials={p.kind: renewed(p) for p in host}), numbers)

    return job


def renewed(potential: Potential) -> Potential:
    """Return the potential as the next call of a fit has it: its expansion is to be made, at the same nodes."""
    other = type(potential)(**dict(potential))
    other.share_grid_of(potential, potential.kind)
    return other


def void(_: object) -> None:
    """Drop a result."""


def gala_job() -> Callable[[], None]:
    """gala's Lagrange cloud with its leapfrog at the release spacing."""
    import gala.dynamics as gd
    import gala.potential as gp
    from astropy import units as u
    from gala.dynamics import mockstream as ms
    from gala.units import galactic

    host = gp.NFWPotential(m=HALO.mass * u.Msun, r_s=HALO.rs * u.kpc, units=galactic)
    satellite = gp.PlummerPotential(m=MASS * u.Msun, b=RADIUS * u.kpc, units=galactic)
    scheme = ms.LagrangeCloudStreamDF(v_disp=10 * u.km / u.s, random_state=np.random.RandomState(42))
    generator = ms.MockStreamGenerator(scheme, gp.Hamiltonian(host), progenitor_potential=satellite)
    w0 = gd.PhaseSpacePosition(pos=START[:3] * u.kpc, vel=START[3:] * u.km / u.s)
    steps = PARTICLES // 2
    grid = {"dt": LOOKBACK * 1000 / steps * u.Myr, "n_steps": steps, "Integrator": "leapfrog"}
    return lambda: void(generator.run(w0, MASS * u.Msun, n_particles=1, progress=False, **grid))


def galpy_job(every: int = 40) -> Callable[[], None]:
    """galpy's compiled DOP853 by hand on a few particles; the caller scales the time."""
    from astropy import units as u
    from galpy.orbit import Orbit
    from galpy.potential import MovingObjectPotential, NFWPotential, PlummerPotential

    host = NFWPotential(amp=HALO.mass * u.Msun, a=HALO.rs * u.kpc, ro=8.0, vo=220.0)
    satellite = PlummerPotential(amp=MASS * u.Msun, b=RADIUS * u.kpc, ro=8.0, vo=220.0)

    def orbit(w: np.ndarray) -> Orbit:
        x, y, z, vx, vy, vz = w
        R, phi = np.hypot(x, y), np.arctan2(y, x)
        vR, vT = vx * np.cos(phi) + vy * np.sin(phi), vy * np.cos(phi) - vx * np.sin(phi)
        return Orbit([R / 8, vR / 220, vT / 220, z / 8, vz / 220, phi], ro=8.0, vo=220.0)

    def job() -> None:
        progenitor = orbit(START)
        progenitor.integrate(np.linspace(0, LOOKBACK, 4311) * u.Gyr, host, method="dop853_c")
        total = [host, MovingObjectPotential(progenitor, pot=satellite)]
        for t, w in zip(DATA["t_release"][:: every // 10], DATA["release"][:: every // 10], strict=True):
            orbit(w).integrate(np.array([LOOKBACK + t, LOOKBACK]) * u.Gyr, total, method="dop853_c")

    return job


def least(jobs: dict[Any, Callable[[], Any]], rounds: int) -> dict[Any, float]:
    """Least CPU seconds of each job, run in turn; the first time of all is not counted."""
    seconds: dict[Any, list[float]] = {name: [] for name in jobs}
    for k in range(rounds + 1):
        for name, job in jobs.items():
            begin = time.process_time()
            job()
            if k:
                seconds[name].append(time.process_time() - begin)
    return {name: min(values) for name, values in seconds.items()}


def main() -> None:
    """Time every job in turn, several rounds, and print minima and ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3, help="rounds of all jobs in alternation")
    parser.add_argument("--only", default="", metavar="TEXT", help="only jobs with this in their name, and the first")
    options = parser.parse_args()
    settings: dict[str, Integrator] = {
        "adaptive (default)": Adaptive(),
        "adaptive, eta 0.5, 0.55": Adaptive(eta=0.5, eta_progenitor=0.55),
        "adaptive, eta 0.3, 0.25": Adaptive(eta=0.3, eta_progenitor=0.25),
        "adaptive, pefrl, eta 0.25, 0.2": Adaptive(method="pefrl", eta=0.25, eta_progenitor=0.2),
        "pefrl, 8 Myr": ForestRuth(step=0.008),
        "pefrl, 4 Myr": ForestRuth(),
        "leapfrog, 2 Myr": Leapfrog(step=0.002),
    }
    jobs = {f"streamkit {name}": (streamkit_job(i, HALO), 1.0) for name, i in settings.items()}
    for name, host in HOSTS.items():
        jobs[f"streamkit default, {name}"] = streamkit_job(Adaptive(), *host), 1.0
    for live in (10_000, 40_000):
        jobs[f"streamkit restricted N-body, {live} particles"] = streamkit_job(Adaptive(), HALO, live=live), 1.0
    jobs["streamkit default, no progenitor gravity"] = streamkit_job(Adaptive(), HALO, gravity=False), 1.0
    for name, make, scale in (("gala, leapfrog", gala_job, 1.0), ("galpy, dop853_c by hand", galpy_job, 40.0)):
        try:
            if options.only in name:
                jobs[name] = make(), scale
        except ImportError as error:
            print(f"{name} is left out: {error}")
    first = next(iter(jobs))
    jobs = {name: job for name, job in jobs.items() if options.only in name or name == first}
    shortest = least({name: job for name, (job, _) in jobs.items()}, options.rounds)
    best = {name: jobs[name][1] * value for name, value in shortest.items()}
    reference = best["streamkit adaptive (default)"]
    print(f"{'':60s} CPU s   ratio  particles/s  median, 99 % error [kpc]")
    for name, value in best.items():
        line = f"{name:60s} {value:6.3f} {value / reference:7.1f} {PARTICLES / value:11.0f}"
        if (integrator := settings.get(name.removeprefix("streamkit "))) is not None:
            errors = reference_errors(integrator)
            line += f"  {np.median(errors):.1e}  {np.percentile(errors, 99):.1e}"
        print(line)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
