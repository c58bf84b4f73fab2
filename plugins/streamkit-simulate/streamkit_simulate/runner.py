"""All draws into one file: made by any number of processes, written in order, continued after an interruption."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

import h5py
import numpy as np

from streamkit import Array, Spec, SpecError, StreamkitError
from streamkit.errors import Interrupted
from streamkit.report import Progress
from streamkit.runfile import Engine, Source, as_spec
from streamkit.sample import Evaluation, Stopped, Workers, engine, first_call, one_thread, stopped_by_signals
from streamkit_simulate.archive import REASON, Archive, Layout, compare, create, in_bytes, opened
from streamkit_simulate.simulator import PARTICLE, Simulator

EVERY = 5.0  # seconds between two writes
MEMORY = 64e6  # bytes of draws that wait for a write
BLOCK = 4096  # most draws that the workers are given at a time
SUFFIXES = ".h5", ".hdf5"


@dataclass(frozen=True)
class Simulated:
    """A finished file."""

    path: Path
    draws: int
    new: int  # draws that this call made
    seconds: float  # their time, without the compilation
    reasons: Counter[str]  # why draws have no stream, with their numbers


def simulate(
    run_file: Source,
    out: str | Path,
    draws: int,
    *,
    noise: bool = True,
    particles: bool = False,
    workers: Engine | Executor | int = 1,
    resume: bool = False,
    force: bool = False,
    progress: bool = True,
    tell: Callable[[str], object] | None = None,
) -> Simulated:
    """Make streams at draws of the priors, and write them with their observables into an HDF5 file.

    Parameters
    ----------
    run_file
        A spec, the path of a run file, or a mapping of the same form.
    out
        The file. README.md of this package lists its data sets.
    draws
        Their number, those of an earlier call included.
    noise
        Whether ``x`` has the noise of the data. Their own noise, of a finite number of particles, it has always.
    particles
        Whether the particles of every stream are stored.
    workers
        Processes, an executor, or an engine. The file does not depend on them, bit for bit.
    resume, force
        Continue the file, which may get more draws; or replace it.
    progress
        Whether progress is shown.
    tell
        Called with a sentence on the size before the draws are made.

    Raises SpecError if the run file has no prior or nothing to measure, StreamkitError if the file exists or the
    disk has no room for it, ChainError if it cannot be continued, ComponentError if a component fails. Raises
    Interrupted after Ctrl-C or SIGTERM: all draws until then are in the file.
    """
    spec, out = as_spec(run_file), Path(out)
    _check(spec, out, particles, resume, force)
    simulator = Simulator(spec, noise, particles)
    with ExitStack() as stack:
        stack.enter_context(one_thread())
        where = stack.enter_context(engine(workers)) if isinstance(workers, Engine) else workers
        limit = spec.sampler.call_limit
        layout = first_call(limit, _layout, simulator)  # compiles once, before workers fork
        _prepare(out, layout, draws, resume)
        if tell is not None:
            tell(_described(out, layout, draws))
        pool = stack.enter_context(Workers({"full": simulator}, where, limit, spec.sampler.over_limit == "reject"))
        archive = stack.enter_context(opened(out, layout))
        begun, first = monotonic(), archive.done
        bar = stack.enter_context(Progress(out.name, draws, "draw", done=first, shown=progress))
        with _explained(archive, out, draws, pool):
            _fill(archive, simulator, pool, draws, bar)
        spent = monotonic() - begun
    return Simulated(out, draws, draws - first, spent, reasons_in(out))


def reasons_in(path: Path) -> Counter[str]:
    """Count the reasons why draws of a file have no stream."""
    with h5py.File(path, "r") as file:
        done = int(file["done"][0])
        return Counter(text.decode(errors="replace") for text in file["why_not"][:done].tolist() if text)


def _check(spec: Spec, out: Path, particles: bool, resume: bool, force: bool) -> None:
    if not spec.names:
        raise SpecError(f"{spec.source}: no field has a prior: all draws would be the same stream")
    if not particles and not any(stream.observables for stream in spec.bind_all().streams.values()):
        raise SpecError(f"{spec.source}: there is no observable, and a draw would be empty: add one, or --particles")
    if not out.parent.is_dir():
        raise StreamkitError(f"{out}: the directory {str(out.parent)!r} does not exist")
    if out.is_dir():
        raise StreamkitError(f"{out}: is a directory, and a file is wanted")
    if out.suffix not in SUFFIXES:
        raise StreamkitError(f"{out}: the file is HDF5, and its suffix must be {' or '.join(SUFFIXES)}")
    if out.exists() and not (resume or force):
        raise StreamkitError(f"{out}: the file exists; --resume continues it, --force replaces it")


def _layout(simulator: Simulator) -> Layout:
    """Return what the file will have, from the first draw with a stream."""
    spec, data, kept = simulator.spec, simulator.data, simulator.measured
    _, observation = simulator.first()
    names = np.array(observation.prediction.names, dtype=object)[kept]
    counts = {name: len(stream.tail) for name, stream in observation.streams.items()} if simulator.particles else {}
    document = {key: value for key, value in spec.document.items() if key not in ("sampler", "engine")}
    content = {
        "run_file": document,
        "digest": spec.digest(sampler=False),
        "noise": simulator.noise,
        "particles": simulator.particles,
    }
    return Layout(
        spec.names, spec.units, tuple(names), data.values[kept], data.errors[kept], simulator.noise, counts, content
    )


def _prepare(out: Path, layout: Layout, draws: int, resume: bool) -> None:
    """Make the file, or make room for more draws in it."""
    if not (resume and out.exists()):
        create(out, layout, draws)
        return
    done, room = compare(out, layout)
    if room > draws:
        raise StreamkitError(f"{out}: has {done} of {room} draws; --draws {draws} would make it shorter")
    if room < draws:
        create(out, layout, draws, earlier=out)


def _described(out: Path, layout: Layout, draws: int) -> str:
    parts = [f"{len(layout.parameters)} parameters", f"{len(layout.names)} numbers"]
    parts += [f"{n} particles of {name}" for name, n in layout.particles.items()]
    each = layout.bytes_of_draw()
    return f"{out}: {draws} draws, each with {', '.join(parts)}: {in_bytes(draws * each)}"


def _fill(archive: Archive, simulator: Simulator, pool: Workers, draws: int, bar: Progress) -> None:
    """Make the missing draws. They are written every few seconds, and at an error."""
    waiting: list[dict[str, Array]] = []
    most = max(int(MEMORY / archive.layout.bytes_of_draw()), 1)
    saved, next_draw = monotonic(), archive.done
    try:
        while next_draw < draws:
            block = np.arange(next_draw, min(next_draw + min(most, BLOCK), draws))
            for index, evaluation in zip(block.tolist(), pool.each(block[:, None].astype(float)), strict=True):
                waiting.append(_row(archive.layout, simulator, index, evaluation))
                bar.update()
                next_draw = index + 1
                if monotonic() - saved > EVERY or len(waiting) >= most:
                    _write(archive, waiting)
                    saved = monotonic()
    finally:
        _write(archive, waiting)


def _write(archive: Archive, waiting: list[dict[str, Array]]) -> None:
    if waiting:
        archive.append({name: np.array([row[name] for row in waiting]) for name in waiting[0]})
        waiting.clear()


def _row(layout: Layout, simulator: Simulator, index: int, evaluation: Evaluation) -> dict[str, Array]:
    """Return a draw as the file has it."""
    m = len(layout.names)
    details = evaluation.details if not evaluation.reason else np.full(m + _numbers(layout), np.nan)
    if len(details) != m + _numbers(layout):
        raise StreamkitError(
            f"draw {index}: has {len(details)} numbers, the first one had {m + _numbers(layout)}: all draws of a "
            "file must have as many data and particles"
        )
    row = {
        "theta": simulator.parameters(index),
        "x": details[:m],
        "why_not": np.array(evaluation.reason.encode()[:REASON]),
    }
    if layout.noise:
        row["mean"] = evaluation.mean
    first = m
    for name, n in layout.particles.items():
        last = first + n * len(PARTICLE)
        row[f"particles/{name}"] = details[first:last].reshape(n, len(PARTICLE))
        first = last
    return row


def _numbers(layout: Layout) -> int:
    return sum(layout.particles.values()) * len(PARTICLE)


@contextmanager
def _explained(archive: Archive, out: Path, draws: int, pool: Workers) -> Iterator[None]:
    """Turn signals into a clean stop; an error says where the finished part is."""
    try:
        with stopped_by_signals(pool):
            yield
    except Stopped as stop:
        raise Interrupted(
            f"stopped after {archive.done} of {draws} draws, which are in {out}. To continue: the same command with "
            "--resume", stop.signum,
        ) from None  # fmt: skip
    except StreamkitError as error:
        raise type(error)(f"{error}. {out} has {archive.done} of {draws} draws") from error.__cause__
