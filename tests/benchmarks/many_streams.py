"""How a fit grows with its number of streams: calls, CPU seconds, wall time and memory of the sampler `emulator`.

    python tests/benchmarks/many_streams.py [--streams 4 8 16 30] [--workers 1 2] [--profile]
    python tests/benchmarks/many_streams.py --streams 2 --workers 1 --particles 1000 [--sampler emcee]

The streams are mock streams of clusters on random orbits in one host, with eight points of a track each: the host has
two free parameters, each stream two of its own. Every row is a fit in a process of its own. Calls are those with all
particles, of all streams together. Those of the search for starts, with fewer particles, have a column of their own.
CPU seconds are those of the process that samples, which makes the calls too if there is one worker, and of the workers.
The second command compares two streams by the emulator with a chain that walks on all of their streams at once.

    python tests/benchmarks/many_streams.py --joint [--streams 4 8 16 30]

The joint step alone: a sweep of 128 walkers of the sampler over streams whose data are linear in five parameters of the
host and five of their own, which cost nothing to evaluate; and its trajectory along the surface. An emulator of a
stream costs some 12 us an evaluation more, 34 for each stream and walker in a sweep.

    python tests/benchmarks/many_streams.py --seconds 60 --streams 40 --engines processes dask --workers 1 2

Calls in the first seconds after the first of them: their rate by so many workers of each engine, and beside that of one
worker of the first engine. The fit is stopped then.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import pstats
import resource
import subprocess
import sys
import tempfile
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from astropy.coordinates import CartesianRepresentation, Galactic, SkyCoord

import streamkit as sk
from streamkit.sample import calls_in, is_calls

R0 = 8.0  # kpc, of the Sun
TRUE = {"v0": 220.0, "q": 0.9}
PRIORS = {"v0": {"uniform": [180.0, 260.0]}, "q": {"uniform": [0.7, 1.1]}}
ERRORS = {"phi2": 0.2, "distance": 0.5, "pm_phi1_cosphi2": 0.1, "pm_phi2": 0.1}  # deg, kpc, mas/yr
AT = np.linspace(-7, 7, 8)  # of the track's points, deg from the progenitor
KICK = 5.0  # km/s, of the priors of a progenitor's velocity
SAMPLERS = {"emulator": {"kind": "emulator"}, "emcee": {"kind": "emcee", "walkers": 16, "steps": 3000}}
WALKERS, SWEEPS = 128, 8  # of the joint step
MOST = 30  # orbits that are tried for each stream


def run_file(streams: dict[str, Any]) -> dict[str, Any]:
    """Return a run file of some streams in the true host."""
    return {
        "version": 1,
        "sun": {"r0": R0, "z": 0.0, "v_circ": 220.0},
        "potential": {"kind": "logarithmic_halo", **TRUE},
        "stream": streams,
        "sampler": SAMPLERS["emulator"],
    }


def mock_streams(count: int, seed: int, particles: int) -> dict[str, Any]:
    """Return so many streams, the first ones the same for every number of them.

    Raises RuntimeError if too many orbits have no debris along the track.
    """
    rng, streams = np.random.default_rng(seed), dict[str, Any]()
    for _ in range(MOST * count):
        name = f"s{len(streams):02d}"
        stream = one_stream(rng, particles)
        spec = sk.load(run_file({name: stream}))
        inputs = spec.bind_all().streams[name]
        try:
            prediction = sk.Model(spec).observe(inputs)[1]
        except sk.OutOfDomain:
            continue
        if prediction.why_not:
            continue
        stream["observable"] |= inputs.observable.mock(prediction, rng)
        stream["progenitor"] |= {axis: {"normal": [stream["progenitor"][axis], KICK]} for axis in ("vx", "vz")}
        streams[name] = stream
        if len(streams) == count:
            return streams
    raise RuntimeError(f"only {len(streams)} of {MOST * count} orbits have a stream along the whole track")


def one_stream(rng: np.random.Generator, particles: int) -> dict[str, Any]:
    """Return a cluster on a random orbit, with a track along the great circle of its motion on the sky."""
    q = rng.normal(size=3)
    q *= rng.uniform(12, 25) / np.linalg.norm(q)
    v = np.cross(q, rng.normal(size=3))
    v *= rng.uniform(150, 220) / np.linalg.norm(v)
    seen = q + np.array([R0, 0, 0])
    origin, pole = _icrs(seen), _icrs(np.cross(seen, v))  # debris lies along the orbit, not along the proper motion
    blank = {name: {"phi1": AT.tolist(), name: [1.0] * len(AT), "error": [error] * len(AT)}
             for name, error in ERRORS.items()}  # fmt: skip
    place = dict(zip(("x", "y", "z", "vx", "vy", "vz"), np.concatenate([q, v]).tolist(), strict=True))
    return {
        "progenitor": {"kind": "plummer", "mass": 2e4, "radius": 0.03, "lookback": 3.0, **place},
        "stripping": {"kind": "mlcs", "particles": particles, "sigma": 1.0},
        "observable": {"kind": "track", "kernel": 4.0, "frame": {"pole": pole, "origin": origin}, **blank},
    }


def _icrs(vector: np.ndarray) -> list[float]:
    """Return right ascension and declination in degrees of a direction in Galactic axes."""
    seen = SkyCoord(Galactic(CartesianRepresentation(*vector))).icrs
    return [float(seen.ra.deg), float(seen.dec.deg)]


def fit(count: int, workers: int, given: argparse.Namespace) -> dict[str, Any]:
    """Fit so many streams; return a row of the table."""
    document = run_file(mock_streams(count, given.seed, given.particles))
    document["potential"] |= PRIORS
    document["sampler"] = SAMPLERS[given.sampler]
    spec = sk.load(document)
    sk.Posterior(spec).evaluate(spec.centre())  # compiled before the time begins
    before, begin, profiler = _cpu(), time.monotonic(), cProfile.Profile()
    with tempfile.TemporaryDirectory() as folder:
        if given.profile:
            profiler.enable()
        results = sk.run(spec, Path(folder) / "fit", workers=workers, progress=False, products=False)
        profiler.disable()
        wall, after = time.monotonic() - begin, _cpu()
    if given.profile:
        pstats.Stats(profiler, stream=sys.stderr).sort_stats("cumulative").print_stats(60)
    v0, q = (results[f"potential.{name}"] for name in TRUE)
    return {
        "streams": count, "parameters": len(spec.names), "workers": workers, "calls": results.calls,
        "search": results.search_calls, "sampler": after[0] - before[0], "of workers": after[1] - before[1],
        "wall": wall, "MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "certified": "yes" if results.converged else "no",
        "v0": f"{v0.mean():.1f} +- {v0.std():.1f}", "q": f"{q.mean():.3f} +- {q.std():.3f}",
    }  # fmt: skip


def joint(count: int) -> dict[str, Any]:
    """Time sweeps over a joint posterior of so many linear factors; return a row of the table."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
    from joints import LinearFactors

    from streamkit.builtin.samplers.emulator.walk.moves import Moves
    from streamkit.builtin.samplers.emulator.walk.population import Population
    from streamkit.builtin.samplers.emulator.walk.populations import OF_EACH

    factors, rng = LinearFactors(count, shared=5, own=5), np.random.default_rng(1)
    places = rng.multivariate_normal(*factors.answer(), 4 * WALKERS)
    walkers = Population.of(factors, places, rng).at(WALKERS, 1.0)
    moves, spent = Moves(factors.layout, places, rng, of_each=OF_EACH), []
    for step in (
        lambda: moves.sweep(factors, walkers.z, walkers.terms, 1.0, rng),
        lambda: moves._follow_surface(factors, walkers.z, walkers.terms, 1.0, rng),
    ):
        step()
        begin = time.process_time()
        for _ in range(SWEEPS):
            step()
        spent.append(1e3 * (time.process_time() - begin) / SWEEPS)
    return {"streams": count, "parameters": factors.layout.size, "ms a sweep": spent[0], "trajectory": spent[1]}


