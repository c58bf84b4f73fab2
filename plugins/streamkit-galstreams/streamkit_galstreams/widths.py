"""Widths of streams: those of the members, or published ones that the library lists."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from streamkit_galstreams.catalogue import Track, folder

LOG = Path("..") / "lib" / "master_log.txt"  # beside the tracks
COLUMNS = ("phi2", "pm_phi1_cosphi2", "pm_phi2")
NARROWEST = {"phi2": 0.05, "pm_phi1_cosphi2": 0.02, "pm_phi2": 0.02}  # deg, mas/yr: a smaller width is none
MEMBERS, PAPER, NONE = "the width of its members", "its published width", "our guess, as no width is known"
GUESS = {"phi2": 0.3, "pm_phi1_cosphi2": 0.2, "pm_phi2": 0.2}
WIDEST = {"phi2": 3.0, "pm_phi1_cosphi2": 1.0, "pm_phi2": 1.0}


def width_of(track: Track, column: str) -> tuple[float, str]:
    """Return the width of a stream in deg or mas/yr, and where it is from; a guess where none is known."""
    own, published = track.width(column), _published().get(track.name, {}).get(column, 0.0)
    for value, source in ((own, MEMBERS), (published, PAPER)):
        if value >= NARROWEST[column]:
            return min(value, WIDEST[column]), source + (", cut" if value > WIDEST[column] else "")
    return GUESS[column], NONE


@cache
def _published() -> dict[str, dict[str, float]]:
    """Return the positive widths of the library's log, by track and column."""
    found: dict[str, dict[str, float]] = {}
    first, *lines = (folder() / LOG).read_text(encoding="utf-8").splitlines()
    header = first.lstrip("#").split()
    for line in (line for line in lines if not line.startswith("#")):
        row = dict(zip(header, line.split(), strict=False))
        widths = {name: float(row[f"width_{name}"]) for name in COLUMNS}
        found[f"{row['Name']}.{row['TrackRefs']}"] = {name: width for name, width in widths.items() if width > 0}
    return found
