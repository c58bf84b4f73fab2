"""What the tests of samplers share."""

import pytest

from streamkit.builtin.samplers.emulator import populations


@pytest.fixture
def short_walks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Walks that are as long as their autocorrelation time asks for: enough for posteriors without thin ends."""
    monkeypatch.setattr(populations, "FIRST", 60)
