"""Shorter work, where a test looks at what a run does and writes, and not at its numbers."""

import pytest

from streamkit.builtin.samplers.emulator import rounds
from streamkit.builtin.samplers.emulator.walk import geodesic, populations
from streamkit.sample.calls import search

# The search for a start looks after every 16 draws whether it has enough; a fourth as many are enough, and move less.
SEARCH = {"PARTS": 64, "ENOUGH": 1, "SWEEPS": 1}
WHOLE_SEARCH = {name: getattr(search, name) for name in SEARCH}
# The emulator walks with fewer walkers and less far to its answer.
WALKS = {"WALKERS": 250, "LEAST_WALKERS": 200, "FIRST": 40, "FIRST_OF_SEVERAL": 16}
# It walks as far as a few samples need, which are taken for many.
STEPS = {
    "WALKERS": 100, "LEAST_WALKERS": 60, "STAGE": 3, "STAGE_OF_SEVERAL": 2, "FIRST": 15, "R_HAT": 1.5,
    "ROUND_WALKERS": 64, "ROUND_SETTLING": 5, "ROUND_SWEEPS": 10, "TEMPERED": 5,
    "FIRST_OF_SEVERAL": 6, "OF_EACH": 3, "ROUND_SWEEPS_OF_SEVERAL": 4,
}  # fmt: skip
FEW = populations.Asked(times=0.5, independent=50, width_error=1.0, least=1.0)


def set_search(patch: pytest.MonkeyPatch, values: dict[str, int]) -> None:
    """Give the search for a start other constants."""
    for name, value in values.items():
        patch.setattr(search, name, value)


def shorten_walks(patch: pytest.MonkeyPatch) -> None:
    """Let the emulator walk less: for samples of which a test knows the moments roughly."""
    for name, value in WALKS.items():
        patch.setattr(populations, name, value)


def take_few_steps(patch: pytest.MonkeyPatch) -> None:
    """Let the emulator walk some steps: for runs whose samples are only stored, counted and compared again."""
    for name, value in STEPS.items():
        patch.setattr(populations, name, value)
    patch.setattr(geodesic, "MOST_STEPS", 1)
    patch.setattr(rounds, "sample", lambda *words, **options: populations.sample(*words, **options | {"asked": FEW}))
    patch.setattr(populations, "GIVEN", FEW)
