"""The distribution that brings this package, and other distributions that write into its folder."""

from __future__ import annotations

from importlib.metadata import Distribution, PackageNotFoundError, distribution

PACKAGE = "streamkit"  # the name of the import, of the folder and of the command
VERSION = "0.1.0"

# The name on a package index. To change it: `git grep -l OLD | xargs sed -i s/OLD/NEW/`, with this name as OLD.
# tests/contract/test_distribution.py checks that all places have the same name.
NAME = "tidal-streamkit"


def foreign_files() -> str:
    """Return a sentence if a distribution called `PACKAGE` is installed beside this one; empty if there is none.

    On public indexes `PACKAGE` is a package for messages of another project. It has the same folder and the same
    command, so each of the two overwrites files of the other.
    """
    other = _installed(PACKAGE)
    if other is None or (_brings_components(other) and _installed(NAME) is None):  # an install of before the name
        return ""
    whose = "an older install of this package" if _brings_components(other) else "a package of another project"
    return (
        f"The distribution {PACKAGE!r} {other.version} is installed too, {whose} that writes files into the same "
        f"folder. Remove both, then install this one again: pip uninstall {PACKAGE} {NAME}, pip install {NAME}."
    )


def _installed(name: str) -> Distribution | None:
    try:
        return distribution(name)
    except PackageNotFoundError:
        return None


def _brings_components(dist: Distribution) -> bool:
    return any(point.group == PACKAGE and point.value == f"{PACKAGE}.builtin" for point in dist.entry_points)
