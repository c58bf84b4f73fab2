"""How cost and memory grow: with particles, look-back time, number of calls and workers.

    python tests/benchmarks/scaling.py [--largest 1000000] [--calls 10000]

The run file is examples/sagittarius/sagittarius.toml at one point of its prior; CPU seconds of one core, resident
memory in MB.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path

import numpy as np

import streamkit as sk
from streamkit.sample import Posterior, Workers

RUN = Path(__file__).parents[2] / "examples" / "sagittarius" / "sagittarius.toml"
POINT = {
    "potential.v0": 248.0, "potential.rs": 19.0, "potential.alpha": 0.74, "progenitor.mass": 6.4e8,
    "progenitor.radius": 0.75, "progenitor.distance": 26.0, "progenitor.pm_l_cosb": -2.39, "progenitor.pm_b": 1.83,
    "progenitor.v_los": 153.8, "progenitor.lookback": 5.3, "stripping.sigma": 5.2,
}  # fmt: skip


def seconds(spec: sk.Spec, lookback: float = 5.3, rounds: int = 3) -> float:
    """CPU seconds of one stream, the least of some rounds."""
    model = sk.Model(spec)
    values = POINT | {"progenitor.lookback": lookback}
    model.stream(values)
    best = np.inf
    for _ in range(rounds):
        begin = time.process_time()
        model.stream(values)
        best = min(best, time.process_time() - begin)
    return best


def resident() -> float:
    """Largest resident memory of this process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Print the four tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--largest", type=int, default=10**6, help="largest number of particles")
    parser.add_argument("--calls", type=int, default=10**4, help="calls of the memory test, with 300 particles each")
    given = parser.parse_args()
    spec = sk.load(RUN)
    theta = np.array([POINT[name] for name in spec.names])

    few = Posterior(spec.with_values({"stripping.particles": 300, "progenitor.lookback": POINT["progenitor.lookback"]}))
    some = np.array([POINT[name] for name in few.spec.names])
    for call in range(1, given.calls + 1):
        few.evaluate(some)
        if call in (given.calls // 10, given.calls):
            print(f"{call:8d} calls of 300 particles  {resident():7.1f} MB")
    Posterior(spec).evaluate(theta)
    print(f"one call with the run file's own number of particles: {resident():.1f} MB")

    for lookback in (1.0, 2.0, 4.0, 8.0):
        print(f"{lookback:8.1f} Gyr  {seconds(spec, lookback):8.4f} s")
    particles = 1000
    while particles <= given.largest:
        value = seconds(spec.with_values({"stripping.particles": particles}), rounds=3 if particles < 10**5 else 1)
        print(f"{particles:8d} particles  {value:8.4f} s  {1e6 * value / particles:6.2f} us each  {resident():7.1f} MB")
        particles *= 10

    rates = {}
    points = np.tile(theta, (64, 1))
    for count in (1, 2, 1, 2):
        with Workers({"full": Posterior(spec)}, count) as pool:
            pool.evaluate(points[: 2 * count])
            begin = time.monotonic()
            pool.evaluate(points)
            rates.setdefault(count, []).append(len(points) / (time.monotonic() - begin))
    one, two = max(rates[1]), max(rates[2])
    print(f"calls/s: one worker {one:.1f}, two {two:.1f}, ratio {two / one:.2f}")


if __name__ == "__main__":
    main()
