"""How far a choice moves the mass: a finished fit, reweighted to another choice.

    python tests/benchmarks/sensitivity.py OUT [--samples 600] [--workers 2]

Samples of the fit in OUT are evaluated again with one choice changed; their weights are the ratios of the two
posteriors, of the same particles. For another line-of-sight velocity the samples are moved along with its prior. The
effective number of samples says how far a line can be trusted: below some tens it cannot. Dispersion and look-back
time are free in the fit: there the samples are split at their terciles instead.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import streamkit as sk
from streamkit.fit.samples.results import load_results
from streamkit.model import Host
from streamkit.sample import Evaluation, Posterior, Workers
from streamkit.stream import Data

RADII = np.array([50.0, 100.0, 150.0, 200.0])
TERCILES = ("progenitor.lookback", "stripping.sigma", "progenitor.mass", "progenitor.radius", "potential.alpha")


def masses(spec: sk.Spec, samples: np.ndarray) -> np.ndarray:
    """(n, 4) Masses inside RADII in 1e11 Msun."""
    return np.array([Host(spec.bind(x).potentials).mass_inside(RADII) for x in samples]) / 1e11


def line(label: str, mass: np.ndarray, weight: np.ndarray) -> None:
    """Print weighted medians, the 68 % interval at 100 kpc and the effective number of samples."""
    weight = weight / weight.sum()
    order = np.argsort(mass, axis=0)
    result = []
    for k in range(len(RADII)):
        w = weight[order[:, k]]
        result.append(np.interp((0.16, 0.5, 0.84), np.cumsum(w) - 0.5 * w, mass[order[:, k], k]))
    medians = "  ".join(f"{f[1]:5.2f}" for f in result)
    effective = 1 / (weight**2).sum()
    print(f"{label:42s} {medians}   {result[1][0]:5.2f} to {result[1][2]:5.2f}  {effective:7.0f}", flush=True)


def main() -> None:
    """Print a line for each choice."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="directory of a fit")
    parser.add_argument("--samples", type=int, default=600, help="samples evaluated again for each choice")
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    results = load_results(given.out)
    spec, samples = results.spec, results.samples
    some = samples[np.linspace(0, len(samples) - 1, min(given.samples, len(samples))).astype(int)]
    mass = masses(spec, some)

    def evaluate(changed: sk.Spec, points: np.ndarray) -> list[Evaluation]:
        with Workers({"full": Posterior(changed)}, given.workers) as pool:
            return pool.evaluate(points)

    def weigh(label: str, new: np.ndarray, old: np.ndarray) -> None:
        ratio = np.where(np.isfinite(new), new - old, -np.inf)
        line(label, mass, np.exp(ratio - ratio.max()))

    print(f"{'':42s} M(<50, 100, 150, 200 kpc), 1e11 Msun   68 % at 100   effective")
    line("the fit", mass, np.ones(len(some)))
    base = evaluate(spec, some)
    lnp = np.array([e.lnp for e in base])
    values, errors = spec.bind(some[0]).observable.data()

    def with_noise(add: bool) -> np.ndarray:
        data = Data(values, errors, add)
        return np.array([e.lnp - e.ln_likelihood + data.gaussian(e.mean, e.variance) for e in base])

    weigh("likelihood.noise = add", with_noise(True), with_noise(False))
    rules = {"literal", "epoch_aware", "turning"} - {spec.document["observable"]["recent_debris"]}
    choices = {
        "stripping.particles = 30000": {"stripping.particles": 30000},
        "another seed": {"seed": spec.seed + 1000},
        "observable.coverage = 0.2": {"observable.coverage": 0.2},
        "stripping.release_radius = 0.8": {"stripping.release_radius": 0.8},
        "stripping.release_radius = 1.2": {"stripping.release_radius": 1.2},
        "stripping.release_times = pericentre": {"stripping.release_times": "pericentre"},
        **{f"observable.recent_debris = {rule}": {"observable.recent_debris": rule} for rule in sorted(rules)},
        "integrator.eta_progenitor = 0.15": {"integrator.eta_progenitor": 0.15},
    }
    for label, values in choices.items():
        weigh(label, np.array([e.lnp for e in evaluate(spec.with_values(values), some)]), lnp)
    moved, column = some.copy(), spec.names.index("progenitor.v_los")
    moved[:, column] += 142.0 - spec.priors[column].centre
    other = spec.with_values({"progenitor.v_los": {"normal": [142.0, 2.0]}})
    weigh("progenitor.v_los = 142 +- 2 km/s", np.array([e.lnp for e in evaluate(other, moved)]), lnp)
    for name in TERCILES:
        values = some[:, spec.names.index(name)]
        for low, high in ((0.0, 1 / 3), (2 / 3, 1.0)):
            a, b = np.quantile(values, [low, high])
            line(f"{name} in {a:.3g} to {b:.3g}", mass, ((values >= a) & (values <= b)).astype(float))


if __name__ == "__main__":
    main()
