"""A run in a directory: claimed, carried to today, and never more than a minute lost."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from tqdm import tqdm

from streamkit import GYR
from streamkit.errors import ChainError, Interrupted, StreamkitError
from streamkit.report import contents, locked, save
from streamkit.runfile import differences, to_toml
from streamkit.sample import stopped_by_signals
from streamkit_nbody import snapshot
from streamkit_nbody.plan import content, digest
from streamkit_nbody.simulation import Simulation
from streamkit_nbody.state import State

CHECKPOINT, RUN_FILE, SNAPSHOT = "checkpoint.hdf5", "run.toml", "snapshot_{:03d}.hdf5"
PRODUCTS = (CHECKPOINT, RUN_FILE, "snapshot_*.hdf5")
EVERY = 60.0  # seconds between checkpoints


def run(
    simulation: Simulation,
    out: Path,  # directory of the snapshots and the checkpoint
    *,
    snapshots: int = 1,  # number of snapshots at equal intervals; the last one is of today
    resume: bool = False,
    force: bool = False,
    progress: bool = True,
) -> State:
    """Carry a live satellite to today, and return its last state.

    Raises ChainError if the directory or its checkpoint cannot be used: nothing is then changed. Raises Interrupted
    after Ctrl-C or SIGTERM.
    """
    here = _Run(simulation, out)
    with locked(out), stopped_by_signals(here):
        state = here.claim(resume, force)
        if state is None:
            state = simulation.start()
            here.write_run_file()
            here.write(CHECKPOINT, state)
        return here.integrate(state, snapshots, progress)


@dataclass
class _Run:
    """A simulation in its directory. ``stop`` is the number of the signal that asked for an end, or 0."""

    simulation: Simulation
    out: Path
    stop: int = 0

    @cached_property
    def content(self) -> dict[str, Any]:
        return content(self.simulation.spec, self.simulation.inputs, self.simulation.plan)

    def write(self, name: str, state: State) -> None:
        snapshot.write(self.out / name, self.simulation, state, self.content)

    def integrate(self, state: State, snapshots: int, progress: bool) -> State:
        """Integrate to today; a signal is answered after a block of steps and its checkpoint."""
        plan, saved, checkpoint = self.simulation.plan, monotonic(), self.out / CHECKPOINT
        wanted = np.linspace(0, plan.records, snapshots + 1).round().astype(int)[1:].tolist()
        span = plan.span / GYR
        with tqdm(total=plan.records, initial=state.record, unit="rec", disable=not progress, mininterval=2.0) as bar:
            while state.record < plan.records:
                try:
                    state = self.simulation.advance(state)
                except StreamkitError as error:
                    self.write(CHECKPOINT, state)
                    raise type(error)(f"{error}. All until {state.time / GYR:.3f} Gyr is in {checkpoint}") from None
                left = state.track.mass[-1] / state.track.mass[0]
                bar.set_postfix_str(f"{state.time / GYR:.2f}/{span:.2f} Gyr, bound {left:.3f}", refresh=False)
                bar.update()
                if state.record in wanted:
                    self.write(SNAPSHOT.format(wanted.index(state.record) + 1), state)
                if self.stop or monotonic() - saved > EVERY or state.record == plan.records:
                    self.write(CHECKPOINT, state)
                    saved = monotonic()
                if self.stop and state.record < plan.records:
                    raise Interrupted(
                        f"stopped at {state.time / GYR:.3f} of {span:.3f} Gyr; all of it is in {checkpoint}. "
                        "To continue: the same command with --resume", self.stop,
                    )  # fmt: skip
        return state

    def write_run_file(self) -> None:
        """Write the resolved run file; the paths of its plugins and data files no longer depend on where it lies."""
        spec = self.simulation.spec
        document = spec.with_files_at({name: str(spec.folder / name) for name in spec.files})
        if "plugins" in document:
            document["plugins"] = [str(spec.folder / name) for name in document["plugins"]]
        text = to_toml(document, "The run file with every default filled in, as streamkit-nbody used it.")
        save(self.out / RUN_FILE, lambda part: part.write_text(text, encoding="utf-8"))

    def claim(self, resume: bool, force: bool) -> State | None:
        """Claim the directory for this run; return the state to continue from, None to begin."""
        files, checkpoint = contents(self.out), self.out / CHECKPOINT
        if not files:
            return None
        if CHECKPOINT not in files:
            raise ChainError(
                f"{self.out}: is not empty (found {', '.join(files[:4])}) and holds no {CHECKPOINT} of a run. "
                "Choose another directory."
            )
        if force:
            for path in (path for pattern in PRODUCTS for path in self.out.glob(pattern)):
                path.unlink()
            return None
        if not resume:
            raise ChainError(
                f"{self.out}: holds a run already. --resume continues it (with the same run file and options), "
                "--force overwrites it, or choose another directory."
            )
        state, earlier = snapshot.read(checkpoint)
        there, here = digest(earlier), digest(self.content)
        if there != here:
            raise ChainError(
                f"{checkpoint}: is of another run (digest {there[:12]}, this one has {here[:12]}). "
                f"What differs (there -> here): {'; '.join(differences(earlier, self.content))}. "
                "Choose another directory, or --force to overwrite."
            )
        return state
