"""Checks of encounters across sections: the stream that a body meets must be there, and long enough ago."""

from __future__ import annotations

from collections.abc import Iterator

from streamkit.components import LiveStripping
from streamkit.errors import nearest
from streamkit.runfile.encounter import Encounter
from streamkit.runfile.section import Section
from streamkit.runfile.sections import Sections


def misplaced(sections: Sections) -> list[str]:
    """Return a sentence for each encounter with a stream that the run file lacks, or that cannot have one."""
    return [error for section in sections.encounters.values() for error in _misplaced(section, sections)]


def _misplaced(section: Section[Encounter], sections: Sections) -> Iterator[str]:
    path, encounter, streams = section.path, section.centre, sections.streams
    name = sections.stream_met(encounter)
    if name not in streams:
        if encounter.stream is None:
            yield f"{path}: 'stream' is missing; it names one of the streams {', '.join(streams) or '(there is none)'}"
        else:
            called = f"found {encounter.stream!r}, and no stream is called so"
            yield f"{path}.stream: {called}.{nearest(encounter.stream, streams)} Streams: {', '.join(streams)}."
        return
    where, longest = streams[name].lookback
    if encounter.time >= longest:
        yield (
            f"{path}.time: found {encounter.time:g} Gyr, expected less than the look-back time: the stream begins "
            f"{longest:g} Gyr ago ({where})"
        )
    stripping = streams[name].stripping
    if issubclass(stripping.cls, LiveStripping):
        yield (
            f"{path}: the stripping {stripping.cls.kind!r} follows a live progenitor; an encounter needs a scheme that "
            "releases its particles, such as 'mlcs'"
        )
    if encounter.frame is None and streams[name].frame is None:
        yield (
            f"{path}: 'frame' is missing: neither the progenitor of the stream nor an observable has a frame of phi1 "
            "and phi2"
        )
