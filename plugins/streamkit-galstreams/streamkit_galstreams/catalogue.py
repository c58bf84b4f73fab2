"""The tracks of the installed galstreams, read from its files: importing it would need gala and take a minute."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.util import find_spec
from pathlib import Path

import pandas as pd

from streamkit import Array, StreamkitError
from streamkit.errors import nearest

SUMMARY = ".summary.ecsv"
NAMED = re.compile(r"track\.st\.(.+)\.summary\.ecsv")  # ep, po: great circles between two points, or of a pole
COLUMNS = ("ra", "dec", "distance", "pm_ra_cosdec", "pm_dec", "radial_velocity")  # deg, kpc, mas/yr, km/s; ICRS


@dataclass(frozen=True, eq=False)
class Track:
    """One track of the library: a smooth curve through the stars of a stream, by one paper."""

    name: str  # as "GD-1.ibata2021": the stream and the paper
    file: Path  # of its points
    info: dict[str, str]  # of its summary

    @property
    def stream(self) -> str:
        """The name of the stream."""
        return self.info["StreamName"]

    @property
    def paper(self) -> str:
        """The paper, as the library calls it."""
        return self.name.rpartition(".")[2]

    @property
    def flags(self) -> str:
        """Four digits: sky, distance, proper motion, velocity; 1 where a track was measured along the stream."""
        return self.info["InfoFlags"]

    def width(self, name: str) -> float:
        """Return a width of the summary, ``phi2`` in deg or ``pm_phi1_cosphi2``, ``pm_phi2`` in mas/yr; NaN if none."""
        return float(self.info[f"width_{name}"] or "nan")

    @cached_property
    def points(self) -> dict[str, Array]:
        """The columns `COLUMNS` (n,) each."""
        table = pd.read_csv(self.file, comment="#")
        return {name: table[name].to_numpy(dtype=float) for name in COLUMNS}


def folder() -> Path:
    """Return the folder of the tracks; StreamkitError without galstreams."""
    found = find_spec("galstreams")
    if found is None or not found.submodule_search_locations:
        raise StreamkitError("galstreams is not installed: pip install galstreams")
    return Path(next(iter(found.submodule_search_locations))) / "tracks"


@cache
def tracks(where: Path | None = None) -> dict[str, Track]:
    """Return the tracks that were measured on the sky, by name. Those without a file of points are left out."""
    return {track.name: track for track in _read(folder() if where is None else where)}


def _read(where: Path) -> Iterator[Track]:
    for path in sorted(where.glob(f"track.st.*{SUMMARY}")):
        named, file = NAMED.fullmatch(path.name), path.with_name(path.name.replace(SUMMARY, ".ecsv"))
        if named and file.exists():
            lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
            yield Track(named[1], file, next(csv.DictReader(lines)))


def streams() -> dict[str, list[Track]]:
    """Return the tracks of each stream, by its name."""
    found: dict[str, list[Track]] = {}
    for track in tracks().values():
        found.setdefault(track.stream, []).append(track)
    return found


def tracks_of(name: str) -> list[Track]:
    """Return the tracks of a stream, or the track of this name; capitals, blanks and signs between do not matter.

    Raises StreamkitError with the nearest name if there is none.
    """
    known = {**streams(), **{each: [track] for each, track in tracks().items()}}
    if name in known:
        return known[name]
    plain = {_plain(each): each for each in known}
    if _plain(name) in plain:
        return known[plain[_plain(name)]]
    hint = nearest(name, known)
    raise StreamkitError(f"galstreams has no track of a stream {name!r}.{hint} 'streamkit galstreams' lists all.")


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9.]", "", name.lower())