def calls_within(count: int, engine: str, workers: int, given: argparse.Namespace) -> dict[str, Any]:
    """Begin a fit of so many streams and stop it after the seconds that are given; return a row of the table."""
    document = run_file(mock_streams(count, given.seed, given.particles))
    document["potential"] |= PRIORS
    with tempfile.TemporaryDirectory() as folder:
        file, out = Path(folder) / "run.toml", Path(folder) / "fit"
        file.write_text(tomlkit.dumps(document))
        words = ["run", str(file), "-o", str(out), "--engine", engine, "--workers", str(workers), "--quiet"]

        def made() -> int:
            return sum(calls_in(each) for each in out.glob("*.journal") if is_calls(each.name))

        with subprocess.Popen([sys.executable, "-m", "streamkit", *words]) as process:
            while process.poll() is None and not made():
                time.sleep(0.2)
            begin, before = time.monotonic(), made()
            time.sleep(given.seconds)
            calls, seconds = made() - before, time.monotonic() - begin
            process.terminate()
    return {"streams": count, "engine": engine, "workers": workers, "calls a second": calls / seconds}


def _cpu() -> tuple[float, float]:
    """Return the CPU seconds of this process and of its workers that have ended."""
    return tuple(
        used.ru_utime + used.ru_stime
        for used in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def shown(row: dict[str, Any]) -> str:
    """Return a row of the table."""
    return "| " + " | ".join(f"{each:.0f}" if isinstance(each, float) else str(each) for each in row.values()) + " |"


def main() -> None:
    """Print the table, a row when its fit has ended."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--streams", type=int, nargs="+", default=[4, 8, 16, 30], help="numbers of streams")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], help="numbers of worker processes")
    parser.add_argument("--seed", type=int, default=1, help="of the orbits and of the noise")
    parser.add_argument("--particles", type=int, default=500, help="of each stream")
    parser.add_argument("--sampler", choices=SAMPLERS, default="emulator", help="which one")
    parser.add_argument("--profile", action="store_true", help="print the functions that took the most time")
    parser.add_argument("--seconds", type=float, help="count the first calls, and stop")
    parser.add_argument("--engines", nargs="+", default=["processes"], help="engines of the workers, for --seconds")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)  # a row, in a process of its own
    parser.add_argument("--joint", action="store_true", help="the joint step alone, on linear streams")
    given = parser.parse_args()
    if given.one:
        count, workers = given.streams[0], given.workers[0]
        row = joint(count) if given.joint else fit(count, workers, given)
        print(json.dumps(row))
        return
    if given.seconds:
        first = 0.0
        print("| streams | engine | workers | calls a second | of the ideal |\n|---|---|---|---|---|")
        for count, engine, workers in product(given.streams, given.engines, given.workers):
            row = calls_within(count, engine, workers, given)
            first = first or row["calls a second"] / workers
            print(f"{shown(row)} {row['calls a second'] / workers / first:.2f} |", flush=True)
        return
    head: tuple[str, ...] = ()
    for count in given.streams:
        for workers in [1] if given.joint else given.workers:
            own = ["--streams", str(count), "--workers", str(workers), "--seed", str(given.seed),
                   "--particles", str(given.particles), "--sampler", given.sampler]  # fmt: skip
            own += [f"--{name}" for name in ("profile", "joint") if getattr(given, name)]
            command = [sys.executable, __file__, "--one", *own]
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
            row = json.loads(done.stdout.splitlines()[-1])
            if not head:
                head = tuple(row)
                print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}", flush=True)
            print(shown(row), flush=True)


if __name__ == "__main__":
    main()
