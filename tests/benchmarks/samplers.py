"""Which sampler gives most effective samples for its calls, and which is honest: on hard posteriors, or on a run file.

    python tests/benchmarks/samplers.py [--samplers emcee nautilus dynesty] [--seeds 1] [--only banana] [--hidden]
    python tests/benchmarks/samplers.py --samplers emulator [--noise 2]
    python tests/benchmarks/samplers.py --run-file examples/sagittarius/sagittarius.toml --set stripping.particles=1000

The posteriors are those of tests/support/posteriors.py, each with one difficulty and with known moments. For every run
a line: calls of the posterior, effective samples (of the worst parameter for a chain, Kish's for weighted samples),
calls for each of them, the largest error of a mean and of a standard deviation in units of the true standard deviation
("one sd" of them are 1 / sqrt(samples) and 1 / sqrt(2 samples), beside them), R-hat of chains, and what the run itself
says that it lacks. The calls include the search for a start. With --hidden emcee's surrogate cannot tell ln likelihood
from the predictions, as where an observable has a likelihood of its own, and learns it instead. The emulator's calls
may have noise in their predictions, so much that ln likelihood has a standard deviation of --noise. With a run file the
calls cost time: CPU seconds, effective samples per CPU minute and M(<50), M(<100 kpc) are told in place of the errors.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import deque
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

from emulated import OfToy
from posteriors import TOYS, Toy

import streamkit as sk
from streamkit.builtin.samplers.emulator.rounds import Rounds
from streamkit.builtin.samplers.ensemble.sampler import Emcee
from streamkit.cli.options import read_settings
from streamkit.convergence import effective_samples, stuck_walkers
from streamkit.sample import ChainMemory, EvaluationCache, PosteriorTarget, Storage, Workers, run_sampler
from streamkit.stream import Data

SAMPLERS = "emcee", "nautilus", "dynesty"
MOST_CALLS = 4000  # of the emulator
WALKERS, STEPS = 32, 4000


class Found(NamedTuple):
    """Samples and what is known of the run that made them; weights (n,) sum to 1."""

    points: np.ndarray
    weights: np.ndarray
    calls: int
    effective: float
    r_hat: float
    missing: str


def by_ensemble(toy: Toy, seed: int, moves: str, hidden: bool) -> Found:
    """emcee with the moves of the default sampler, and its rules of stopping."""
    stored, sampler = ChainMemory(), Emcee(walkers=WALKERS, steps=STEPS, moves=moves)
    data = Data(toy.data.values + toy.data.errors, toy.data.errors) if hidden else toy.data
    with Workers({"full": toy, "cheap": toy}) as pool:
        target = PosteriorTarget(toy.priors, data, seed, pool, Storage(chain=stored, is_chain=True))
        deque(run_sampler(sampler, target), maxlen=0)
    calls = sum(stored.last.counts[name] for name in ("calls", "search_calls"))
    chain = stored.samples()
    verdict = sampler.convergence(chain)
    used = chain[verdict.discard :]
    effective = float(np.min(effective_samples(used, verdict.tau)))
    stuck = len(stuck_walkers(chain, stored.whole().log_prob))
    lacks = [verdict.missing([f"p{i}" for i in range(used.shape[-1])]), f"{stuck} walkers are stuck" if stuck else ""]
    points = used.reshape(-1, used.shape[-1])
    missing = "; ".join(filter(None, lacks))
    weights = np.full(len(points), 1 / len(points))
    return Found(points, weights, calls, effective, float(np.max(verdict.r_hat)), missing)


def by_plugin(toy: Toy, seed: int, kind: str) -> Found:
    """Another sampler, as a run file has it by default."""
    component = getattr(import_module(f"streamkit_{kind}"), kind.title())()
    with Workers({"full": toy, "cheap": toy}) as pool:
        cache = EvaluationCache()
        target = PosteriorTarget(toy.priors, toy.data, seed, pool, Storage(cache))
        (last,) = deque(run_sampler(component, target), maxlen=1)
    return Found(last.points, last.weights, len(cache), last.ess, np.nan, last.lacks)


def by_emulator(toy: Toy, seed: int, noise: float) -> Found:
    """The emulator, with noise in ln likelihood: n errors in each of m data make m (n^2 + n^4 / 2) of variance."""
    each = np.sqrt(np.sqrt(1 + 2 * noise**2 / len(toy.values)) - 1)
    full, small = (OfToy(toy, each_seed, each) for each_seed in (seed, seed + 50))
    (last,) = deque(Rounds(full, small, noise=False).run(MOST_CALLS), maxlen=1)
    points = last.emulated.space.back(last.samples)
    weights = np.full(len(points), 1 / len(points))
    return Found(points, weights, full.calls + small.calls, len(points), np.nan, last.missing)


def line(toy: Toy, name: str, seed: int, hidden: bool, noise: float) -> str:
    """One run on a toy."""
    kind, _, moves = name.partition(":")
    begin = time.process_time()
    if kind == "emcee":
        found = by_ensemble(toy, seed, moves or "surrogate", hidden)
    else:
        found = by_emulator(toy, seed, noise) if kind == "emulator" else by_plugin(toy, seed, kind)
    spent = time.process_time() - begin
    mean, sd = toy.moments
    centre = found.weights @ found.points
    width = np.sqrt(found.weights @ (found.points - centre) ** 2)
    off, wide = (centre - mean) / sd, width / sd - 1
    worst = [values[np.argmax(np.abs(values))] for values in (off, wide)]
    expected = 1 / np.sqrt(found.effective)
    return (
        f"| {toy.name} | {name} | {found.calls} | {found.effective:.0f} | {found.calls / found.effective:.1f} "
        f"| {worst[0]:+.2f} ({expected:.2f}) | {worst[1]:+.2f} ({expected / np.sqrt(2):.2f}) "
        f"| {found.r_hat:.3f} | {found.missing or 'converged'} | {spent:.0f} |"
    )


def of_run(path: Path, settings: list[str], kind: str) -> str:
    """One fit of a run file by a sampler; settings that begin with a sampler's name and a colon are for that alone."""
    spec = sk.load(path)
    if spec.document.get("sampler", {}).get("kind", "emcee") != kind:
        spec = sk.load(spec.document | {"sampler": {"kind": kind}})
    parts = [text.rpartition(":sampler.") for text in settings]
    spec = spec.with_values(
        read_settings([f"sampler.{rest}" if to else rest for to, _, rest in parts if to in ("", kind)])
    )
    sk.Posterior(spec).evaluate(spec.centre())  # compiled
    with tempfile.TemporaryDirectory() as out:
        begin = time.process_time()
        found = sk.run(spec, out=Path(out) / "run", progress=False, products=False)
        spent = time.process_time() - begin
        masses = found.profiles(np.array([50.0, 100.0]))[0] / 1e11
        r_hat, effective, calls = np.max(found.r_hat), np.min(found.ess), found.calls + found.search_calls
        low, middle, high = np.percentile(masses, [16, 50, 84], axis=0)
        shown = "; ".join(f"{m:.2f} ({a:.2f}-{b:.2f})" for a, m, b in zip(low, middle, high, strict=True))
        return (
            f"| {path.stem} | {kind} | {calls} | {effective:.0f} | {calls / effective:.1f} | {spent:.0f} "
            f"| {60 * effective / spent:.0f} | {shown} | {r_hat:.3f} | {found.note() or 'converged'} |"
        )


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samplers", nargs="+", default=SAMPLERS, metavar="KIND", help="emcee:de has other moves")
    parser.add_argument("--seeds", type=int, default=1, help="runs with seeds 1 to N")
    parser.add_argument("--only", default="", metavar="TEXT", help="only posteriors with this in their name")
    parser.add_argument("--hidden", action="store_true", help="the surrogate learns ln likelihood itself")
    parser.add_argument("--noise", type=float, default=0.0, help="of ln likelihood, in the calls of the emulator")
    parser.add_argument("--run-file", type=Path, help="a run file in place of the toys")
    parser.add_argument(
        "--set", action="append", default=[], metavar="PATH=VALUE", help="'nautilus:sampler.live_points=500' for one"
    )
    given = parser.parse_args()
    if given.run_file is not None:
        print("| run | by | calls | effective | calls each | CPU s | each CPU min | M(<50), M(<100) | R-hat | says |")
        print("|---|---|---|---|---|---|---|---|---|---|")
        for kind in given.samplers:
            print(of_run(given.run_file, given.set, kind), flush=True)
        return
    print("| posterior | sampler | calls | effective | calls each | mean off, sd | sd off | R-hat | says | CPU s |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for toy in (cls() for cls in TOYS):
        for name in given.samplers if given.only in toy.name else ():
            for seed in range(1, given.seeds + 1):
                print(line(toy, name, seed, given.hidden, given.noise), flush=True)


if __name__ == "__main__":
    main()
