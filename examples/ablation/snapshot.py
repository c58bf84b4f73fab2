"""Write an N-body snapshot as the plain table that `streamkit ablate --reference` reads.

    python examples/ablation/snapshot.py tests/data/nbody_A.npz -o nbody_A_table.npz

The input is one of the two N-body extracts of the tests (tests/data/README.md). To use a simulation of your own, write
the same columns. Only x, y, z, vx, vy, vz and meta are needed. Without the others streamkit follows every particle back
to find when it was stripped.
"""

import argparse
import json
from pathlib import Path

import numpy as np

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("extract", type=Path, help="tests/data/nbody_A.npz or nbody_B.npz")
parser.add_argument("-o", "--output", type=Path, required=True, help="the table, a .npz file")
given = parser.parse_args()

data = np.load(given.extract)
core = data["orbit_txv"].copy()  # rows of time (Gyr), position, velocity of the satellite's core; the last is today
core[:, 0] -= core[0, 0]  # time since the start of the simulation
today = core[-1, 0]

np.savez_compressed(
    given.output,
    meta=json.dumps({"units": "kpc, km/s, Gyr", "t_gyr": today}),
    **dict(zip(("x", "y", "z"), data["x"], strict=True)),
    **dict(zip(("vx", "vy", "vz"), data["v"], strict=True)),
    t_strip=data["t_strip"] + today,  # when each particle was last inside the tidal radius; -1 for bound ones
    Lam_unwrapped_deg=data["winding"],  # angle along the stream with whole turns, leading positive
    chi=data["chi"],  # the phase of Gibbons, Belokurov & Evans 2014, kpc Gyr
    orbit_txv=core,
)
print(f"{data['x'].shape[1]} particles at {today:.2f} Gyr: {given.output}")
