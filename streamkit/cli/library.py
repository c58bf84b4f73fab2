"""Libraries of known streams, which other packages bring: ``streamkit init --stream NAME`` writes from them.

A package names a class without arguments by an entry point of the group ``streamkit.streams``::

    [project.entry-points."streamkit.streams"]
    galstreams = "streamkit_galstreams.library:Galstreams"
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points
from typing import NamedTuple, Protocol

from streamkit.components import switched_off, where_to_find
from streamkit.errors import PluginError, StreamkitError, message_of

GROUP = "streamkit.streams"
KNOWN = "galstreams"  # the library that a message names where there is none


class Written(NamedTuple):
    """A run file of known streams, as text."""

    name: str  # of the file, "gd1.toml"
    text: str
    tables: dict[str, str]  # the files that it reads, by their name in it


class StreamLibrary(Protocol):
    """What ``streamkit init --stream`` needs of a library."""

    def names(self) -> Sequence[str]:
        """Return the names of its streams."""

    def write(self, names: Sequence[str]) -> Written:
        """Return a run file of some streams; StreamkitError for a name that it does not know."""


def write_streams(names: Sequence[str]) -> Written:
    """Return a run file for known streams, by the first library that has them all.

    Raises StreamkitError if no library is installed, or none has the streams: with its reason. Raises PluginError if a
    library cannot be loaded.
    """
    points = [point for point in entry_points(group=GROUP) if point.name not in switched_off()]
    if not points:
        raise StreamkitError(f"init --stream: no library of streams is installed.{where_to_find(KNOWN)}")
    refused = []
    for point in sorted(points, key=lambda each: each.name):
        library = _loaded(point)
        try:
            return library.write(names)
        except StreamkitError as error:
            refused.append(str(error))
    raise StreamkitError("\n".join(refused))


def _loaded(point: EntryPoint) -> StreamLibrary:
    try:
        library: StreamLibrary = point.load()()
    except Exception as error:
        reason = f"{type(error).__name__}: {message_of(error)}"
        raise PluginError(f"the library of streams {point.name!r} cannot be loaded ({reason})") from error
    return library
