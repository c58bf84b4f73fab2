"""Plugins that are switched off, and the packages of missing ones: all that `streamkit --help` needs."""

from __future__ import annotations

import os
import re
from importlib.metadata import PackageNotFoundError, requires

from streamkit.distribution import NAME

# Environment variable: entry-point names, separated by commas, of plugins and commands that are not loaded.
DISABLE = "STREAMKIT_DISABLE_PLUGINS"


def switched_off() -> set[str]:
    """Return the entry-point names that `DISABLE` lists."""
    return {name.strip() for name in os.environ.get(DISABLE, "").split(",")} - {""}


def where_to_find(name: str) -> str:
    """Return a sentence with the package that has a component or command; empty if no package is known to have it.

    The metadata of this distribution know the package: each kind and command of a package is one of the extras.
    """
    extra = re.sub("[-_.]+", "-", name).lower()  # as names of extras are stored
    try:
        requirements = requires(NAME) or []
    except PackageNotFoundError:  # the files are used without an installation
        requirements = []
    for line in requirements:
        if found := re.match(rf"(streamkit-[a-z]+).*; extra == ['\"]{re.escape(extra)}['\"]$", line):
            package = found[1]
            return (
                f" {name!r} is in {package}: pip install {package} (in a clone of streamkit: "
                f"pip install plugins/{package})."
            )
    return ""
