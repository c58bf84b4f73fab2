"""A calibration by the posterior on a grid: what no sampler and no emulator has a part in.

    python tests/benchmarks/grid_calibration.py RUN.toml [--draws 200 700] [--truth-particles 60000] [--streams 20]

The run file has two free parameters with uniform priors, which are those of its hosts. On a grid of them the mean of
many streams is splined, and each draw of `streamkit calibrate` gets its posterior from that by adding up. It prints in
how many draws the 68 and 95 % intervals of the parameters and of the enclosed masses hold the truth, and by how much
truths scatter in standard deviations: where `streamkit calibrate` is off, this says whether its fits are.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.stats import binom, norm

import streamkit as sk
from streamkit.sample.calls.comparison import Comparison
from streamkit.study.calibration import MASS_RADII
from streamkit.study.calibration.mocks import draw_mock

GRID, FINE = (17, 13), (201, 181)  # places along the parameters: of streams, and of the sums
RADII = np.array(MASS_RADII)
FIRST_SEED = 9000  # of the grid's streams, which are none of the fits'
PART = 4000  # places that are compared at a time


def predictions(spec: sk.Spec, axes: list[np.ndarray], streams: int) -> np.ndarray:
    """(a, b, m) Return the means of so many streams on the grid."""
    posteriors = [sk.Posterior(spec.with_values({"seed": FIRST_SEED + k})) for k in range(streams)]
    rows = [[np.mean([each.observe(np.array([x, y])).prediction.mean for each in posteriors], axis=0) for y in axes[1]]
            for x in axes[0]]  # fmt: skip
    return np.array(rows)


def ranks(
    spec: sk.Spec, truth: sk.Spec, index: int, places: np.ndarray, model: np.ndarray, masses: np.ndarray
) -> np.ndarray:
    """(2 + r,) Return the fractions of a draw's posterior below its truth: of the parameters, and of masses (n, r)."""
    theta, mock = draw_mock(spec, truth, index)
    comparison = Comparison(sk.Model(mock.spec))
    details = comparison.details(sk.Model(mock.spec).observe_all(mock.spec.bind_all(theta)))
    lnl = np.concatenate([
        comparison.ln_likelihood(places[i : i + PART], part, np.zeros_like(part), np.tile(details, (len(part), 1)))
        for i in range(0, len(places), PART)
        for part in [model[i : i + PART]]
    ])  # fmt: skip
    weight = np.exp(lnl - lnl.max())
    true = np.concatenate([theta, sk.Host(truth.host(theta)).mass_inside(RADII)])
    return np.asarray((weight[:, None] * (np.column_stack([places, masses]) < true)).sum(axis=0) / weight.sum())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run_file")
    parser.add_argument("--draws", nargs=2, type=int, default=[0, 200], help="the first, and the one after the last")
    parser.add_argument("--truth-particles", type=int, default=60_000)
    parser.add_argument("--streams", type=int, default=20, help="streams at each place of the grid")
    given = parser.parse_args()
    spec = sk.load(given.run_file)
    truth = spec.with_values({"stripping.particles": given.truth_particles})
    ends = [[float(prior.ppf(u)) for u in (0.0, 1.0)] for prior in spec.priors]
    coarse, fine = ([np.linspace(*end, n) for end, n in zip(ends, counts, strict=True)] for counts in (GRID, FINE))
    known = predictions(spec, coarse, given.streams)
    places = np.stack(np.meshgrid(*fine, indexing="ij"), axis=-1).reshape(-1, 2)
    model = np.stack([RectBivariateSpline(*coarse, each, s=0).ev(*places.T) for each in np.moveaxis(known, 2, 0)], 1)
    masses = np.array([sk.Host(spec.host(each)).mass_inside(RADII) for each in places])
    found = np.array([ranks(spec, truth, i, places, model, masses) for i in range(*given.draws)])
    n, z = len(found), norm.ppf(np.clip(found, 1e-3, 1 - 1e-3))
    names = [*spec.names, *(f"M(<{r:g} kpc)" for r in RADII)]
    for level in (0.68, 0.95):
        held = (np.abs(found - 0.5) < 0.5 * level).sum(axis=0)
        print(f"in {level:.0%} of {n}: {dict(zip(names, held.tolist(), strict=True))}, expected {n * level:.0f} +- "
              f"{binom(n, level).std():.0f}")  # fmt: skip
    scatter = np.sqrt((z**2).mean(axis=0)).round(3)
    print(f"scatter: {dict(zip(names, scatter.tolist(), strict=True))}, expected 1 +- {1 / np.sqrt(2 * n):.2f}")


if __name__ == "__main__":
    main()
