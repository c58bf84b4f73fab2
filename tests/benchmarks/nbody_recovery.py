"""Whether fits find the true host in data made by live satellites.

    python tests/benchmarks/nbody_recovery.py [RUN.toml] [-o DIR] [--draws N] [--particles N] [--dissolved]
                                              [--sampler FIELD=VALUE ...] [--set PATH=VALUE ...]
                                              [--fit PATH=VALUE ...] [--passages N ...]

Truths are drawn from the prior of a run file, examples/mocks/mock_recovery.toml if none is named, as by `streamkit
calibrate`. Each becomes a live satellite (plugins/streamkit-nbody), which is measured by the run file's observable,
with noise of its errors. The noise that so few particles have themselves is added to the errors of the data. The fit
begins at the satellite's core; where a coordinate of the progenitor is free, the core's is the truth. Where the model
or the live satellite cannot be measured, or no core is left, another truth is drawn; with --dissolved a satellite
without a core is taken, and the fit begins at its point mass's place. The rank of each truth, the coverage and the
picture are those of `streamkit calibrate`. Finished draws and simulations in DIR are kept.

With --set the run file is changed for truths and fits, with --fit for the fits alone: another stripping scheme, say.
With --passages each truth is fitted once for each number of pericentre passages of a live progenitor, and the fit with
the largest ln posterior counts. For example, with nothing of the satellite known to the fit:

    python tests/benchmarks/nbody_recovery.py -o live --draws 40 --particles 20000
        --set 'progenitor.radius={ uniform = ["0.5 kpc", "1.2 kpc"] }'
        --fit stripping.kind=restricted_nbody stripping.particles=20000 --passages 2 3 4

A draw with 2 x 10^4 particles takes hours on one core.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from streamkit_nbody.plan import Options
from streamkit_nbody.runner import SNAPSHOT
from streamkit_nbody.runner import run as simulate
from streamkit_nbody.simulation import Simulation

import streamkit as sk
from streamkit.nbody import as_stream, read_snapshot
from streamkit.nbody.as_stream import FEWEST
from streamkit.runfile.inputs import ONLY
from streamkit.stream import seen_from, sky_matrix
from streamkit.study.ablation.variants import varied
from streamkit.study.calibration import Calibration, Draw, calibration_products, measurable_truths, rank_truth
from streamkit.study.grid import draw_pictures, write_tables

RUN_FILE = Path(__file__).parents[2] / "examples" / "mocks" / "mock_recovery.toml"
TRIES = 200  # truths of which one must be measurable, by the model and as a live satellite


def place_of(truth: sk.Spec, q: np.ndarray, v: np.ndarray) -> dict[str, float]:
    """Return the fields of [progenitor] that say where the core is, in the coordinates of the run file."""
    place = truth.sections.streams[ONLY].phase
    names, frame = place.cls.coordinates(), getattr(place.centre, "frame", None)
    if frame is None:
        values = [*q, *v]
    else:
        seen = seen_from(truth.bind().sun.observer, q[:, None], v[:, None], sky_matrix(frame))
        values = [each[0] for each in seen[: len(names)]]
    return {f"{place.path}.{name}": float(value) for name, value in zip(names, values, strict=True)}


def observed(
    truth: sk.Spec, particles: int, folder: Path, dissolved: bool
) -> tuple[dict[str, float], sk.Stream] | None:
    """Disrupt a live satellite; where its core is today and its particles as a stream.

    None without a core, unless those that have dissolved are wanted too: then its place is that of the point mass.
    """
    simulation = Simulation.of(truth, Options(particles))
    state = simulate(simulation, folder, resume=True, progress=False)
    whole = state.bound.sum() >= FEWEST
    if not (whole or dissolved):
        return None
    snapshot = read_snapshot(folder / SNAPSHOT.format(1))
    if not whole:
        return {}, as_stream(replace(snapshot, core=None), truth.bind())
    core = place_of(truth, state.track.q[:, -1], state.track.v[:, -1])
    return core, as_stream(snapshot, truth.with_values(core).bind())


def noisy(mock: dict[str, Any], own: np.ndarray) -> dict[str, Any]:
    """Return mock data with their own variance, in the order of the numbers, added to their errors."""
    found: dict[str, Any] = {}
    start = 0
    for name, datum in mock.items():
        error = np.atleast_1d(datum["error"] if isinstance(datum, dict) else datum[1])
        part = own[start : (start := start + len(error))]
        error = np.hypot(error, np.sqrt(part)).tolist()
        found[name] = datum | {"error": error} if isinstance(datum, dict) else [datum[0], error[0]]
    return found


def best_fit(spec: sk.Spec, passages: list[int]) -> sk.Results:
    """Return the fit, or of those with each number of passages the one with the largest ln posterior."""
    specs = [spec.with_values({"stripping.passages": number}) for number in passages] or [spec]
    fits = [sk.run(one, engine="serial", progress=False) for one in specs]
    for number, fit in zip(passages, fits, strict=False):
        print(f"  {number} passages: largest ln posterior {fit.log_prob.max():.1f}", flush=True)
    return max(fits, key=lambda fit: float(fit.log_prob.max()))


def settings(words: list[str]) -> dict[str, Any]:
    """Read PATH=VALUE as the command line does."""
    return {path: sk.runfile.literal(value) for path, value in (word.split("=", 1) for word in words)}


def make_draw(
    spec: sk.Spec, changes: dict[str, Any], passages: list[int], index: int, particles: int, out: Path, dissolved: bool
) -> Draw:
    """Draw a truth, make a live satellite of it, measure it, and fit the data with changes of the run file."""
    rng = np.random.default_rng([spec.seed, 7, index])
    seed = int(rng.integers(1 << 31))
    for attempt, theta, _ in measurable_truths(
        spec, sk.Posterior(spec), rng, TRIES
    ):  # a thousandth of a live satellite
        truth = spec.with_values({**dict(zip(spec.names, theta.tolist(), strict=True)), "seed": seed})
        found = observed(truth, particles, out / f"satellite_{index}_{attempt}", dissolved)
        observable = truth.bind().observable
        if found is None or observable is None:
            continue
        core, stream = found
        prediction = observable.predict(stream)
        if prediction.why_not:
            continue
        data = noisy(observable.mock(prediction, rng), prediction.variance[np.isfinite(prediction.mean)])
        known = {path: value for path, value in core.items() if path not in spec.names}
        true = np.array([core.get(name, value) for name, value in zip(spec.names, theta, strict=True)])
        fields = {f"observable.{name}": value for name, value in data.items()}
        results = best_fit(varied(spec.with_values(known | fields), changes), passages)
        return rank_truth(results, index, true, spec)
    raise SystemExit(f"draw {index}: none of {TRIES} satellites has a core and can be measured")


def main() -> None:
    """Make the missing draws, one after the other, and write the products."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run_file", type=Path, nargs="?", default=RUN_FILE, metavar="RUN.toml")
    parser.add_argument("-o", "--output", type=Path, default=Path("nbody-recovery"), metavar="DIR")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--particles", type=int, default=1000, help="of a live satellite; from 1001 on a tree is used")
    parser.add_argument("--dissolved", action="store_true", help="take satellites without a core, too")
    parser.add_argument("--sampler", nargs="*", default=[], metavar="FIELD=VALUE", help="fields of [sampler]")
    parser.add_argument("--set", nargs="*", default=[], metavar="PATH=VALUE", help="changes for truths and fits")
    parser.add_argument("--fit", nargs="*", default=[], metavar="PATH=VALUE", help="changes for the fits alone")
    parser.add_argument("--passages", nargs="*", type=int, default=[], help="numbers of passages that are fitted")
    given = parser.parse_args()
    sampler = {f"sampler.{name}": value for name, value in settings(given.sampler).items()}
    spec = sk.load(given.run_file).with_values(sampler | settings(given.set))
    given.output.mkdir(parents=True, exist_ok=True)
    file = given.output / "draws.jsonl"
    known = [Draw.of_line(line) for line in file.read_text().splitlines()] if file.exists() else []
    for index in range(len(known), given.draws):
        changes = settings(given.fit)
        draw = make_draw(spec, changes, given.passages, index, given.particles, given.output, given.dissolved)
        known.append(draw)
        with file.open("a") as lines:
            lines.write(known[-1].line() + "\n")
        print(f"{index + 1} of {given.draws} draws", flush=True)
    products = calibration_products(Calibration(spec, tuple(known)))
    write_tables(products, given.output)
    draw_pictures(products, given.output)
    print(products.text)


if __name__ == "__main__":
    main()
