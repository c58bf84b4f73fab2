"""What does a live dwarf keep of its mass: by `restricted_nbody`, and by N-body of any number of particles?

    python tests/benchmarks/bound_mass.py                                       # restricted_nbody, 40 000 particles
    python tests/benchmarks/bound_mass.py -o DIR --particles 20000 --step 0.8   # N-body: minutes
    python tests/benchmarks/bound_mass.py -o DIR --particles 100000 --softening 0.0225 --step 0.72 --falcon

A Plummer sphere of 3e8 Msun and 0.7 kpc falls from 60 kpc to pericentres of 15 kpc in `tf` for 4 Gyr. The bound
fraction of its first mass is printed at some times. With `--falcon` the forces between the particles are those of
falCON (Dehnen 2002, J. Comp. Phys. 179, 27) by the package pyfalcon, which has to be built from its source:
github.com/GalacticDynamics-Oxford/pyfalcon. It is 15 times as fast as the tree of streamkit-nbody.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

import streamkit as sk
from streamkit.stream import Array

RUN: dict[str, Any] = {
    "version": 1,
    "seed": 1,
    "potential": {"kind": "tf", "v0": 210, "rs": 12, "alpha": 0.45},
    "progenitor": {
        "kind": "plummer", "mass": 3e8, "radius": 0.7, "lookback": 4,
        "x": -20.91526668724385, "y": -0.5553211361618123, "z": 0,
        "vx": 139.9496207415145, "vy": -203.8304008114681, "vz": 0,
    },
    "stripping": {"kind": "restricted_nbody", "particles": 40000},
}  # fmt: skip
AFTER = np.array([1.0, 2.0, 3.0, 3.9, 4.0])  # Gyr
KERNEL, WIDER = 1, 1.4  # falCON's kernel, and its length per Plummer-equivalent softening
THETA = 0.5  # its opening angle


def falcon(self: Any, q: Array, *, accel: bool = False, potential: bool = False) -> dict[str, Array]:
    """Return what `streamkit_nbody.gravity.Gravity` computes, by falCON. It has both always."""
    import pyfalcon  # type: ignore[import-not-found]

    centred = np.ascontiguousarray((q - np.median(q, axis=1, keepdims=True)).T)
    length = WIDER * self.softening
    forces, potentials = pyfalcon.gravity(centred, sk.G * self.mass, eps=length, theta=THETA, kernel=KERNEL)
    return {"accel": np.array(forces, dtype=float), "potential": np.array(potentials, dtype=float)}


def by_particles(out: Path, particles: int, softening: float | None, step: float, with_falcon: bool) -> Array:
    """Return the bound fractions by N-body at the times `AFTER`; a run that is there is continued."""
    from streamkit_nbody import runner
    from streamkit_nbody.gravity import Gravity
    from streamkit_nbody.plan import Options
    from streamkit_nbody.simulation import Simulation

    if with_falcon:
        Gravity._evaluate = falcon  # type: ignore[method-assign]
    simulation = Simulation.of(sk.load(RUN), Options(particles, softening, step=1e-3 * step))
    print(f"softening {simulation.plan.softening:.4f} kpc", flush=True)
    track = runner.run(simulation, out, resume=(out / runner.CHECKPOINT).exists()).track
    return np.interp(AFTER * sk.GYR, track.t, track.mass / track.mass[0])


def restricted(seed: int) -> Array:
    """Return the same by `restricted_nbody`."""
    orbit = sk.Model(sk.load(RUN | {"seed": seed})).stream().orbit
    return np.interp((AFTER - AFTER[-1]) * sk.GYR, orbit.t, orbit.mass_left)


def main() -> None:
    """Print the bound fractions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, help="directory of an N-body run")
    parser.add_argument("--particles", type=int, default=20000)
    parser.add_argument("--softening", type=float, metavar="KPC")
    parser.add_argument("--step", type=float, default=1.0, metavar="MYR", help="longest step")
    parser.add_argument("--falcon", action="store_true", help="forces by the package pyfalcon")
    given = parser.parse_args()
    print("after, Gyr:", *AFTER)
    if given.output:
        found = by_particles(given.output, given.particles, given.softening, given.step, given.falcon)
        print(f"N-body, {given.particles}:", *found.round(4))
        return
    each = np.array([restricted(seed) for seed in range(1, 5)])
    print("restricted_nbody:", *each.mean(axis=0).round(4), "scatter of seeds:", *each.std(axis=0, ddof=1).round(4))


if __name__ == "__main__":
    main()
