"""Progress of long work: a bar on a terminal or in a notebook, elsewhere a line of log every so often."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from typing import Any

import numpy as np
from tqdm import auto

from streamkit.report.text import seconds

EVERY = 60.0  # seconds between two lines of log; for long work, a hundredth of the elapsed time if that is longer
SOON = 5.0  # seconds between two lines of log if a tenth of the work was done between them
SHARE = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}{postfix}"  # a bar without counts


class Bar(auto.tqdm):  # type: ignore[misc]  # tqdm has no types
    """A progress bar without tqdm's thread that looks after slow ones: processes are forked while none runs."""

    monitor_interval = 0

    def aim(self, total: float) -> None:
        """Set the total, if it is finite; a notebook's bar has a copy of it."""
        self.total = _or_none(total)
        if hasattr(self, "container") and np.isfinite(total):
            self.container.children[1].max = total


NOTEBOOK = any(base.__module__ == "tqdm.notebook" for base in Bar.__mro__)


class Progress:
    """The progress of some work, its expected end, and a note; on standard error."""

    def __init__(
        self,
        what: str,  # the work: "sampling"
        total: float,  # the amount of work; infinite where it is unknown
        unit: str = "",  # the counted unit in the singular; with "" only the percentage is shown
        *,
        done: float = 0,  # the amount done before
        shown: bool = True,
        keep: bool = False,  # whether a bar stays when the work is done
        deadline: float = np.inf,  # value of `time.monotonic` at which the work ends in any case
    ) -> None:
        self.done, self._total = done, total
        self._what, self._unit, self._note = what, unit, ""
        self._deadline, self._first = deadline, done
        self._begun = self._last = time.monotonic()
        self._logged = done
        self._bar: Any = None
        self._lines = shown and not NOTEBOOK and not sys.stderr.isatty()
        if shown and not self._lines:
            form = {"unit": unit} if unit else {"bar_format": SHARE}
            self._bar = Bar(desc=what, total=_or_none(total), initial=done, leave=keep, dynamic_ncols=True, **form)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Show no more."""
        with suppress(OSError, ValueError):  # as in `update`
            if self._bar is not None:
                self._bar.close()

    def update(self, more: float = 1) -> None:
        """Count what was done, and show it if it is time to."""
        self.done += more
        try:
            if self._bar is not None:
                self._bar.aim(self.total)
                self._bar.update(more)
            elif self._lines:
                self._log()
        except (OSError, ValueError):  # the terminal is gone, or closed: the work continues without
            self._bar, self._lines = None, False

    def expect(self, total: float) -> None:
        """Replace the estimate of the total."""
        self._total = total

    def note(self, text: str) -> None:
        """Show more beside the numbers from the next update on."""
        self._note = text
        if self._bar is not None:
            self._bar.set_postfix_str(text, refresh=False)

    @property
    def total(self) -> float:
        """The estimate of the total at the end, or at the deadline if that is sooner."""
        now, new = time.monotonic(), self.done - self._first
        total = max(self._total, self.done)
        if not np.isfinite(self._deadline) or new <= 0:
            return total
        reached = self.done + new / max(now - self._begun, 1e-9) * max(self._deadline - now, 0.0)
        return float(min(total, max(np.floor(reached), self.done)))

    def line(self) -> str:
        """Return what a line of log says."""
        spent, new, total = time.monotonic() - self._begun, self.done - self._first, self.total
        note = f"; {self._note}" if self._note else ""
        if not np.isfinite(total):
            return f"{self._what}: {self.done:.0f} {self._unit}s after {seconds(round(spent))}{note}"
        share = f"{100 * self.done / max(total, 1):.0f} %"
        of = f"of about {total:.0f}" if np.isfinite(self._deadline) else f"of {total:.0f}"
        counted = f"{self.done:.0f} {of} {self._unit}s ({share})" if self._unit else share
        left = f", about {seconds(round(spent / new * (total - self.done)))} left" if new > 0 else ""
        return f"{self._what}: {counted} after {seconds(round(spent))}{left}{note}"

    def _log(self) -> None:
        now = time.monotonic()
        waited = now - self._last
        tenth = self.done - self._logged >= 0.1 * self.total
        if waited >= max(EVERY, 0.01 * (now - self._begun)) or (tenth and waited >= SOON):
            self._last, self._logged = now, self.done
            print(f"{time.strftime('%H:%M:%S')} streamkit: {self.line()}", file=sys.stderr, flush=True)  # noqa: T201


def _or_none(total: float) -> float | None:
    return total if np.isfinite(total) else None
