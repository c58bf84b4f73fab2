"""Checks of encounters across sections: the stream that a body meets must be there, and long enough ago."""

from __future__ import annotations

from collections.abc import Iterator

from streamkit.components import LiveStripping
from streamkit.errors import nearest
from streamkit.runfile.body_table import TABLE
from streamkit.runfile.encounter import ENCOUNTER, Encounter
from streamkit.runfile.sections import Sections

NUMBERS = [name for name, field in Encounter.model_fields.items() if field.is_required()]


def misplaced(sections: Sections) -> list[str]:
    """Return a sentence for each encounter with a stream that the run file lacks, or that cannot have one."""
    found = [e for each in sections.encounters.values() for e in _misplaced(each.path, each.centre, sections)]
    for table, meeting in sections.tables.values():
        rows = table.centre.bodies(meeting.centre)
        latest, row = max((encounter.time, i) for i, (_, encounter) in enumerate(rows, start=1))
        one = Encounter(**dict(meeting.centre), **dict.fromkeys(NUMBERS, 0.0) | {"time": latest})
        for error in _misplaced(f"{table.path}.{ENCOUNTER}", one, sections):
            found.append(error.replace(f"{ENCOUNTER}.time:", f"{TABLE}: row {row}, time:", 1))
    return found


def _misplaced(path: str, encounter: Encounter, sections: Sections) -> Iterator[str]:
    streams = sections.streams
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
