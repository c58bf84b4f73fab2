"""The progress of the sampling as it is shown: calls, or steps of a chain; speed, acceptance and a running mass."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from os import getpid
from time import monotonic

import numpy as np

from streamkit.report import Progress
from streamkit.sample.store.chain_file import ChainMemory
from streamkit.sample.store.storage import Storage
from streamkit.stream import Array

NOTES = 5.0  # seconds between two notes beside the progress
SOON = 1.0  # seconds after which it is shown that a sampler is at work, where it makes no call


class SamplingProgress:
    """The progress of one run. Calls are counted, or the steps of a chain where there is one."""

    def __init__(
        self,
        shown: bool = False,
        deadline: float = np.inf,  # value of `time.monotonic` when the sampling ends
        # A radius in kpc, and a function for the mass inside it in Msun at a point (d,), for the progress of a chain.
        mass: tuple[float, Callable[[Array], float]] | None = None,
        full_cost: float = 1.0,  # approximate cost of a call in units of one with a small stream, for the search
    ) -> None:
        self.shown, self.full_cost = shown, full_cost
        self._deadline, self._mass = deadline, mass
        self._expected, self._remark = np.inf, ""
        self._bar: Progress | None = None
        self._shown_at, self._process = -np.inf, getpid()
        self.starts = False  # whether the bar is that of calls with few particles, before all others

    def expect(self, total: float) -> None:
        """Set the expected total number of calls, or of steps."""
        self._expected = total
        if self._bar is not None and not self.starts:
            self._bar.expect(total)

    def remark(self, text: str) -> None:
        """Show a short text beside the numbers."""
        self._remark = text

    def update(self, more: int, calls: int, storage: Storage, small: bool = False) -> None:
        """Count ``more`` calls or steps, after ``calls`` calls in all, with a note every `NOTES` seconds.

        Calls with few particles (``small``) are no part of the expected number: those before all others have a bar of
        their own, and later ones are not counted.
        """
        if self._bar is None or (self.starts and not small):
            self.close()
            unit, done = ("step", storage.chain.iteration - more) if storage.is_chain else ("call", 0)
            what = ("start with few particles", np.inf) if small else ("sampling", self._expected)
            self._noted = monotonic()
            self._begun, self.starts = (self._noted, calls), small
            self._bar = Progress(*what, unit, done=done, shown=self.shown, keep=not small,
                                 deadline=np.inf if small else self._deadline)  # fmt: skip
        now = self._shown_at = monotonic()
        if now - self._noted > NOTES:
            self._noted = now
            self._bar.note(", ".join(filter(None, [*self._notes(now, calls, storage.chain), self._remark])))
        self._bar.update(more if small == self.starts else 0)

    @property
    def waits(self) -> bool:
        """Whether nothing has been shown for a while: a sampler is at work between two calls. A fork shows nothing."""
        return getpid() == self._process and monotonic() - self._shown_at > SOON

    def close(self) -> None:
        """End the display."""
        if self._bar is not None:
            self._bar.close()

    def _notes(self, now: float, calls: int, chain: ChainMemory) -> Iterator[str]:
        """Yield acceptance, speed and running mass."""
        begin, before = self._begun
        if chain.iteration:
            yield f"accepted {100 * chain.acceptance:.0f} %"
        if not self.starts:
            yield f"{(calls - before) / max(now - begin, 1e-9):.1f} calls/s"
        if chain.last is not None and self._mass is not None:
            radius, mass = self._mass
            low, middle, high = np.percentile([mass(point) / 1e11 for point in chain.last.coords], [16, 50, 84])
            yield f"M({radius:g} kpc) {middle:.3g} +{high - middle:.2g} -{middle - low:.2g}e11 Msun"
