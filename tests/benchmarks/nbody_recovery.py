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

With --set the run file is changed for truths and fits, with --fit for a fit alone: another stripping scheme, say. Given
several times, each is a fit of the same data, with its own products in DIR/fit_1, DIR/fit_2 and so on; truths must be
measurable by the first. With --passages the number of pericentre passages of each truth is drawn from those named, and
its live satellite begins at the apocentre before them. A live progenitor is fitted without knowing that number: a
search with few particles excludes some, each other one is fitted, and the fit with the largest ln posterior counts.
The look-back time of other schemes is the true one. The mean error of the masses is printed last. For example, with
nothing of the satellite known to the fit:

    python tests/benchmarks/nbody_recovery.py -o live --draws 40 --particles 3000 --sampler kind=emulator
        --set 'progenitor.radius={ uniform = ["0.5 kpc", "1.2 kpc"] }' --passages 2 3 4
        --fit stripping.kind=restricted_nbody stripping.particles=3000 --fit stripping.particles=3000

A draw of this takes some three minutes on a slow core.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
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
from streamkit.study.ablation.runner import varied
from streamkit.study.calibration import MASS_RADII, Calibration, Draw, calibration_products, rank_truth
from streamkit.study.grid import draw_pictures, write_tables

RUN_FILE = Path(__file__).parents[2] / "examples" / "mocks" / "mock_recovery.toml"
TRIES = 200  # truths of which one must be measurable, by the model and as a live satellite
LOOKBACK = "progenitor.lookback"
LONGEST = 7.0  # Gyr in which the numbers of passages that are tried must fit
LITTLE = 0.01  # share of the mass that must be left by the model, before a live satellite is made
DRAWS, MASSES = "draws.jsonl", "masses.jsonl"
# The search for the number of passages: particles, draws from the prior, and generations of so many around the best.
FEW, FROM_PRIOR, GENERATIONS, AROUND, PARENTS = 1000, 48, 2, 20, 8
EXCLUDED = 2.0  # in ln posterior below the best number of passages


def place_of(truth: sk.Spec, q: np.ndarray, v: np.ndarray) -> dict[str, float]:
    """Return the fields of [progenitor] that say where the core is, in the coordinates of the run file."""
    place = truth.sections.streams[ONLY].phase
    names, frame = place.cls.coordinates(), getattr(place.centre, "frame", getattr(place.cls, "sky", None))
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


def settings(words: list[str]) -> dict[str, Any]:
    """Read PATH=VALUE as the command line does."""
    return {path: sk.runfile.literal(value) for path, value in (word.split("=", 1) for word in words)}


def lookback_of(truth: sk.Spec, number: int) -> float | None:
    """Return the Gyr since the apocentre before so many pericentre passages; None if it is too long ago."""
    orbit = Simulation.of(truth.with_values({LOOKBACK: LONGEST}), Options(1000)).orbit
    pericentres = orbit.pericentres()
    if len(pericentres) < number:
        return None
    before = orbit.apocentres()[orbit.apocentres() < pericentres[-number]]
    return -float(before[-1]) / sk.GYR if len(before) else None


def for_passages(spec: sk.Spec, number: int) -> sk.Spec:
    """Return a run file whose live progenitor makes so many passages, whatever its orbit is."""
    return spec.with_values({"stripping.passages": number, LOOKBACK: LONGEST})


def largest_posterior(spec: sk.Spec, rng: np.random.Generator) -> float:
    """Return the largest ln posterior of some streams of few particles: from the prior, then around the best."""
    posterior = sk.Posterior(spec.with_particles(FEW))
    points = np.array([[float(prior.sample(rng, 1)[0]) for prior in spec.priors] for _ in range(FROM_PRIOR)])
    values = np.array([posterior(theta)[0] for theta in points])
    for _ in range(GENERATIONS):
        parents = points[np.argsort(-values)[:PARENTS]]
        children = parents.mean(axis=0) + rng.normal(size=(AROUND, PARENTS)) @ (parents - parents.mean(axis=0)) / 2
        points = np.concatenate([points, children])
        values = np.concatenate([values, [posterior(theta)[0] for theta in children]])
    return float(values.max())


