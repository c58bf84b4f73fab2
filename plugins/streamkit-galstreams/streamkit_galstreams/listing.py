"""What the library has, as text."""

from __future__ import annotations

from streamkit.report import columns, paragraph
from streamkit_galstreams.catalogue import Track, streams, tracks_of
from streamkit_galstreams.library import best
from streamkit_galstreams.measured import measured

LETTERS = "s sky, d distance, p proper motion, v velocity"


def streams_text(every: bool) -> str:
    """List the streams with their best track; ``every``: also those that lack distances or proper motions."""
    rows = [("stream", "track", "has", "tracks")]
    found = streams()
    for name in sorted(found, key=str.lower):
        track = best(found[name])
        if every or measured(track).rank[0]:
            rows.append((name, track.name, measured(track).dims, str(len(found[name]))))
    left = len(found) - len(rows) + 1
    more = f"; {left} without distance or proper motion are left out: --all lists them" if left else ""
    note = f"{LETTERS}. {len(found)} streams{more}. 'streamkit galstreams NAME' says what was found in a stream's rows."
    return f"{columns(rows)}\n\n{paragraph(note)}"


def stream_text(name: str) -> str:
    """List the tracks of one stream, the best one first, and the faults of each."""
    tracks = sorted(tracks_of(name), key=lambda track: (track is not best(tracks_of(name)), track.name))
    return "\n".join(_lines(track) for track in tracks)


def _lines(track: Track) -> str:
    found = measured(track)
    told = "; ".join(found.faults) or "nothing to complain of"
    return paragraph(told + ".", f"{track.name}  {found.dims}  ")
