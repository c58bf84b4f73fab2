"""What field stars do to a fit from stars: the same members among 0, 50, 80 and 95 % of them.

    python tests/benchmarks/stars.py [--members 200] [--free 2] [--background 0 0.5 0.8 0.95] [--out DIR]

The members are particles of the stream of examples/gd1_stars at its true values, made with other random numbers and
more particles than those of the fit, with errors of 0.15 mas/yr. Field stars are even in phi2 and Gaussian in the
proper motions, and the fit is given their density. Free are the first numbers of `FREE`, and the fraction where there
is a field. The sampler is `emulator`. The lines give M(<20 kpc) with its standard deviation, the shift of its mean in
standard deviations of the fit of the members alone, calls, CPU seconds, and whether the fit is certified. Then the
members among the stars with a probability above 0.5, and the mean probability of all stars beside the share of members.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

import streamkit as sk

EXAMPLE = Path(__file__).parents[2] / "examples" / "gd1_stars" / "gd1_stars.toml"
FRAME = "GD1Koposov10"
TRUTH = {
    "potential.v0": 224.0, "progenitor.pm_phi1_cosphi2": -12.84, "progenitor.distance": 8.2,
    "progenitor.pm_phi2": -2.65, "progenitor.v_los": -76.6,
}  # fmt: skip
FREE = tuple(TRUTH)  # in the order in which they become free
ERROR = 0.15  # mas/yr
PHI1, PHI2 = (-60.0, 0.0), (-4.0, 4.0)
CENTRE, WIDTH = (-4.0, -3.0), (5.0, 4.0)  # mas/yr, of the field


def places_of_members(count: int, rng: np.random.Generator) -> sk.Array:
    """(4, count) phi1, phi2 and proper motions of particles that have left the progenitor."""
    spec = sk.load(EXAMPLE).with_values({**TRUTH, "observable.fraction": 0.5, "seed": 77, "stripping.particles": 10000})
    stream = sk.Model(spec).stream(np.empty(0))
    seen = stream.seen(FRAME)
    inside = (seen.lon > PHI1[0]) & (seen.lon < PHI1[1]) & (np.abs(seen.lat) < PHI2[1])
    some = rng.choice(np.flatnonzero(~stream.bound & inside), count, replace=False)
    return np.array([seen.lon[some], seen.lat[some], seen.pm_lon_coslat[some], seen.pm_lat[some]])


def places_of_field(count: int, rng: np.random.Generator) -> sk.Array:
    """(4, count) the same of field stars."""
    motions = rng.normal(CENTRE, WIDTH, (count, 2)).T
    return np.vstack([rng.uniform(*PHI1, count), rng.uniform(*PHI2, count), motions])


def catalogue(members: int, background: float, seed: int = 5) -> tuple[dict[str, list[float]], sk.BoolArray]:
    """Return the table of a mock whose share of field stars is ``background``, and which stars are members."""
    rng = np.random.default_rng(seed)
    places = places_of_members(members, rng)
    noise = rng.normal(0, ERROR, (2, members))  # before the field: the members are the same in all mocks
    field = places_of_field(round(members * background / (1 - background)), rng)
    noise = np.hstack([noise, rng.normal(0, ERROR, (2, field.shape[1]))])
    phi1, phi2, *motions = np.hstack([places, field])
    seen = np.array(motions) + noise
    variance = np.square(WIDTH) + ERROR**2
    chi2 = ((seen.T - CENTRE) ** 2 / variance).sum(axis=1)
    density = np.exp(-0.5 * chi2) / (2 * np.pi * np.sqrt(variance.prod())) / (PHI2[1] - PHI2[0])
    ra, dec, pm_ra, pm_dec = sk.sky_frame(FRAME).to_icrs(phi1, phi2, *seen)
    error = np.full(len(phi1), ERROR)
    table = {"ra": ra, "dec": dec, "pm_ra_cosdec": pm_ra, "pm_dec": pm_dec, "pm_ra_cosdec_error": error,
             "pm_dec_error": error}  # fmt: skip
    if background:
        table["background_density"] = density
    return {name: column.tolist() for name, column in table.items()}, np.arange(len(phi1)) < members


def run_file(table: dict[str, list[float]], background: float, free: int, particles: int, seed: int) -> sk.Spec:
    """Return the run file of a mock, with the first ``free`` numbers of `FREE`."""
    changes: dict[str, Any] = {name: value for name, value in TRUTH.items() if name not in FREE[:free]}
    changes |= {"observable.stars": table, "stripping.particles": particles, "seed": seed}
    return sk.load(EXAMPLE).with_values(changes if background else changes | {"observable.fraction": 1.0})


def main() -> None:
    """Print a line for each mock."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--members", type=int, default=200)
    options.add_argument("--free", type=int, default=2, choices=range(1, len(FREE) + 1))
    options.add_argument("--background", type=float, nargs="+", default=[0.0, 0.5, 0.8, 0.95])
    options.add_argument("--particles", type=int, default=2000)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--out", type=Path)
    given = options.parse_args()
    clean: tuple[float, float] | None = None
    print("field   stars  M(<20) +- sd, 1e11 Msun  shift  calls  CPU s  certified  members: found, right; p, share")
    for background in given.background:
        table, is_member = catalogue(given.members, background)
        spec = run_file(table, background, given.free, given.particles, given.seed)
        start = time.process_time()
        out = None if given.out is None else given.out / f"field{background:g}"
        results = sk.run(spec, out, progress=False, products=out is not None)
        seconds = time.process_time() - start
        mass = results.profiles(np.array([20.0]))[0][:, 0] / 1e11
        clean = clean or (mass.mean(), mass.std())
        p = np.asarray(results.members()["p_member"]) if background else np.ones(len(is_member))
        called = p > 0.5
        print(
            f"{background:5.0%} {len(is_member):7d}  {mass.mean():.4f} +- {mass.std():.4f}        "
            f"{(mass.mean() - clean[0]) / clean[1]:+10.2f} {results.calls + results.search_calls:6d} {seconds:6.0f}  "
            f"{'yes' if not results.draws.lacks else 'no':9s}  {is_member[called].sum():4d} of {is_member.sum()}, "
            f"{is_member[called].mean():.3f}; {p.mean():.4f}, {is_member.mean():.4f}",
            flush=True,
        )
        if results.draws.lacks:
            print(f"        {results.draws.lacks}", flush=True)


if __name__ == "__main__":
    main()
