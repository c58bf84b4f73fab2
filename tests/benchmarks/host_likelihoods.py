"""The product of the files of a run's streams beside the run itself.

    streamkit export RUN --host-likelihood -o FILES
    python tests/benchmarks/host_likelihoods.py RUN FILES

RUN is a finished run of several streams by the sampler `emulator`. Hosts are drawn from a Gaussian, wider than the
run's posterior of the parameters of the host, and weighted by the product of all files, the priors and the data on the
host. The table has the shift of each mean in standard deviations of the run, and the ratio of the widths. The last
number of the head is the effective number of hosts.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np

import streamkit as sk

HOSTS, WIDER = 4000, 1.3
RADII = np.array([10.0, 20.0, 50.0, 100.0])  # kpc, of the enclosed masses
SOME = 600  # hosts whose masses are computed


def product_of(run: sk.Results, files: Path) -> sk.Posterior:
    """Return the posterior of the host by the files in a directory, and by the run's data on the host."""
    document = {key: run.spec.document[key] for key in ("seed", "sun", "potential", "body", "data", "integrator")
                if key in run.spec.document}  # fmt: skip
    read = {file.name.removesuffix("_host.ecsv"): {"kind": "host_likelihood", "table": str(file)}
            for file in sorted(files.glob("*_host.ecsv"))}  # fmt: skip
    return sk.Posterior(sk.load(document | {"data": {**document.get("data", {}), **read}}))


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("run", type=Path, help="directory of the run")
    options.add_argument("files", type=Path, help="directory of the files")
    given = options.parse_args()
    run, files = sk.load_results(given.run), given.files.absolute()
    os.chdir(given.run)  # the paths of its data are in the run file relative to it
    posterior, rng = product_of(run, files), np.random.default_rng(0)
    spec = posterior.spec
    is_log = np.array([prior.support[0] > 0 for prior in spec.priors])
    theta = np.array([run[name] for name in spec.names]).T
    y = np.where(is_log, np.log(np.where(is_log, theta, 1.0)), theta)
    white = WIDER * rng.standard_normal((HOSTS, len(spec.names)))
    drawn = y.mean(axis=0) + white @ np.linalg.cholesky(np.cov(y.T)).T
    hosts = np.where(is_log, np.exp(np.where(is_log, drawn, 0.0)), drawn)
    begin = time.monotonic()
    ln_p = np.array([posterior.evaluate(host).lnp for host in hosts]) + np.where(is_log, drawn, 0.0).sum(axis=1)
    seconds = time.monotonic() - begin
    ln_w = ln_p + 0.5 * np.sum(white**2, axis=1) / WIDER**2
    weights = np.where(np.isfinite(ln_p), np.exp(ln_w - ln_w[np.isfinite(ln_w)].max()), 0.0)
    weights /= weights.sum()
    print(f"{HOSTS} hosts in {seconds:.0f} s, {np.mean(~np.isfinite(ln_p)):.1%} outside; {1 / np.sum(weights**2):.0f}")
    print("| | run | shift, sd | width, ratio |\n|---|---|---|---|")
    for name, ours, each in zip(spec.names, y.T, drawn.T, strict=True):
        mean = weights @ each
        _print(name, ours, mean, np.sqrt(weights @ (each - mean) ** 2))
    some = hosts[rng.choice(HOSTS, SOME, p=weights)]
    masses = np.log([sk.Host(spec.host(host)).mass_inside(RADII) for host in some])
    for radius, ours, each in zip(RADII, np.log(run.profiles(RADII)[0]).T, masses.T, strict=True):
        _print(f"ln M(<{radius:g} kpc)", ours, each.mean(), each.std())


def _print(name: str, ours: sk.Array, mean: float, width: float) -> None:
    sd = ours.std()
    print(f"| {name} | {ours.mean():.4g} +- {sd:.2g} | {(mean - ours.mean()) / sd:+.2f} | {width / sd:.2f} |")


if __name__ == "__main__":
    main()
