"""A neural posterior beside the sampler `emulator`, and the true likelihood at the samples of both.

    python tests/benchmarks/neural_posterior.py examples/gd1/gd1.toml -o DIR --set stripping.particles=3000

It needs the package streamkit-simulate and sbi. A network (NPE of sbi, a neural spline flow) learns from streams at
draws of the priors, which must be uniform. The next round draws from the box that holds all but `OUTSIDE` of the
samples of each parameter on either side, and learns from all draws of all rounds in that box. The streams of each round
lie in DIR with the samples of the network, and a second call makes none that are there.

The table has the shift of the network's means in standard deviations of the emulator, and the ratio of the widths. Then
the network's samples are weighted by the true over the network's density: where the shifts vanish then, the network was
wrong, and where they grow the emulator. The number of samples that the weights leave says how far this can be trusted.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

import streamkit as sk
from streamkit.cli.options import read_settings

OUTSIDE = 2e-3  # share of the samples of a parameter beyond either end of the next box
NETWORK_SAMPLES = 20_000
CALLS = 1000  # samples of the network whose true likelihood is called


def draws_of(spec: sk.Spec, file: Path, draws: int) -> tuple[sk.Array, sk.Array, sk.Array]:
    """Return parameters (n, d) and data (n, m) of the draws that have a stream, and the data of the run file (m,)."""
    import h5py
    from streamkit_simulate import simulate

    simulate(spec, file, draws, resume=file.exists())
    with h5py.File(file) as stored:
        theta, x, observed = (stored[name][:] for name in ("theta", "x", "x_observed"))
    good = np.isfinite(x).all(axis=1)
    return theta[good], x[good], observed


def learned(theta: sk.Array, x: sk.Array, ends: sk.Array, seed: int, log: Path) -> Any:
    """Return the posterior of sbi, learned from parameters (n, d) and data (n, m) of draws in a box of ends (d, 2).

    sbi writes how the training went into the directory ``log``.
    """
    import torch
    from sbi.inference import NPE
    from sbi.utils import BoxUniform
    from torch.utils.tensorboard import SummaryWriter

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    low, high, theta, x = (torch.tensor(each, dtype=torch.float32) for each in (*ends.T, theta, x))
    box, writer = BoxUniform(low, high), SummaryWriter(log)
    inference = NPE(box, density_estimator="nsf", summary_writer=writer, show_progress_bars=False)
    inference.append_simulations(theta, x).train()
    return inference.build_posterior()


def of_network(spec: sk.Spec, given: argparse.Namespace) -> tuple[sk.Array, sk.Array]:
    """Return samples of the network's posterior (n, d) in the last box, and ln of its density (n,)."""
    import torch

    ends = np.array([prior.support for prior in spec.priors])
    theta, x = np.empty((0, len(ends))), None
    for number in range(given.rounds):
        box = {name: {"uniform": each} for name, each in zip(spec.names, ends.tolist(), strict=True)} if number else {}
        narrowed = spec.with_values(box | {"seed": spec.seed + number})
        made, seen, observed = draws_of(narrowed, given.out / f"round{number}.h5", given.draws)
        theta, x = np.concatenate([theta, made]), seen if x is None else np.concatenate([x, seen])
        inside = ((theta >= ends[:, 0]) & (theta <= ends[:, 1])).all(axis=1)
        posterior = learned(theta[inside], x[inside], ends, number, given.out / f"training{number}")
        data = torch.tensor(observed, dtype=torch.float32)
        samples = posterior.sample((NETWORK_SAMPLES,), x=data, show_progress_bars=False)
        ln_density = posterior.log_prob(samples, x=data).numpy()
        samples = samples.numpy().astype(float)
        shown = ", ".join(f"{low:.4g} to {high:.4g}" for low, high in ends)
        print(f"round {number}: {inside.sum()} draws with a stream in the box {shown}", flush=True)
        ends = np.quantile(samples, [OUTSIDE, 1 - OUTSIDE], axis=0).T
    return samples, ln_density


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("run_file", type=Path, help="with one observable, and uniform priors")
    options.add_argument("-o", "--out", type=Path, required=True, help="directory of the streams and of the fit")
    options.add_argument("--draws", type=int, default=10_000, help="of each round")
    options.add_argument("--rounds", type=int, default=3, help="their number")
    options.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help="a field of the run file")
    given = options.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    spec = sk.load(given.run_file).with_values(read_settings(given.set))
    stored = given.out / "network.npz"
    if not stored.exists():
        np.savez(stored, *of_network(spec, given))
    with np.load(stored) as arrays:
        samples, ln_density = arrays.values()
    fit = sk.run(spec.with_sampler("emulator"), given.out / "fit", products=False)
    print(f"emulator: {fit.calls} calls, {'certified' if fit.converged else 'not certified'}")
    some = np.random.default_rng(0).permutation(len(samples))[:CALLS]
    posterior = sk.Posterior(spec)
    true = np.array([posterior.evaluate(each).lnp for each in samples[some]])
    weights = np.exp(true - ln_density[some] - np.max(true - ln_density[some]))
    weights /= weights.sum()
    print(f"{CALLS} samples of the network leave {1 / np.sum(weights**2):.0f} by their weights")
    print("| | emulator | network | shift, sd | width, ratio | shift weighted, sd | width weighted, ratio |")
    print("|---|---|---|---|---|---|---|")
    for i, name in enumerate(spec.names):
        ours, theirs, called = fit[name], samples[:, i], samples[some, i]
        mean, sd = ours.mean(), ours.std()
        centre = weights @ called
        wide = np.sqrt(weights @ (called - centre) ** 2)
        print(f"| {name} | {mean:.4g} +- {sd:.2g} | {theirs.mean():.4g} +- {theirs.std():.2g} "
              f"| {(theirs.mean() - mean) / sd:+.2f} | {theirs.std() / sd:.2f} | {(centre - mean) / sd:+.2f} "
              f"| {wide / sd:.2f} |")  # fmt: skip


if __name__ == "__main__":
    main()
