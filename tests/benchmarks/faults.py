"""What is left of a run after a fault: the table of faults of this folder's README.

    python tests/benchmarks/faults.py [--tries 50] [--fast] [--only NAME ...] [-o FAULTS.json]

Each fault comes to so many small runs of the command, in turn, at random moments. For every fault: the runs
that had not ended in time and had to be killed, the tracebacks that they printed, the finished steps that could not be
read afterwards, and how many went on after ``--resume`` to the samples of a run that nothing happened to, bit for bit.
With a file, tries that stand in it are not made again; ``--tries 0`` prints its table.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

import h5py
import numpy as np
from disturbed import TABLE, Disturbed
from tries import LIMIT, Found, Lab, Try

import streamkit as sk
from streamkit.sample import CHAIN, JOURNAL, read_chain_file

MANIFEST = "manifest.json"


def killed(one: Try, number: int, *more: str, group: bool = False, allowed: tuple[int, ...] = ()) -> None:
    """Send a signal at a random moment."""
    run = one.start(*more)
    one.moment(run)
    run.signal(number, group)
    one.end(run, -number, *allowed)  # before a command answers signals the system does
    one.resume()


def killed_at_start(one: Try) -> None:
    """Kill a new interpreter within the time that it needs for its first step."""
    run = one.start(cold=True)
    time.sleep(one.rng.uniform(0, one.lab.cold()))
    run.signal(signal.SIGKILL)
    one.end(run, -9)
    one.resume()


def killed_worker(one: Try) -> None:
    """Kill one of two workers, idle or busy, three times."""
    run = one.start("--workers", "2")
    for _ in range(3):
        one.moment(run)
        run.wait(lambda: bool(run.workers), LIMIT)
        if run.workers:
            with suppress(ProcessLookupError):
                os.kill(one.rng.choice(run.workers), signal.SIGKILL)
    go_on(one, run)
    one.end(run, 143)
    one.resume()


def go_on(one: Try, run: Disturbed) -> None:
    """See that it takes three more steps, and stop it."""
    last = run.steps
    one.found.hung |= not run.wait(lambda: run.steps >= last + 3, LIMIT)
    run.signal(signal.SIGTERM)


def limited(one: Try, deadly: bool) -> None:
    """Let no file grow beyond a random size: a write ends in the middle, by death or by an error."""
    room = int(np.exp(one.rng.uniform(np.log(500), np.log(90_000))))

    def before() -> None:
        if deadly:
            signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))

    run = one.start(before=before)
    one.end(run, -signal.SIGXFSZ if deadly else 2)
    one.resume()


def mounted(place: Path, room: int) -> None:
    """Mount a disk of some pages."""
    place.mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={room}", "tmpfs", str(place)], check=True)


def unmounted(place: Path) -> None:
    """Take it away again."""
    subprocess.run(["umount", str(place)], check=True)


def full_disk(one: Try) -> None:
    """Run on a disk of random size until it is full, and go on when there is room."""
    room = int(np.exp(one.rng.uniform(np.log(8_000), np.log(400_000))))
    disk = one.folder / "disk"
    mounted(disk, room)
    try:
        one.out = disk / "out"
        run = one.start()
        one.end(run, 2)
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
        one.resume()
    finally:
        unmounted(disk)


def full_cache(one: Try) -> None:
    """Have the machine code of a new potential kept on a disk without room for it."""
    disk = one.folder / "cache"
    mounted(disk, int(one.rng.uniform(4_000, 60_000)))
    text = (one.folder / "plugin.py").read_text().replace("compiled = False", "compiled = True")
    text = text.replace("what = harm()", f"unlike = {one.rng.random()}").replace(
        '{"nan": np.nan, "complex": 1 + 1j}.get(what, 1.0) * k', "k"
    )
    (one.folder / "plugin.py").write_text(text)
    toml = one.folder / "run.toml"
    toml.write_text(toml.read_text().replace('"tf"', '"harmful"'))
    import numba

    def before() -> None:
        numba.config.CACHE_DIR = str(disk)

    try:
        run = one.start(before=before)
        one.found.hung |= not run.wait(lambda: run.steps >= 3, LIMIT)
        run.signal(signal.SIGTERM)
        one.end(run, 143)
    finally:
        unmounted(disk)


def damaged(one: Try, name: str, how: Callable[[Try, Path], None], harmless: bool = False) -> None:
    """Damage a file of a stopped run, resume, mend it, resume again."""
    one.stopped(journal=name == JOURNAL)
    path = one.out / name
    whole = path.read_bytes()
    finished = len(read_chain_file(one.out / CHAIN).chain)
    how(one, path)
    one.refused_or_resumed(partial(path.write_bytes, whole), harmless)
    if not harmless and one.found.resumed == "same":
        one.lost(finished)


def cut(one: Try, path: Path) -> None:
    """Cut a file at a random byte."""
    content = path.read_bytes()
    path.write_bytes(content[: one.rng.randrange(len(content))])


def flip(one: Try, path: Path) -> None:
    """Flip a bit."""
    content = bytearray(path.read_bytes())
    content[one.rng.randrange(len(content))] ^= 1 << one.rng.randrange(8)
    path.write_bytes(content)


def other(one: Try, path: Path) -> None:
    """Put the chain of a run with another seed there."""
    there = one.folder / "other"
    toml = one.folder / "other.toml"
    toml.write_text((one.folder / "run.toml").read_text().replace("seed = 3", f"seed = {one.rng.randrange(4, 1000)}"))
    sk.run(toml, there, steps=one.rng.randrange(2, 20), products=False, progress=False)
    shutil.copy(there / CHAIN, path)


def not_a_number(one: Try, path: Path) -> None:
    """Write NaN into a data set, by HDF5 itself."""
    with h5py.File(path, "a") as file:
        data = file["mcmc"][one.rng.choice(["chain", "log_prob"])]
        data[tuple(one.rng.randrange(n) for n in data.shape)] = np.nan


def table(one: Try) -> None:
    """Change a datum by a percent between the run and its resumption."""
    one.stopped(journal=one.rng.random() < 0.5)
    path = one.folder / "table.npy"
    changed = TABLE.copy()
    changed[one.rng.randrange(4)] *= 1.01
    np.save(path, changed)
    one.refused_or_resumed(partial(np.save, path, TABLE))


def plugin(one: Try) -> None:
    """Change the code of the plugin between the run and its resumption."""
    one.stopped(journal=one.rng.random() < 0.5)
    path = one.folder / "plugin.py"
    text = path.read_text()
    path.write_text(text.replace("0.1", f"0.{one.rng.randrange(2, 9)}"))
    one.refused_or_resumed(partial(path.write_text, text))


def harmed(one: Try, what: str, workers: int = 1, lasting: bool = True, status: tuple[int, ...] = (2,)) -> None:
    """Let the potential do harm from a random call on, or in that alone."""
    number = one.rng.randrange(20, 200)
    where = "worker" if workers > 1 else "anywhere"  # the main process calls potentials too, for its log
    (one.folder / "harm").write_text(f"{what} {number} {'lasting' if lasting else 'passing'} {where}")
    run = one.start("--workers", str(workers))
    if 143 in status:
        one.found.hung |= not run.wait(lambda: not (one.folder / "harm").exists() or "died" in run.text, LIMIT)
        go_on(one, run)
    one.end(run, *status)
    (one.folder / "harm").unlink(missing_ok=True)
    one.resume()


def pipe_closed(one: Try) -> None:
    """Read no more of what it prints; then stop it."""
    run = one.start()
    one.moment(run)
    run.close_pipe()
    go_on(one, run)
    one.end(run, 143)
    one.resume()


def no_more(one: Try, limit: int, least: float, most: float) -> None:
    """Give it little of something at a random moment: files that are open, memory."""
    run = one.start()
    one.moment(run)
    if limit == resource.RLIMIT_AS:
        size = int(Path(f"/proc/{run.pid}/statm").read_text().split()[0]) * resource.getpagesize()
        room = size + int(one.rng.uniform(least, most))
    else:
        room = int(one.rng.uniform(least, most))
    with suppress(ProcessLookupError):
        resource.prlimit(run.pid, limit, (room, room))
    last = run.steps
    run.wait(lambda: run.steps >= last + 10, LIMIT)
    run.signal(signal.SIGTERM)
    one.end(run, 2, 143)
    one.resume()


def removed(one: Try) -> None:
    """Take the directory away while the run is on: what it finished goes with it."""
    run = one.start()
    one.moment(run)
    shutil.rmtree(one.out, ignore_errors=True)
    run.wait(lambda: False, 5)
    run.signal(signal.SIGTERM)
    one.end(run, 2, 143, kept=False)
    shutil.rmtree(one.out, ignore_errors=True)
    one.resume()


def twice(one: Try) -> None:
    """Begin, force or resume another run in the same directory meanwhile."""
    run = one.start()
    one.moment(run)
    run.wait(lambda: run.steps > 0, LIMIT)
    second = one.start(*one.rng.choice([[], ["--resume"], ["--force"]]))
    one.found.hung |= not second.ended(LIMIT)
    one.said(second)
    if second.status != 2:
        one.found.odd.append(f"the second had exit status {second.status}")
    go_on(one, run)
    one.end(run, 143)
    one.resume()


KILL, TERM, INT, HUP = signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP
TWO = "--workers", "2"
AGAIN = partial(harmed, what="exit", workers=2, status=(143,))
PASSING = {"lasting": False, "status": (143,)}


def sent(number: int, *more: str, **options: Any) -> Callable[[Try], None]:
    """Return the fault of a signal."""
    return lambda one: killed(one, number, *more, **options)


# By name: what stands in the table, the fault, the potential, and of how many tries one is made.
FAULTS: dict[str, tuple[str, Callable[[Try], None], str, int]] = {
    "kill": ("killed (SIGKILL)", sent(KILL), "tf", 1),
    "kill-2": ("killed, two workers", sent(KILL, *TWO), "tf", 1),
    "kill-worker": ("workers killed, three of them", killed_worker, "tf", 1),
    "kill-start": ("killed before the first step, a new interpreter", killed_at_start, "tf", 5),
    "kill-write": ("killed inside a write (SIGXFSZ)", partial(limited, deadly=True), "tf", 1),
    "term": ("SIGTERM, two workers", sent(TERM, *TWO, allowed=(143,)), "tf", 1),
    "int": ("Ctrl-C, to the workers too", sent(INT, *TWO, group=True, allowed=(130,)), "tf", 1),
    "hup": ("terminal closed (SIGHUP)", sent(HUP, *TWO, group=True), "tf", 1),
    "pipe": ("the reader of its output ends", pipe_closed, "tf", 1),
    "twice": ("a second run in the directory", twice, "tf", 1),
    "removed": ("directory removed", removed, "tf", 1),
    "size": ("file size limited", partial(limited, deadly=False), "tf", 1),
    "disk": ("disk full, then room", full_disk, "tf", 1),
    "cache": ("disk full under the compiled code", full_cache, "tf", 5),
    "files": ("no more open files", lambda one: no_more(one, resource.RLIMIT_NOFILE, 3, 10), "tf", 1),
    "memory": ("no more memory", lambda one: no_more(one, resource.RLIMIT_AS, -5e7, 1e6), "tf", 1),
    "chain-cut": ("chain file cut", partial(damaged, name=CHAIN, how=cut), "tf", 1),
    "chain-bit": ("bit of the chain file flipped", partial(damaged, name=CHAIN, how=flip), "tf", 1),
    "chain-other": ("another run's chain", partial(damaged, name=CHAIN, how=other), "tf", 1),
    "chain-nan": ("NaN in a data set", partial(damaged, name=CHAIN, how=not_a_number), "tf", 1),
    "journal-cut": ("journal cut", partial(damaged, name=JOURNAL, how=cut, harmless=True), "tf", 1),
    "journal-bit": ("bit of the journal flipped", partial(damaged, name=JOURNAL, how=flip, harmless=True), "tf", 1),
    "manifest-cut": ("manifest cut", partial(damaged, name=MANIFEST, how=cut), "tf", 1),
    "table": ("data table changed before resuming", table, "tf", 1),
    "plugin": ("plugin changed before resuming", plugin, "tf", 1),
    "exit": ("plugin calls os._exit", partial(harmed, what="exit", status=(3,)), "harmful", 1),
    "abort": ("plugin aborts", partial(harmed, what="abort", status=(-6,)), "harmful", 1),
    "segv": (
        "plugin: segmentation fault, two workers, once",
        partial(harmed, what="segv", workers=2, **PASSING),
        "harmful",
        1,
    ),
    "exit-2": ("plugin calls os._exit in the workers, again and again", AGAIN, "harmful", 1),
    "raise": ("plugin raises a bare BaseException", partial(harmed, what="raise"), "harmful", 1),
    "never": ("plugin never returns", partial(harmed, what="never", lasting=False), "harmful", 1),
    "never-2": (
        "plugin never returns, two workers",
        partial(harmed, what="never", workers=2, lasting=False),
        "harmful",
        1,
    ),
    "close": ("plugin closes descriptors", partial(harmed, what="close", **PASSING), "harmful", 1),
    "close-2": (
        "plugin closes descriptors, two workers",
        partial(harmed, what="close", workers=2, **PASSING),
        "harmful",
        1,
    ),
    "thread": ("plugin leaves a thread", partial(harmed, what="thread", **PASSING), "harmful", 1),
    "complex": ("plugin returns complex numbers", partial(harmed, what="complex"), "harmful", 1),
    "plugin-memory": ("plugin asks for all memory", partial(harmed, what="memory"), "harmful", 1),
}


def tried(lab: Lab, name: str, number: int) -> Found:
    """Make one try of a fault; what goes wrong in it is a finding too."""
    _, fault, potential, _ = FAULTS[name]
    one = Try(lab, number, potential)
    try:
        fault(one)
    except Exception as error:
        one.found.odd.append(f"{type(error).__name__}: {error}")
    if not one.found.odd and not one.found.hung:
        shutil.rmtree(one.folder, ignore_errors=True)
    return one.found


def row(name: str, found: list[Found]) -> str:
    """Return a row of the table."""
    message = Counter(one.message for one in found if one.message).most_common(1)
    resumed = [one.resumed for one in found if one.resumed != "-"]
    same = f"{resumed.count('same')} of {len(resumed)}" if resumed else "-"
    said = message[0][0][:110] if message else ""
    sums = sum(one.hung for one in found), sum(one.traceback for one in found), sum(one.lost for one in found)
    return f"| {FAULTS[name][0]} | {len(found)} | {' | '.join(map(str, sums))} | {same} | {said} |"


def main() -> None:
    """Try the faults and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tries", type=int, default=50)
    parser.add_argument("--fast", action="store_true", help="two tries")
    parser.add_argument("--only", nargs="+", choices=FAULTS, default=list(FAULTS))
    parser.add_argument(
        "-o", "--output", type=Path, help="JSON file of the tries; those that stand in it are not made again"
    )
    args = parser.parse_args()
    done: dict[str, Any] = json.loads(args.output.read_text()) if args.output and args.output.exists() else {}
    lab = Lab(Path(tempfile.mkdtemp(prefix="faults-")))
    for number in range(2 if args.fast else args.tries):
        for name in args.only:
            before = done.setdefault(name, [])
            if len(before) <= number // FAULTS[name][3]:
                before.append(vars(tried(lab, name, 1000 * number + 1)))
                for odd in before[-1]["odd"]:
                    print(f"{name}: {odd}", file=sys.stderr, flush=True)
                if args.output:
                    args.output.write_text(json.dumps(done, indent=1))
    shutil.rmtree(lab.place, ignore_errors=True)
    print("| fault | tries | hung | tracebacks | steps lost | resumed to the same samples | says |")
    print("|---|---|---|---|---|---|---|")
    for name in args.only:
        if done.get(name):
            print(row(name, [Found(**one) for one in done[name]]))


if __name__ == "__main__":
    main()
