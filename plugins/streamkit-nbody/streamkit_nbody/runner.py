"""A run in a directory: claimed, carried to today, and never more than a minute lost."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from tqdm import tqdm

from streamkit import GYR
from streamkit.errors import ChainError, StreamkitError
from streamkit.report import locked, replace_whole
from streamkit.spec import Spec, differences, to_toml
from streamkit_nbody import snapshot
from streamkit_nbody.plan import content, digest
from streamkit_nbody.simulation import Simulation
from streamkit_nbody.snapshot import CheckpointError
from streamkit_nbody.state import State

CHECKPOINT, RUN_FILE, SNAPSHOT = "checkpoint.hdf5", "run.toml", "snapshot_{:03d}.hdf5"
OURS = (CHECKPOINT, RUN_FILE, "snapshot_*.hdf5")
EVERY = 60.0
"""Seconds between checkpoints."""


class Interrupted(StreamkitError):  # noqa: N818  a request, not a fault
    """The run was asked to stop and did; its checkpoint is written.

    Attributes
    ----------
    exit_status
        130 after Ctrl-C, 143 after SIGTERM.
    """

    def __init__(self, message: str, signum: int) -> None:
        super().__init__(message)
        self.exit_status = 128 + signum


def run(
    simulation: Simulation,
    out: Path,
    *,
    snapshots: int = 1,
    resume: bool = False,
    force: bool = False,
    progress: bool = True,
) -> State:
    """Carry a live satellite to today, and return its last state.

    Parameters
    ----------
    simulation
        What to run.
    out
        Directory of the snapshots and the checkpoint.
    snapshots
        Number of snapshots, at equal intervals; the last one is today's.
    resume, force
        Go on from the checkpoint in the directory; or throw away what a run has left there.
    progress
        Show a progress bar.

    Raises
    ------
    CheckpointError
        If the directory or its checkpoint cannot be used. Nothing is then changed.
    Interrupted
        After Ctrl-C or SIGTERM.
    """
    run_content = content(simulation.spec, simulation.setup, simulation.plan)
    with _locked(out), _signals() as asked:
        state = _claim(out, run_content, resume, force)
        if state is None:
            state = simulation.start()
            _write_run_file(out / RUN_FILE, simulation.spec)
            snapshot.write(out / CHECKPOINT, simulation, state, run_content)
        return _march(simulation, state, out, run_content, snapshots, asked, progress)


def _march(
    simulation: Simulation, state: State, out: Path, run_content: dict[str, Any], snapshots: int, asked: list[int],
    progress: bool,
) -> State:  # fmt: skip
    plan, saved = simulation.plan, monotonic()
    wanted = np.linspace(0, plan.records, snapshots + 1).round().astype(int)[1:].tolist()
    span = plan.span / GYR
    with tqdm(total=plan.records, initial=state.record, unit="rec", disable=not progress, mininterval=2.0) as bar:
        while state.record < plan.records:
            try:
                state = simulation.advance(state)
            except StreamkitError as error:
                snapshot.write(out / CHECKPOINT, simulation, state, run_content)
                raise type(error)(f"{error}. All until {state.time / GYR:.3f} Gyr is in {out / CHECKPOINT}") from None
            left = state.track.mass[-1] / state.track.mass[0]
            bar.set_postfix_str(f"{state.time / GYR:.2f}/{span:.2f} Gyr, bound {left:.3f}", refresh=False)
            bar.update()
            if state.record in wanted:
                name = SNAPSHOT.format(wanted.index(state.record) + 1)
                snapshot.write(out / name, simulation, state, run_content)
            if asked or monotonic() - saved > EVERY or state.record == plan.records:
                snapshot.write(out / CHECKPOINT, simulation, state, run_content)
                saved = monotonic()
            if asked and state.record < plan.records:
                raise Interrupted(
                    f"stopped at {state.time / GYR:.3f} of {span:.3f} Gyr; all of it is in {out / CHECKPOINT}. "
                    "To continue: the same command with --resume", asked[0],
                )  # fmt: skip
    return state


def _write_run_file(path: Path, spec: Spec) -> None:
    """Write the resolved run file; the paths of its plugin files no longer depend on where it lies."""
    document = dict(spec.document)
    if "plugins" in document:
        document["plugins"] = [str(spec.folder / name) for name in document["plugins"]]
    text = to_toml(document, "The run file with every default filled in, as streamkit-nbody used it.")
    replace_whole(path, lambda part: part.write_text(text))


def _claim(out: Path, run_content: dict[str, Any], resume: bool, force: bool) -> State | None:
    """Make the directory this run's own; return the state to go on from, None to begin."""
    files = sorted(path.name for path in out.iterdir() if not path.name.startswith("."))
    if not files:
        return None
    if CHECKPOINT not in files:
        raise CheckpointError(
            f"{out}: is not empty (found {', '.join(files[:4])}) and holds no {CHECKPOINT} of a run. "
            "Choose another directory."
        )
    if force:
        for pattern in OURS:
            for path in out.glob(pattern):
                path.unlink()
        return None
    if not resume:
        raise CheckpointError(
            f"{out}: holds a run already. --resume continues it (with the same run file and options), --force "
            "overwrites it, or choose another directory."
        )
    state, found = snapshot.read(out / CHECKPOINT)
    if digest(found) != digest(run_content):
        changed = "; ".join(differences(found, run_content))
        raise CheckpointError(
            f"{out / CHECKPOINT}: is of another run (digest {digest(found)[:12]}, this one has "
            f"{digest(run_content)[:12]}). What differs (there -> here): {changed}. Choose another directory, or "
            "--force to overwrite."
        )
    return state


@contextmanager
def _locked(out: Path) -> Iterator[None]:
    try:
        with locked(out):
            yield
    except ChainError as error:
        raise CheckpointError(str(error)) from None


@contextmanager
def _signals() -> Iterator[list[int]]:
    """Collect SIGINT and SIGTERM, so that a block of steps and a write are finished first."""
    asked: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda got, _: asked.append(got)) for number in numbers}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
