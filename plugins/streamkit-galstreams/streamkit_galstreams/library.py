"""The library behind ``streamkit init --stream``."""

from __future__ import annotations

from collections.abc import Sequence

from streamkit import StreamkitError
from streamkit.cli import Written
from streamkit_galstreams.catalogue import Track, streams, tracks_of
from streamkit_galstreams.measured import measured
from streamkit_galstreams.points import Points, points_of
from streamkit_galstreams.runfile import written


class Galstreams:
    """The streams of galstreams."""

    def names(self) -> list[str]:
        """Return the names of the streams."""
        return sorted(streams())

    def write(self, names: Sequence[str]) -> Written:
        """Return a run file for these streams; a name may also be that of a track, such as ``GD-1.ibata2021``.

        Raises StreamkitError for an unknown name, for a name given twice, and for a track along no great circle.
        """
        chosen = [best(tracks_of(name)) for name in names]
        twice = {track.stream for track in chosen if sum(each.stream == track.stream for each in chosen) > 1}
        if twice:
            raise StreamkitError(f"init --stream: {', '.join(sorted(twice))}: given twice")
        return written([_points(track) for track in chosen])


def best(candidates: Sequence[Track]) -> Track:
    """Return the track with the most that was measured; the newest of equal ones."""
    return max(candidates, key=lambda track: (measured(track).rank, track.paper[-4:], track.name))


def _points(track: Track) -> Points:
    try:
        return points_of(track)
    except ValueError as error:
        raise StreamkitError(f"init --stream: {track.name}: {error}") from None
