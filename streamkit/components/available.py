"""Plugins that are switched off, and the packages of missing ones: all that `streamkit --help` needs."""

from __future__ import annotations

import os
from collections.abc import Mapping

# Environment variable: entry-point names, separated by commas, of plugins and commands that are not loaded.
DISABLE = "STREAMKIT_DISABLE_PLUGINS"

# The plugins of this repository, for the hint if one is not installed: package -> role, or ``command`` -> names.
PACKAGES: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "streamkit-spray": {"stripping": ("fardal15", "fardal15_gala", "chen25")},
    "streamkit-nautilus": {"sampler": ("nautilus",)},
    "streamkit-dynesty": {"sampler": ("dynesty",)},
    "streamkit-nbody": {"command": ("nbody",)},
    "streamkit-gala": {"potential": ("gala",)},
    "streamkit-galpy": {"potential": ("galpy",)},
    "streamkit-agama": {"potential": ("agama",)},
}


def switched_off() -> set[str]:
    """Return the entry-point names that `DISABLE` lists."""
    return {name.strip() for name in os.environ.get(DISABLE, "").split(",")} - {""}


def where_to_find(role: str, name: str) -> str:
    """Return a sentence with the package that has a component or command; empty if no package is known to have it."""
    for package, offers in PACKAGES.items():
        if name in offers.get(role, ()):
            return (
                f" {name!r} is in {package}: pip install {package} (in a clone of streamkit: "
                f"pip install plugins/{package})."
            )
    return ""
