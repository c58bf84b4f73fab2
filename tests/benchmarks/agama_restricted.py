"""Restricted N-body of AGAMA and of streamkit, side by side: CPU time, bound mass, and where the debris is.

    python tests/benchmarks/agama_restricted.py [--particles 10000] [--block 0.03] [--seeds 3]

The job is that of reference_stream.py. AGAMA's example of a tidal stream is followed: particles of the Plummer sphere's
distribution function move in the host and in a monopole of all particles, which is made anew after each block. AGAMA
is not on the Python package index as a wheel; see its manual for the installation.
"""

from __future__ import annotations

import argparse
import time
from itertools import pairwise

import numpy as np
from reference_stream import HALO, LOOKBACK, MASS, RADIUS, START, streamkit_job

import streamkit as sk
from streamkit.builtin.integrators.adaptive import Adaptive
from streamkit.stream import Orbit, angle_in_plane, orbital_plane

BINS = np.arange(-180.0, 181.0, 30.0)  # deg in the plane of the orbit, 0 at the progenitor
FEWEST = 50  # particles of a bin that is compared


def by_agama(particles: int, block: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(6, n) particles today, (n,) which are bound, and (6,) the progenitor; blocks in Gyr."""
    import agama

    agama.setNumThreads(1)
    agama.setUnits(length=1, velocity=1, mass=1)
    agama.setRandomSeed(seed)
    host = agama.Potential(type="NFW", mass=HALO.mass, scaleRadius=HALO.rs)
    satellite = agama.Potential(type="Plummer", mass=MASS, scaleRadius=RADIUS)
    distribution = agama.DistributionFunction(type="QuasiSpherical", potential=satellite)
    w, mass = agama.GalaxyModel(satellite, distribution).sample(particles)
    core, w = START, w + START
    bound = np.ones(particles, dtype=bool)
    times = np.linspace(0.0, LOOKBACK * sk.GYR, round(LOOKBACK / block) + 1)
    for begin, end in pairwise(times):
        span = {"timestart": begin, "time": end - begin}
        moments, track = agama.orbit(potential=host, ic=core, trajsize=17, **span)
        moving = agama.Potential(potential=satellite, center=np.column_stack((moments, track)))
        both = agama.Potential(host, moving)
        w = agama.orbit(potential=both, ic=w, trajsize=1, separateTime=True, verbose=False, **span)[1].reshape(-1, 6)
        core = track[-1]
        q, v = w[:, :3] - core[:3], w[:, 3:] - core[3:]
        satellite = agama.Potential(type="Multipole", particles=(q, mass), symmetry="s")
        bound = satellite.potential(q) + 0.5 * np.sum(v**2, axis=1) < 0
    return w.T, bound, core


def by_streamkit(particles: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same of streamkit."""
    stream = streamkit_job(Adaptive(), HALO, live=particles, seed=seed)()
    core = np.concatenate([stream.orbit.q[:, -1], stream.orbit.v[:, -1]])
    return np.concatenate([stream.q, stream.v]), stream.bound, core


def table(w: np.ndarray, bound: np.ndarray, core: np.ndarray) -> np.ndarray:
    """(bins, 2) Share of all particles, in per cent, and median radius in kpc of the debris by angle."""
    at = core[:, None]
    orbit = Orbit(t=np.zeros(1), q=at[:3], v=at[3:], a=np.zeros((3, 1)), r_tidal=np.full(1, np.nan))
    q = w[:3, ~bound]
    angle = np.degrees(angle_in_plane(orbital_plane(orbit), q))
    r = np.sqrt(np.sum(q**2, axis=0))
    rows = []
    for low, high in pairwise(BINS):
        inside = (angle >= low) & (angle < high)
        rows.append((100 * inside.sum() / len(bound), np.median(r[inside]) if inside.sum() >= FEWEST else np.nan))
    return np.array(rows)


def main() -> None:
    """Run both for several seeds, in alternation, and print means with their scatter."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--particles", type=int, default=10_000)
    parser.add_argument("--block", type=float, default=0.03, help="Gyr between AGAMA's monopoles")
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    jobs = {
        "AGAMA": lambda seed: by_agama(options.particles, options.block, seed),
        "streamkit": lambda seed: by_streamkit(options.particles, seed),
    }
    jobs["streamkit"](0)  # compiles
    seconds, shares, tables = ({name: [] for name in jobs} for _ in range(3))
    for seed in range(1, options.seeds + 1):
        for name, job in jobs.items():
            begin = time.process_time()
            w, bound, core = job(seed)
            seconds[name].append(time.process_time() - begin)
            shares[name].append(bound.mean())
            tables[name].append(table(w, bound, core))
    for name in jobs:
        share = shares[name]
        print(f"{name:10s} {min(seconds[name]):7.3f} CPU s, bound {np.mean(share):.3f} +- {np.std(share):.3f}")
        for column, what in enumerate(("share in %", "median r in kpc")):
            values = np.array([each[:, column] for each in tables[name]])
            moments = zip(values.mean(axis=0), values.std(axis=0), strict=True)
            print(f"  {what:16s}" + " ".join(f"{mean:5.1f}+-{scatter:3.1f}" for mean, scatter in moments))


if __name__ == "__main__":
    main()