def best_fit(spec: sk.Spec, passages: list[int], rng: np.random.Generator) -> tuple[sk.Results, int]:
    """Return the fit and its number of passages, of those that a search does not exclude the most probable one."""
    if not passages or not isinstance(spec.bind().stripping, sk.LiveStripping):
        return sk.run(spec, engine="serial", progress=False), 0
    specs = {number: for_passages(spec, number) for number in passages}
    searched = {number: largest_posterior(one, rng) for number, one in specs.items()}
    print(f"  largest ln posterior by passages: { {k: round(v, 1) for k, v in searched.items()} }", flush=True)
    kept = [number for number, value in searched.items() if value > max(searched.values()) - EXCLUDED]
    fits = {number: sk.run(specs[number], engine="serial", progress=False) for number in kept}
    best = max(kept, key=lambda number: float(fits[number].log_prob.max()))
    return fits[best], best


def truths(
    spec: sk.Spec, model: sk.Spec, passages: list[int], rng: np.random.Generator
) -> Iterator[tuple[int, np.ndarray, sk.Spec, int]]:
    """Draw truths whose stream by the model of the fit can be measured; with their number of passages, or 0."""
    seed, number = int(rng.integers(1 << 31)), 0
    for attempt in range(TRIES):  # a thousandth of a live satellite each
        theta = np.array([float(prior.sample(rng, 1)[0]) for prior in spec.priors])
        truth = spec.with_values({**dict(zip(spec.names, theta.tolist(), strict=True)), "seed": seed})
        trial = model
        if passages:
            number = int(rng.choice(passages))
            lookback = lookback_of(truth, number)
            if lookback is None:
                continue
            truth = truth.with_values({LOOKBACK: lookback})
            live = isinstance(model.bind().stripping, sk.LiveStripping)
            trial = for_passages(model, number) if live else model.with_values({LOOKBACK: lookback})
        try:
            stream, prediction = sk.Posterior(trial).predict(theta)
        except sk.OutOfDomain:
            continue
        if not prediction.why_not and stream.orbit.mass_left[-1] > LITTLE:
            yield attempt, theta, truth, number


def make_data(
    spec: sk.Spec, model: sk.Spec, passages: list[int], index: int, particles: int, out: Path, dissolved: bool
) -> tuple[sk.Spec, np.ndarray, int]:
    """Make a live satellite of a truth and measure it; the run file with its data, the true values, and passages."""
    rng = np.random.default_rng([spec.seed, 7, index])
    for attempt, theta, truth, number in truths(spec, model, passages, rng):
        seen = observed(truth, particles, out / f"satellite_{index}_{attempt}", dissolved)
        observable = truth.bind().observable
        if seen is None or observable is None:
            continue
        core, stream = seen
        prediction = observable.predict(stream)
        if prediction.why_not:
            continue
        data = noisy(observable.mock(prediction, rng), prediction.variance[np.isfinite(prediction.mean)])
        place = {path: value for path, value in core.items() if path not in spec.names}
        true = np.array([core.get(name, value) for name, value in zip(spec.names, theta, strict=True)])
        fields = {f"observable.{name}": value for name, value in data.items()}
        begin = {LOOKBACK: truth.bind().lookback} if passages else {}
        return spec.with_values(place | fields | begin), true, number
    raise SystemExit(f"draw {index}: none of {TRIES} satellites has a core and can be measured")


def in_units_of_truth(results: sk.Results, masses: tuple[float, ...]) -> list[list[float]]:
    """(3, 3) The 16, 50 and 84 % quantiles of the fitted mass over the true one, at each radius."""
    fitted = results.profiles(np.array(MASS_RADII))[0] / np.array(masses)
    return [np.quantile(column, [0.16, 0.5, 0.84]).tolist() for column in fitted.T]


