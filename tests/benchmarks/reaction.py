"""The energy that a live progenitor loses to its debris, and how noisy it is.

    python tests/benchmarks/reaction.py [--particles N ...] [--seeds N]

`restricted_nbody` follows its progenitor on the orbit of a point of its whole mass. Here the pull of the debris beyond
1 kpc on the core is summed at the end of every block, for the live satellites of figure 5 and of mock 1 (tests/data).
It prints the energy that the core loses by it, as a change of the apocentre at the look-back time in kpc, and the
scatter between seeds.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

import streamkit as sk
from streamkit.builtin.stripping.restricted_nbody import RestrictedNbody

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
from snapshots import run_file  # the live satellites of the tests

CORE = 1.0  # kpc: what is nearer belongs to the progenitor itself


def energy_lost(spec: sk.Spec, written: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the energy in (km/s)^2 that the core has lost, and d(energy) / d(apocentre) at the look-back time."""
    written.clear()
    orbit = sk.Model(spec).stream().orbit
    times, power = np.array(written).T
    momentum = np.cross(orbit.q[:, 0], orbit.v[:, 0])
    pull = np.sqrt((orbit.a[:, 0] ** 2).sum())
    return -float(np.trapezoid(power, times)), float(pull - momentum @ momentum / orbit.r[0] ** 3)


def watched() -> list[tuple[float, float]]:
    """Make the scheme write the time and the power of the debris's pull on the core at each block's edge; the list."""
    written: list[tuple[float, float]] = []
    update_remnant = RestrictedNbody.update_remnant

    def and_write(
        self: RestrictedNbody, edge: sk.BlockEdge, satellite: sk.SatelliteView, previous: sk.Remnant | None
    ) -> sk.Remnant:
        """Sum the pull of all that is not near the core."""
        away = edge.q - edge.core[:3, None]
        d2 = (away**2).sum(axis=0)
        pull = np.where(d2 > CORE**2, sk.G * edge.mass / (d2 + satellite.scale**2) ** 1.5, 0.0) @ away.T
        written.append((edge.t, float(pull @ edge.core[3:6])))
        return update_remnant(self, edge, satellite, previous)

    RestrictedNbody.update_remnant = and_write  # type: ignore[method-assign]
    return written


def main() -> None:
    """Print a row of Markdown for each satellite and number of particles."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--particles", nargs="*", type=int, default=[5000, 20000])
    parser.add_argument("--seeds", type=int, default=8)
    given = parser.parse_args()
    written = watched()
    print("| satellite | particles | apocentre at the look-back time, kpc | scatter between seeds |")
    for name, letter in (("figure 5", "A"), ("mock 1", "B")):
        for particles in given.particles:
            fields = {"stripping.kind": "restricted_nbody", "stripping.particles": particles}
            rows = [
                energy_lost(run_file(letter).with_values({**fields, "seed": seed + 1}), written)
                for seed in range(given.seeds)
            ]
            change = np.array([energy / slope for energy, slope in rows])
            print(f"| {name} | {particles} | {change.mean():+.2f} | {change.std(ddof=1):.2f} |", flush=True)


if __name__ == "__main__":
    main()
