"""Whether a chain depends on where it was made, or on interruptions: the table of identities of this folder's README.

    python tests/benchmarks/identity.py [--engines serial processes mpi dask] [--workers 1 2 3 5] [--stops 2]
                                       [--sampler emulator]

For each engine and number of workers one run in one go, and one that is interrupted at random steps, by Ctrl-C or
SIGKILL, and resumed each time. Each is a new interpreter; what stands in the table is SHA-256 of samples and ln p.
A run of the emulator is interrupted where its journals have some fraction of their bytes at the end.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

import streamkit as sk
from streamkit.report import is_locked
from streamkit.sample import CALLS, CHAIN, SAMPLES, SMALL_CALLS, read_chain_file, read_weighted

STEPS = 40
LIMIT = 600.0  # seconds within which a run has to be over
KILOBYTE = 1024
NEEDS = {"mpi": "mpi4py", "dask": "distributed"}


def steps_of(out: Path) -> int:
    """Return how many steps a run has finished; of the emulator, how many kilobytes of calls."""
    if (chain := out / CHAIN).exists():
        with suppress(sk.ChainError):
            return len(read_chain_file(chain).chain)
    journals = [out / name for name in (SMALL_CALLS, CALLS)]
    return sum(path.stat().st_size for path in journals if path.exists()) // KILOBYTE


def hash_of(out: Path) -> str:
    """Return the hash of the samples and ln p of a run that has ended; says how far it came otherwise."""
    if (samples := out / SAMPLES).exists():
        weighted = read_weighted(samples)
        if weighted.missing:
            return weighted.missing
        return hashlib.sha256(weighted.points.tobytes() + weighted.log_prob.tobytes()).hexdigest()[:16]
    if steps_of(out) != STEPS:
        return f"{steps_of(out)} steps"
    chain = read_chain_file(out / CHAIN)
    return hashlib.sha256(chain.chain.tobytes() + chain.log_prob.tobytes()).hexdigest()[:16]


def start(folder: Path, sampler: str, engine: str, workers: int, out: Path) -> subprocess.Popen[bytes]:
    """Begin or resume a run, in a session of its own."""
    launch = [sys.executable]
    if engine == "mpi":
        launch = ["mpiexec", "-n", str(workers + 1), sys.executable, "-m", "mpi4py.futures"]
    words = [*launch, str(Path(__file__).absolute()), "--run", sampler, engine, str(workers), str(out)]
    paths = os.pathsep.join(path for path in sys.path if path)
    with (folder / "log").open("ab") as log:
        return subprocess.Popen(words, cwd=folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                start_new_session=True, env=os.environ | {"PYTHONPATH": paths})  # fmt: skip


def made(folder: Path, sampler: str, engine: str, workers: int, stops: list[tuple[int, int]]) -> tuple[str, str]:
    """Make a chain with interruptions, each at a step and by a signal; return its hash, and what interrupted it."""
    out = folder / f"{engine}{workers}{'stopped' if stops else ''}"
    told = []
    for step, number in [*stops, (sys.maxsize, 0)]:
        process, end = start(folder, sampler, engine, workers, out), time.monotonic() + LIMIT
        while process.poll() is None and steps_of(out) < step and time.monotonic() < end:
            time.sleep(0.05 if number else 0.5)
        late = time.monotonic() > end
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL if late else number)
            told.append(f"{signal.Signals(number).name} at {steps_of(out)}")
        process.wait(LIMIT)
        while is_locked(out) and time.monotonic() < end:  # ranks of MPI end a little after their launcher
            time.sleep(0.1)
        if late:
            return "did not end", ", ".join(told)
    return hash_of(out), ", ".join(told)


def run(sampler: str, engine: str, workers: int, out: Path) -> int:
    """Make the run, or go on with it, as the command does, without its pictures."""
    try:
        spec = sk.load("run.toml")
        spec = spec if sampler == "emcee" else spec.with_sampler(sampler)
        steps = STEPS if sampler == "emcee" else None
        sk.run(spec, out, engine=engine, workers=workers, steps=steps, resume=out.exists(), products=False,
               progress=False)  # fmt: skip
    except sk.StreamkitError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def missing(engine: str) -> str:
    """Say what an engine lacks here."""
    if (module := NEEDS.get(engine)) and importlib.util.find_spec(module) is None:
        return f"{module} is not installed: pip install 'tidal-streamkit[{engine}]'"
    return "there is no mpiexec" if engine == "mpi" and shutil.which("mpiexec") is None else ""


def main() -> None:
    """Print the table; exit status 1 if chains differ."""
    from disturbed import write_run  # the processes of the runs themselves need not have it

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--engines", nargs="+", default=["serial", "processes", "mpi", "dask"])
    parser.add_argument("--workers", nargs="+", type=int, default=[1, 2, 3, 5])
    parser.add_argument("--sampler", choices=["emcee", "emulator"], default="emcee")
    parser.add_argument("--stops", type=int, default=2, help="interruptions of a run")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rng = random.Random(args.seed)
    folder = Path(tempfile.mkdtemp(prefix="identity-"))
    write_run(folder)
    wanted, _ = made(folder, args.sampler, "serial", 1, [])
    most = STEPS - 5 if args.sampler == "emcee" else int(0.95 * steps_of(folder / "serial1"))
    print("| engine | workers | in one go | interrupted | by |\n|---|---|---|---|---|", flush=True)
    same = True
    for engine in args.engines:
        if why := missing(engine):
            print(f"| {engine} | | not tried: {why} | | |", flush=True)
            continue
        for workers in [1] if engine == "serial" else args.workers:
            steps = sorted(rng.sample(range(1, most), args.stops))
            stops = [(step, rng.choice([signal.SIGINT, signal.SIGKILL])) for step in steps]
            whole, _ = made(folder, args.sampler, engine, workers, [])
            broken, how = made(folder, args.sampler, engine, workers, stops)
            same &= whole == broken == wanted
            print(f"| {engine} | {workers} | {whole} | {broken} | {how} |", flush=True)
    if same:
        shutil.rmtree(folder, ignore_errors=True)
    else:
        print(f"the chains differ: {folder}", file=sys.stderr)
    sys.exit(not same)


if __name__ == "__main__":  # Dask's workers and the ranks of MPI import this under another name
    if sys.argv[1:2] == ["--run"]:
        sys.exit(run(sys.argv[2], sys.argv[3], int(sys.argv[4]), Path(sys.argv[5])))
    main()
