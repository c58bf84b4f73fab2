"""What an engine adds to calls of a known length: seconds for 32 calls on two workers, beside the ideal.

    python tests/benchmarks/engines.py [processes|dask]
    mpiexec -n 3 python -m mpi4py.futures tests/benchmarks/engines.py mpi

The calls sleep, so that nothing but the engine is measured; the least of five rounds.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from streamkit.runfile import Engine
from streamkit.sample import Evaluation, Workers, engine

CALLS, WORKERS, ROUNDS = 32, 2, 5


class Sleeping:
    """Takes its time for an answer of the usual size."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def evaluate(self, theta: np.ndarray) -> Evaluation:
        """Sleep."""
        time.sleep(self.seconds)
        return Evaluation(0.0, 0.0, np.zeros(3), np.zeros(3))

    def rejected(self, reason: str) -> Evaluation:
        """Reject."""
        return Evaluation(-np.inf, -np.inf, np.zeros(3), np.zeros(3), reason)


def main(kind: str) -> None:
    """Print a line for each length of a call."""
    for seconds in (0.02, 0.1):
        with engine(Engine(kind=kind, workers=WORKERS)) as where, Workers({"full": Sleeping(seconds)}, where) as pool:
            pool.evaluate(np.zeros((2 * WORKERS, 11)))
            took = []
            for _ in range(ROUNDS):
                begin = time.monotonic()
                pool.evaluate(np.zeros((CALLS, 11)))
                took.append(time.monotonic() - begin)
        ideal = CALLS * seconds / WORKERS
        print(f"{kind}: {CALLS} calls of {1e3 * seconds:.0f} ms: {min(took):.3f} s, ideal {ideal:.2f} s", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", nargs="?", default="processes", choices=("processes", "serial", "mpi", "dask"))
    main(parser.parse_args().kind)
