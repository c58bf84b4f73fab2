"""Whether fits find the true host in data made by live satellites.

    python tests/benchmarks/nbody_recovery.py [-o DIR] [--draws N] [--particles N] [--sampler FIELD=VALUE ...]

Truths are drawn from the prior of examples/mocks/mock_recovery.toml, as by `streamkit calibrate`. Each becomes a live
satellite (plugins/streamkit-nbody), whose apocentres are measured by the run file's rule, with noise of its errors. The
noise that so few particles have themselves is added to the error of the datum. The fit begins at the satellite's core.
Where the model or the live satellite has no apocentres, or no core is left, another truth is drawn. The rank of each
truth, the coverage and the picture are those of `streamkit calibrate`. Finished draws and simulations in DIR are kept.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from streamkit_nbody.plan import Options
from streamkit_nbody.runner import SNAPSHOT
from streamkit_nbody.runner import run as simulate
from streamkit_nbody.simulation import Simulation

import streamkit as sk
from streamkit.nbody import as_stream, read_snapshot
from streamkit.nbody.as_stream import FEWEST
from streamkit.study.calibration import Calibration, Draw, calibration_products, fit_mock
from streamkit.study.grid import draw_pictures, write_tables

RUN_FILE = Path(__file__).parents[2] / "examples" / "mocks" / "mock_recovery.toml"
PLACE = "x", "y", "z", "vx", "vy", "vz"
TRIES = 200
"""Truths of which one must have a core and apocentres."""


def has_apocentres(spec: sk.Spec, theta: np.ndarray) -> bool:
    """Whether the model's stream can be measured; a live satellite takes a thousand times as long as that."""
    try:
        predictions = sk.Posterior(spec).observe(theta).predictions
    except sk.OutOfDomain:
        return False
    return not any(prediction.why_not for prediction in predictions.values())


def observed(truth: sk.Spec, particles: int, folder: Path) -> tuple[dict[str, float], sk.Stream] | None:
    """Disrupt a live satellite; where its core is today and its particles as a stream, None without a core."""
    simulation = Simulation.of(truth, Options(particles))
    state = simulate(simulation, folder, resume=True, progress=False)
    if state.bound.sum() < FEWEST:
        return None
    place = np.concatenate([state.track.q[:, -1], state.track.v[:, -1]])
    core = {f"progenitor.{name}": float(value) for name, value in zip(PLACE, place, strict=True)}
    snapshot = read_snapshot(folder / SNAPSHOT.format(1))
    return core, as_stream(snapshot, truth.with_values(core).bind())


def make_draw(spec: sk.Spec, index: int, particles: int, out: Path) -> Draw:
    """Draw a truth, make a live satellite of it, measure its apocentres, and fit them."""
    rng = np.random.default_rng([spec.seed, 7, index])
    seed = int(rng.integers(1 << 31))
    for attempt in range(TRIES):
        theta = np.array([float(prior.sample(rng, 1)[0]) for prior in spec.priors])
        if not has_apocentres(spec, theta):
            continue
        truth = spec.with_values({**dict(zip(spec.names, theta.tolist(), strict=True)), "seed": seed})
        found = observed(truth, particles, out / f"satellite_{index}_{attempt}")
        observable = truth.bind().observable
        if found is None or observable is None:
            continue
        core, stream = found
        prediction = observable.predict(stream)
        if prediction.why_not:
            continue
        own = dict(zip(prediction.names, prediction.variance, strict=True))
        data = {
            f"observable.{name}": [value, float(np.hypot(error, np.sqrt(own[name])))]
            for name, (value, error) in observable.mock(prediction, rng).items()
        }
        return fit_mock(spec.with_values({**core, **data}), index, theta, spec)
    raise SystemExit(f"draw {index}: none of {TRIES} satellites has a core and apocentres")


def main() -> None:
    """Make the missing draws, one after the other, and write the products."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("nbody-recovery"), metavar="DIR")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--particles", type=int, default=1000, help="of a live satellite; from 1001 on a tree is used")
    parser.add_argument("--sampler", nargs="*", default=[], metavar="FIELD=VALUE", help="fields of [sampler]")
    given = parser.parse_args()
    fields = dict(setting.split("=", 1) for setting in given.sampler)
    spec = sk.load(RUN_FILE)
    if fields:
        spec = spec.with_values({f"sampler.{name}": sk.spec.literal(value) for name, value in fields.items()})
    given.output.mkdir(parents=True, exist_ok=True)
    file = given.output / "draws.jsonl"
    known = [Draw.of_line(line) for line in file.read_text().splitlines()] if file.exists() else []
    for index in range(len(known), given.draws):
        known.append(make_draw(spec, index, given.particles, given.output))
        with file.open("a") as lines:
            lines.write(known[-1].line() + "\n")
        print(f"{index + 1} of {given.draws} draws", flush=True)
    products = calibration_products(Calibration(spec, tuple(known)))
    write_tables(products, given.output)
    draw_pictures(products, given.output)
    print(products.text)


if __name__ == "__main__":
    main()
