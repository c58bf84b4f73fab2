"""Fixtures for the tests of the studies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure


@pytest.fixture
def unrendered_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every picture is made and its file written, but empty: rendering is slow, and tested where it is the subject."""

    def write(self: Figure, name: Any, **options: Any) -> None:
        Path(name).touch()

    monkeypatch.setattr(Figure, "savefig", write)
