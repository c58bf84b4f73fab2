"""What an extra error does to the calibration of a fit whose tracks are smoothly wrong by more than they state.

    python tests/benchmarks/extra_error.py [--draws 100] [--factor 3]
    python tests/benchmarks/extra_error.py --emulator 3

Each draw has a truth of the prior, and tracks of its stream with white noise of their stated errors and a smooth error
of `factor` times those, alike over 8 deg. It is fitted with stated errors alone, with dispersions that are free, and
with extra errors and their length free. The lines give how many 68 and 95 % intervals hold the truth, the standard
deviation of the normal scores of the truth (1 where intervals are right), the median width, and the median p of all
data. The predictions are polynomials through those of streams, the same for truth and fit: errors alone are tested.

With --emulator so many mock skies are fitted by the sampler `emulator` too, which makes streams of its own, and by
emcee with the polynomials. The lines give mean and standard deviation of both, and the shift of the means in the
latter; of the extra errors and their length by their logarithms.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import emcee
import numpy as np
from scipy.special import ndtri
from scipy.stats import chi2

import streamkit as sk

LENGTH = 8.0  # degrees
AT = np.linspace(-25, 25, 11)
STATED = {"phi2": (0.0, 0.5), "distance": (25.0, 0.7), "radial_velocity": (150.0, 5.0)}  # a value, and the error
BOUNDS = (0.1, 20.0)  # of the log-uniform prior of an extra error, in stated errors
RUN: dict[str, Any] = {
    "seed": 3,
    "potential": {"kind": "tf", "v0": {"uniform": [190, 270]}, "rs": 12, "alpha": {"uniform": [0.25, 0.45]}},
    "progenitor": {
        "kind": "plummer", "mass": 6.4e8, "radius": 0.85, "l": 5.5689, "b": -14.1669, "distance": 25.2,
        "pm_l_cosb": -2.44, "pm_b": 1.97, "v_los": 153, "lookback": 1.5,
    },
    "stripping": {"kind": "mlcs", "particles": 4000, "sigma": 10},
    "integrator": {"kind": "leapfrog", "step": 0.06},
    "observable": {
        "kind": "track", "kernel": 4, "frame": {"pole": [128.9, -56.9], "origin": [283.6, -30.5]},
        **{name: {"phi1": AT.tolist(), name: [value] * len(AT), "error": [error] * len(AT)}
           for name, (value, error) in STATED.items()},
    },
}  # fmt: skip
GRID, DEGREE, WALKERS, STEPS = (13, 9), 4, 40, 1500
EXTRA = {f"{name}_extra_error": error for name, (_, error) in STATED.items()}
DISPERSION = {f"{name}_dispersion": error for name, (_, error) in STATED.items()}
KINDS: dict[str, dict[str, tuple[float, float]]] = {  # the ranges of free numbers, log-uniform
    "stated errors": {},
    "dispersions": {name: (BOUNDS[0] * error, BOUNDS[1] * error) for name, error in DISPERSION.items()},
    "extra errors": {name: (BOUNDS[0] * error, BOUNDS[1] * error) for name, error in EXTRA.items()}
    | {"extra_error_length": (2.0, 40.0)},
}


class Tracks:
    """The predictions of streams as polynomials of the parameters of the host."""

    def __init__(self, repeats: int = 1, degree: int = DEGREE) -> None:
        """Learn them by streams of one seed, or by ``repeats`` with fresh random numbers, whose noise averages out."""
        spec = sk.load(RUN)
        self.names, self.priors, self.degree = spec.names, spec.priors, degree
        self.low, self.high = np.array([prior.support for prior in spec.priors]).T
        axes = [np.linspace(low, high, n) for low, high, n in zip(self.low, self.high, GRID, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        means = []
        for repeat in range(repeats):
            seeded = sk.load(RUN | {"seed": RUN["seed"] + repeat})
            model = sk.Model(seeded, fresh=repeats > 1)
            means += [model.observe(seeded.bind(theta))[1].mean for theta in points]
        self.observable = spec.bind().observable
        self.coefficients = np.linalg.lstsq(self._terms(np.tile(points, (repeats, 1))), np.array(means))[0]

    def _terms(self, points: np.ndarray) -> np.ndarray:
        x, y = (2 * (points - self.low) / (self.high - self.low) - 1).T
        return np.stack([x**i * y**j for i in range(self.degree + 1) for j in range(self.degree + 1 - i)], axis=1)

    def __call__(self, points: np.ndarray) -> sk.Prediction:
        """Return the predictions (n, m) at parameters (n, 2)."""
        mean = self._terms(points) @ self.coefficients
        return sk.Prediction(self.observable.names, mean, 0 * mean, details=dict.fromkeys(DETAILS, 0 * mean))

    def fit(self, observable: Any, free: dict[str, tuple[float, float]], rng: np.random.Generator) -> np.ndarray:
        """(n, 2 + k) Return samples of the host's parameters and of the free numbers of the comparison."""
        low = np.concatenate([self.low, [np.log(each[0]) for each in free.values()]])
        high = np.concatenate([self.high, [np.log(each[1]) for each in free.values()]])

        def ln_posterior(points: np.ndarray) -> np.ndarray:
            inside = ((points > low) & (points < high)).all(axis=1)
            found = np.full(len(points), -np.inf)
            numbers = {name: np.exp(points[inside, 2 + i])[:, None] for i, name in enumerate(free)}
            compared = observable.model_copy(update=numbers)
            found[inside] = compared.ln_likelihood(self(points[inside, :2]), False)
            return found

        begin = rng.uniform(low, high, (2000, len(low)))
        begin = begin[np.argsort(-ln_posterior(begin))[:WALKERS]]
        np.random.seed(int(rng.integers(1 << 31)))  # noqa: NPY002  of emcee
        sampler = emcee.EnsembleSampler(WALKERS, len(low), ln_posterior, vectorize=True)
        sampler.run_mcmc(begin, STEPS)
        samples = sampler.get_chain(discard=STEPS // 3, thin=10, flat=True)
        samples[:, 2:] = np.exp(samples[:, 2:])
        return samples


DETAILS = ("spread", "ln_coverage")


def first_of(many: sk.Prediction) -> sk.Prediction:
    """Return the first of several predictions."""
    mean = many.mean[0]
    return sk.Prediction(many.names, mean, 0 * mean, details=dict.fromkeys(DETAILS, 0 * mean))


def sky(tracks: Tracks, rng: np.random.Generator, factor: float) -> tuple[Any, dict[str, Any], dict[str, Any], Any]:
    """Return the parameters of a mock sky, its smooth errors, the fields of the observable, and its data."""
    theta = np.array([float(prior.sample(rng, 1)[0]) for prior in tracks.priors])
    wrong = {name: factor * error for name, error in EXTRA.items()} | {"extra_error_length": LENGTH}
    single = first_of(tracks(theta[None]))
    fields = {name: getattr(tracks.observable, name) for name in type(tracks.observable).model_fields}
    return theta, wrong, fields, type(tracks.observable)(**(fields | wrong)).mock(single, rng)


def beside_emulator(tracks: Tracks, index: int, factor: float) -> Iterator[str]:
    """Yield a line for each number that was fitted to a mock sky by the emulator and by emcee."""
    rng, free = np.random.default_rng([7, index]), KINDS["extra errors"]
    theta, _, fields, mock = sky(tracks, rng, factor)
    priors = {name: {"log_uniform": list(ends)} for name, ends in free.items()}
    run = RUN | {"observable": RUN["observable"] | mock | priors, "sampler": {"kind": "emulator"}}
    results = sk.run(run, progress=False)
    sampled = tracks.fit(type(tracks.observable)(**(fields | mock)), free, rng)
    note = "certified" if results.converged else "not certified"
    yield f"sky {index}, truth {np.round(theta, 3).tolist()}: {results.calls} calls, {note}"
    for i, name in enumerate((*tracks.names, *(f"observable.{each}" for each in free))):
        take = np.log if i >= len(tracks.names) else np.asarray
        ours, theirs = take(results[name]), take(sampled[:, i])
        yield (f"{name:40s} emcee {theirs.mean():8.3f} +- {theirs.std():6.3f}   emulator {ours.mean():8.3f} +- "
               f"{ours.std():6.3f}   shift {(ours.mean() - theirs.mean()) / theirs.std():+.2f} sd")  # fmt: skip


def one(tracks: Tracks, index: int, factor: float) -> dict[str, Any]:
    """Return for each kind of fit the fractions of its samples below the true numbers, their widths, and p."""
    rng = np.random.default_rng([7, index])
    theta, wrong, fields, mock = sky(tracks, rng, factor)
    observable, found = type(tracks.observable)(**(fields | mock)), {}
    for kind, free in KINDS.items():
        samples = tracks.fit(observable, free, rng)
        names = [*tracks.names, *free]
        true = dict(zip(tracks.names, theta.tolist(), strict=True)) | wrong
        chances = []
        for sample in samples[:: len(samples) // 100]:
            fitted = type(observable)(**(fields | mock | dict(zip(free, sample[2:].tolist(), strict=True))))
            residuals = fitted.residuals(first_of(tracks(sample[None, :2])), False)
            chances.append(chi2.sf(np.sum(residuals**2), len(residuals)))
        found[kind] = {
            "ranks": {n: float((samples[:, i] < true[n]).mean()) for i, n in enumerate(names) if n in true},
            "width": {n: float(samples[:, i].std()) for i, n in enumerate(names)},
            "p": float(np.mean(chances)),
        }
    return found


def lines(found: list[dict[str, Any]], kind: str) -> Iterator[str]:
    """Yield a line for each number that was fitted."""
    for name in found[0][kind]["ranks"]:
        ranks = np.array([each[kind]["ranks"][name] for each in found])
        width = np.median([each[kind]["width"][name] for each in found])
        scores = ndtri(np.clip(ranks, 1e-4, 1 - 1e-4))
        inside = [int((np.abs(ranks - 0.5) < level / 2).sum()) for level in (0.68, 0.95)]
        yield (f"{kind:14s} {name:32s} {inside[0]:3d} and {inside[1]:3d} of {len(found)}   scores {scores.std():.2f}   "
               f"width {width:.3g}")  # fmt: skip
    yield f"{kind:14s} p of all data, median {np.median([each[kind]['p'] for each in found]):.2g}"


def main() -> None:
    """Make the draws, and print what the intervals hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--factor", type=float, default=3.0, help="smooth over stated errors")
    parser.add_argument("--emulator", type=int, default=0, metavar="N", help="skies fitted by the emulator too")
    given = parser.parse_args()
    if given.emulator:
        better = Tracks(repeats=8, degree=6)
        for index in range(given.emulator):
            print(*beside_emulator(better, index, given.factor), sep="\n", flush=True)
        return
    tracks = Tracks()
    found = [one(tracks, index, given.factor) for index in range(given.draws)]
    for kind in KINDS:
        print(*lines(found, kind), sep="\n", flush=True)


if __name__ == "__main__":
    main()
