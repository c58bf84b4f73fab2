"""Plugins that are switched off by name."""

from __future__ import annotations

import os

# Environment variable: entry-point names, separated by commas, of plugins and commands that are not loaded.
DISABLE = "STREAMKIT_DISABLE_PLUGINS"


def switched_off() -> set[str]:
    """Return the entry-point names that `DISABLE` lists."""
    return {name.strip() for name in os.environ.get(DISABLE, "").split(",")} - {""}
