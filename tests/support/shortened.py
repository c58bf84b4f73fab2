"""Shorter work, where a test looks at what a run does and writes, and not at its numbers."""

import pytest

from streamkit.builtin.samplers.emulator import populations
from streamkit.sample.calls import search

# The search for a start looks after every 16 draws whether it has enough; a fourth as many are enough, and move less.
SEARCH = {"PARTS": 64, "ENOUGH": 1, "SWEEPS": 1}
WHOLE_SEARCH = {name: getattr(search, name) for name in SEARCH}
# The emulator walks a fifth as far to its answer.
WALKS = {"WALKERS": 400, "FIRST": 60}


def set_search(patch: pytest.MonkeyPatch, values: dict[str, int]) -> None:
    """Give the search for a start other constants."""
    for name, value in values.items():
        patch.setattr(search, name, value)


def shorten_walks(patch: pytest.MonkeyPatch) -> None:
    """Let the emulator walk less: for runs whose widths nobody looks at."""
    for name, value in WALKS.items():
        patch.setattr(populations, name, value)
