"""Tries of faults: a run that one comes to, what is left of it, and whether it goes on as if there had been none."""

from __future__ import annotations

import random
import shutil
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from disturbed import Disturbed, differs, undisturbed, write_run

import streamkit as sk
from streamkit.sample import CHAIN, JOURNAL, Chain, read_chain_file

LENGTH = 160  # steps of the runs that nothing happens to
LATEST = 60  # step before which a fault comes
LIMIT = 150.0  # seconds within which a run has to end


@dataclass
class Found:
    """What came of one try."""

    hung: bool = False
    traceback: bool = False
    lost: int = 0
    resumed: str = "-"
    message: str = ""
    odd: list[str] = field(default_factory=list)
    """What should not be."""


class Try:
    """One try of a fault: a folder with a run file, and what becomes of the run."""

    def __init__(self, lab: Lab, seed: int, potential: str = "tf") -> None:
        self.rng, self.lab, self.found = random.Random(seed), lab, Found()
        self.folder, self.chain = lab.folder(potential)
        self.out = self.folder / "out"

    def start(self, *more: str, **options: Any) -> Disturbed:
        """Start the run."""
        return Disturbed(self.folder, "run", "run.toml", "-o", str(self.out), *more, **options)

    def moment(self, run: Disturbed) -> None:
        """Wait for a random moment: of the beginning of the run in one try of six, else within a random step."""
        if self.rng.random() < 1 / 6:
            moment = run.began + self.rng.uniform(0, 4)
            run.wait(lambda: run.steps > 0 or time.monotonic() > moment, LIMIT)
            return
        wanted = self.rng.randrange(LATEST)
        run.wait(lambda: run.steps >= wanted, LIMIT)
        time.sleep(self.rng.uniform(0, 0.05))

    def end(self, run: Disturbed, *allowed: int, kept: bool = True) -> None:
        """Wait for the end; note what was said, and what cannot be read of what was finished."""
        self.found.hung |= not run.ended(LIMIT)
        self.said(run)
        if run.status not in allowed:
            self.found.odd.append(f"exit status {run.status}, expected {allowed}: {run.text[-600:]}")
        if kept:
            self.lost(run.steps)

    def said(self, run: Disturbed) -> None:
        """Note what a command has printed."""
        self.found.traceback |= "Traceback" in run.text
        if result := [line for line in run.text.splitlines() if line.strip()]:
            self.found.message = self.found.message or result[-1].replace(str(self.folder), "")

    def lost(self, finished: int) -> None:
        """Note how many finished steps cannot be read."""
        try:
            steps = len(self._read().chain)
        except sk.ChainError as error:
            steps = 0
            if finished:
                self.found.odd.append(str(error))
        self.found.lost += max(finished - steps, 0)

    def _read(self) -> Chain:
        return read_chain_file(self.out / CHAIN)

    def resume(self) -> None:
        """Resume, let some more steps be taken, and compare with the run that nothing happened to."""
        with suppress(sk.ChainError):
            if what := differs(self._read(), self.chain):
                self.found.odd.append(f"before the resumption {what} differs")
        run = self.start("--resume")
        target = []

        def more() -> bool:
            if run.steps and not target:
                target.append(run.steps + 3)
            return bool(target) and run.steps >= target[0]

        self.found.hung |= not run.wait(more, LIMIT)
        run.signal(signal.SIGTERM)
        self.found.hung |= not run.ended(LIMIT)
        self.found.traceback |= "Traceback" in run.text
        if run.status != 143:
            self.found.resumed = "refused"
            self.found.odd.append(f"not resumed, exit status {run.status}: {run.text[-600:]}")
            return
        result = self._read()
        what = differs(result, self.chain)
        self.found.resumed = "same" if not what and len(result.chain) == run.steps else f"{what or 'length'} differs"

    def stopped(self, journal: bool) -> None:
        """Put a run there that was stopped at some step, by a kill if its journal is to be there."""
        shutil.copytree(self.lab.stopped(journal), self.out)

    def refused_or_resumed(self, mend: Callable[[], None] | None = None, harmless: bool = False) -> None:
        """Resume what was damaged: it is refused and left alone, and resumed once it is mended.

        What is harmless may also be resumed at once.
        """
        before = self._bytes()
        run = self.start("--resume")
        at_once = run.wait(lambda: run.steps > 0, LIMIT) and run.status is None
        if at_once:
            run.signal(signal.SIGTERM)
        self.end(run, 143 if at_once and harmless else 2)
        if at_once:
            what = differs(self._read(), self.chain)
            self.found.resumed = f"{what} differs" if what else "same"
            return
        if self._bytes() != before:
            self.found.odd.append("files were changed though it was refused")
        if mend is not None:
            mend()
            self.resume()

    def _bytes(self) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in self.out.iterdir() if path.is_file() and path.name[0] != "."}


class Lab:
    """Folders for the tries, and what they are compared with."""

    def __init__(self, place: Path) -> None:
        self.place, self._number = place, 0
        self._chains: dict[str, Chain] = {}
        self._stopped: dict[bool, Path] = {}
        self._cold = 0.0

    def folder(self, potential: str) -> tuple[Path, Chain]:
        """Return a new folder with a run file, and the chain of an undisturbed run of it."""
        if potential not in self._chains:
            home = self.place / potential
            write_run(home, potential)
            self._chains[potential] = undisturbed(home, LENGTH)
        self._number += 1
        folder = self.place / f"try{self._number}"
        write_run(folder, potential)
        return folder, self._chains[potential]

    def stopped(self, journal: bool) -> Path:
        """Return the directory of a run of some forty steps."""
        if journal not in self._stopped:
            one = Try(self, 0)
            run = one.start()
            run.wait(lambda: run.steps >= 40, LIMIT)
            run.signal(signal.SIGKILL if journal else signal.SIGTERM)
            one.end(run, -9 if journal else 143)
            self._stopped[journal] = one.out
        return self._stopped[journal]

    def cold(self) -> float:
        """Return the seconds that a new interpreter needs for a run's first step."""
        if not self._cold:
            one = Try(self, 0)
            run = one.start(cold=True)
            run.wait(lambda: (one.out / JOURNAL).exists(), LIMIT)
            self._cold = time.monotonic() - run.began
            run.signal(signal.SIGKILL)
            run.ended(LIMIT)
        return self._cold
