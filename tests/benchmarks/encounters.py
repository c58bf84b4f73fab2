"""CPU time of a stream beside many bodies that fly by, in alternation with the stream alone.

The subhaloes are the first rows of the table of examples/gd1_gap.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import streamkit as sk
from streamkit.fields import Table
from streamkit.runfile import StreamInputs

RUN = Path(__file__).parents[2] / "examples" / "gd1_gap" / "truth_subhaloes.toml"


def model(bodies: int, particles: int) -> tuple[sk.Model, StreamInputs]:
    """Return the model beside the first bodies of the table, and its inputs."""
    spec = sk.load(RUN).with_values({"stripping.particles": particles})
    table: Table = spec.sections.bodies["subhaloes"][0].centre.table
    document = {key: value for key, value in spec.document.items() if key != "body"}
    if bodies:
        rows = {name: table[name][:bodies].tolist() for name in table.names}
        document["body"] = {"subhaloes": {"kind": "plummer", "table": rows}}
    made = sk.Model(document)
    return made, made.spec.bind()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--particles", type=int, default=4000)
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    models = {bodies: model(bodies, options.particles) for bodies in (0, 1, 10, 100)}
    for each, inputs in models.values():
        each.observe(inputs)
    spent: dict[int, list[float]] = {bodies: [] for bodies in models}
    for _ in range(options.rounds):
        for bodies, (each, inputs) in models.items():
            begin = time.process_time()
            each.observe(inputs)
            spent[bodies].append(time.process_time() - begin)
    print("bodies   CPU ms   ratio")
    for bodies, seconds in spent.items():
        ratio = np.median(np.array(seconds) / np.array(spent[0]))
        print(f"{bodies:6d}   {1e3 * min(seconds):6.1f}   {ratio:5.2f}")


if __name__ == "__main__":
    main()