def bias_table(file: Path) -> str:
    """Return the mean error of the masses, in per cent and in the fit's own standard deviations, as text."""
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    low, median, high = np.array([row["masses"] for row in rows]).transpose(2, 0, 1)
    away, scatter = 100 * (median - 1), (median - 1) / (0.5 * (high - low))
    lines = []
    for i, radius in enumerate(MASS_RADII):
        error = away[:, i].std(ddof=1) / np.sqrt(len(rows)) if len(rows) > 1 else np.nan
        lines.append(
            f"M(<{radius:g} kpc): {away[:, i].mean():+.1f} +- {error:.1f} % too large; {scatter[:, i].mean():+.2f} sd, "
            f"rms {np.sqrt((scatter[:, i] ** 2).mean()):.2f} sd; median half width "
            f"{50 * np.median(high[:, i] - low[:, i]):.1f} %"
        )
    guessed = [row["passages"] == row["true_passages"] for row in rows if row["passages"]]
    lines += [f"{sum(guessed)} of {len(guessed)} numbers of passages are right"] if guessed else []
    return "\n".join(lines)


def main() -> None:
    """Make the missing draws, one after the other, and write the products."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run_file", type=Path, nargs="?", default=RUN_FILE, metavar="RUN.toml")
    parser.add_argument("-o", "--output", type=Path, default=Path("nbody-recovery"), metavar="DIR")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--particles", type=int, default=1000, help="of a live satellite")
    parser.add_argument("--dissolved", action="store_true", help="take satellites without a core, too")
    parser.add_argument("--sampler", nargs="*", default=[], metavar="FIELD=VALUE", help="fields of [sampler]")
    parser.add_argument("--set", nargs="*", default=[], metavar="PATH=VALUE", help="changes for truths and fits")
    parser.add_argument("--fit", nargs="*", action="append", metavar="PATH=VALUE", help="changes for a fit alone")
    parser.add_argument("--passages", nargs="*", type=int, default=[], help="numbers of passages, of truths and fits")
    given = parser.parse_args()
    sampler = {f"sampler.{name}": value for name, value in settings(given.sampler).items()}
    spec = sk.load(given.run_file).with_values(sampler | settings(given.set))
    if given.passages and LOOKBACK in spec.names:
        raise SystemExit(f"{LOOKBACK} is free; with --passages it follows from the number of passages")
    fits = [settings(words) for words in given.fit or [[]]]
    folders = [given.output / f"fit_{k}" for k in range(1, len(fits) + 1)] if len(fits) > 1 else [given.output]
    draws: list[list[Draw]] = []
    for folder in folders:
        folder.mkdir(parents=True, exist_ok=True)
        file = folder / DRAWS
        draws.append([Draw.of_line(line) for line in file.read_text().splitlines()] if file.exists() else [])
    for index in range(min(map(len, draws)), given.draws):
        model = varied(spec, fits[0])
        data, true, number = make_data(
            spec, model, given.passages, index, given.particles, given.output, given.dissolved
        )
        for folder, changes, made in zip(folders, fits, draws, strict=True):
            if index < len(made):
                continue
            rng = np.random.default_rng([spec.seed, 8, index])
            results, passages = best_fit(varied(data, changes), given.passages, rng)
            draw = rank_truth(results, index, true, spec)
            masses = in_units_of_truth(results, draw.host[: len(MASS_RADII)])
            about = {"index": index, "true_passages": number, "passages": passages, "masses": masses}
            made.append(draw)
            with (folder / MASSES).open("a") as lines:
                lines.write(json.dumps(about) + "\n")
            with (folder / DRAWS).open("a") as lines:
                lines.write(draw.line() + "\n")
        print(f"{index + 1} of {given.draws} draws", flush=True)
    for folder, made in zip(folders, draws, strict=True):
        products = calibration_products(Calibration(spec, tuple(made)))
        write_tables(products, folder)
        draw_pictures(products, folder)
        print(f"{folder}\n{products.text}\n{bias_table(folder / MASSES)}")


if __name__ == "__main__":
    main()
