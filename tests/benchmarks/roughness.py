"""How rough ln L is along one parameter, against the number of particles.

    python tests/benchmarks/roughness.py RUN.toml PARAMETER HALF [--set PATH=VALUE ...] [--particles N ...] [--points N]

The run file is taken at the centre of its priors, with --set at other values. Its data are replaced by a mock of a
stream of four times the largest number of particles, with noise. ln L is computed at even steps up to HALF, in the
unit of the run file, on both sides of the centre; its roughness is the rms about a polynomial of fourth degree. The
random numbers of the particles stay, as in a fit. Below 0.3 a fit does not notice it.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

import streamkit as sk
from streamkit.observe import parts_of
from streamkit.runfile import literal
from streamkit.study.ablation.runner import varied

DEGREE = 4


def with_mock(spec: sk.Spec, particles: int) -> sk.Spec:
    """Return the run file with data that a stream at the centre of the priors might have given."""
    rng = np.random.default_rng(spec.seed)
    many = spec.with_particles(particles).with_values({"seed": spec.seed + 1})
    observation = sk.Posterior(many).observe(spec.centre())
    fields: dict[str, Any] = {}
    for name, inputs in spec.bind_all(spec.centre()).streams.items():
        parts = parts_of(observation.predictions[name])
        for label, observable in inputs.observables.items():
            path = spec.sections.streams[name].observables[label].path
            mock = observable.mock(parts[label], rng)
            fields |= {f"{path}.{field}": value for field, value in mock.items()}
    return spec.with_values(fields)


def main() -> None:
    """Print a row of Markdown for each number of particles."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run_file", type=Path, metavar="RUN.toml")
    parser.add_argument("parameter", metavar="PARAMETER")
    parser.add_argument("half", type=float, metavar="HALF")
    parser.add_argument("--set", nargs="*", default=[], metavar="PATH=VALUE")
    parser.add_argument("--particles", nargs="*", type=int, default=[2500, 5000, 10000, 20000])
    parser.add_argument("--points", type=int, default=21)
    given = parser.parse_args()
    changes = {path: literal(value) for path, value in (word.split("=", 1) for word in given.set)}
    spec = varied(sk.load(given.run_file), changes)
    spec = with_mock(spec, 4 * max(given.particles))
    centre, which = spec.centre(), spec.names.index(given.parameter)
    s = np.linspace(-1.0, 1.0, given.points)
    print(f"| particles | roughness along {given.parameter} +- {given.half:g} | range of ln L | CPU s |")
    for particles in given.particles:
        posterior = sk.Posterior(spec.with_values({"stripping.particles": particles}))
        values, begin = [], time.process_time()
        for step in s:
            theta = centre.copy()
            theta[which] += step * given.half
            values.append(posterior(theta)[1])
        spent = (time.process_time() - begin) / len(s)
        ln_l = np.array(values)
        rest = ln_l - np.polynomial.Polynomial.fit(s, ln_l, DEGREE)(s)
        rms = np.sqrt((rest**2).sum() / (len(s) - DEGREE - 1))
        print(f"| {particles} | {rms:.2f} | {np.ptp(ln_l):.1f} | {spent:.2f} |", flush=True)


if __name__ == "__main__":
    main()
