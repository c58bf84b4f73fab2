"""Read the hosts of AGAMA: INI files with `Multipole`, `CylSpline` and `Evolving`, without AGAMA.

The formats are those of AGAMA 1.0 (Vasiliev 2019, MNRAS 482, 1525; its reference, section 2.2.4). A potential in closed
form is no table: it has a section of its own in a run file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from streamkit import GYR, Array, G, StreamkitError
from streamkit_hosts.agama_tables import Sphere, cylinder_rows, multipole_of
from streamkit_hosts.expansion import Expansion
from streamkit_hosts.ini import Section, sections_of

TABLES = ("multipole", "cylspline")
MODIFIERS = ("center", "orientation", "rotation", "scale")


@dataclass(frozen=True)
class Units:
    """The units of the files: length in kpc, velocity in km/s, time in Gyr."""

    length: float
    velocity: float
    time: float

    @classmethod
    def of(cls, length: float | None, mass: float | None, time: float | None) -> Units:
        """Return those of kpc and km/s, or of G = 1 with a mass in Msun."""
        length = length or 1.0
        velocity = float(np.sqrt(G * mass / length)) if mass else 1.0
        return cls(length, velocity, time or length / velocity / GYR)


@dataclass(frozen=True)
class Host:
    """A part of a host: multipoles, or the columns of a table `cylspline`, and how it is turned."""

    kind: str
    times: Array  # (T,) in Gyr, 0 today
    expansion: Expansion | None = None
    columns: dict[str, Array] = field(default_factory=dict)
    fields: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class _Part:
    """The sections of one part of a host at its times (T,), in the file's unit; a single time of 0 at rest."""

    times: tuple[float, ...]
    sections: tuple[Section, ...]
    fields: tuple[tuple[str, Any], ...]

    @property
    def kind(self) -> str:
        return self.sections[0].parameters["type"].lower()


def read(
    path: Path, units: Units, *, l_max: int | None = None, every: int = 1, today: float | None = None
) -> list[Host]:
    """Return the parts of a host of AGAMA: one of all multipoles with the same times and axes, one for each cylinder.

    Parameters
    ----------
    path
        The INI file. Files that it names are relative to it.
    units
        Those of the files.
    l_max, every
        Largest degree of multipoles, and every so many-th time, counted from the last.
    today
        The time of today in the file's unit; 0 without, as AGAMA's users have it.

    Raises StreamkitError with a sentence for files that cannot be used.
    """
    parts = [part for section in sections_of(path) for part in _parts(section, every)]
    now = 0.0 if today is None else today
    hosts, spheres = [], dict[Any, list[_Part]]()
    for part in parts:
        if len(part.times) > 1 and not part.times[0] <= now <= part.times[-1]:
            raise StreamkitError(
                f"{path}: its times are {part.times[0]:g} to {part.times[-1]:g}, and today is {now:g}: give --today"
            )
        if part.kind == "multipole":
            spheres.setdefault((part.times, part.fields), []).append(part)
            continue
        times = (np.array(part.times) - now) * units.time
        rows = [cylinder_rows(section, units.length, units.velocity) for section in part.sections]
        sizes = {len(each["R"]) for each in rows}
        if len(sizes) > 1 or any(not np.allclose(each[k], rows[0][k]) for each in rows for k in ("m", "R", "z")):
            raise StreamkitError(f"{part.sections[0].where}: its grid changes in time; expected the same at all times")
        columns = {name: np.concatenate([each[name] for each in rows]) for name in rows[0]}
        if len(times) > 1:
            columns = {"t": np.repeat(times, sizes.pop()), **columns}
        hosts.append(Host("cylspline", times, None, columns, dict(part.fields)))
    made = []
    for (stamps, fields), same in spheres.items():
        times = (np.array(stamps) - now) * units.time
        scale = units.length, units.velocity
        each = [[multipole_of(part.sections[k], *scale) for part in same] for k in range(len(times))]
        made.append(Host("multipole", times, _summed(times, each, l_max), {}, dict(fields)))
    return made + hosts


def _summed(times: Array, each: list[list[Sphere]], l_max: int | None) -> Expansion:
    """Return the sum of multipoles at each time."""
    there = {pair for spheres in each for sphere in spheres for pair in sphere.harmonics}
    harmonics = sorted(pair for pair in there if l_max is None or pair[0] <= l_max)
    degree = np.array([n for n, _ in harmonics])
    most = int(degree.max())

    def phi(r: Array, below: int = most + 1) -> Array:
        out = np.zeros((len(each), len(harmonics), len(r)))
        index = {pair: k for k, pair in enumerate(harmonics)}
        for total, spheres in zip(out, each, strict=True):
            for sphere in spheres:
                value, _ = sphere.radial(r)
                for pair, row in zip(sphere.harmonics, value, strict=True):
                    if pair in index and pair[0] < below:
                        total[index[pair]] += row
        return out

    cuts: dict[str, Callable[[Array], Array]] = {}
    if most >= 4:
        cuts[f"the degrees above {most - 2}"] = partial(phi, below=most - 1)
    ends = [sphere.ends for spheres in each for sphere in spheres]
    return Expansion(times, harmonics, phi, min(low for low, _ in ends), max(high for _, high in ends), cuts)


def _parts(section: Section, every: int) -> list[_Part]:
    """Return what a section holds: itself, or the sections of the files of an Evolving potential."""
    fields = _fields(section)
    kind = section.parameters["type"].lower()
    if kind in TABLES:
        return [_Part((0.0,), (section,), fields)]
    if kind != "evolving":
        raise StreamkitError(
            f"{section.where}: has the type {section.parameters['type']}, which is no table; expected Multipole, "
            'CylSpline or Evolving. Give it a section of its own in the run file, as kind = "agama" or a built-in one'
        )
    stamps: list[tuple[float, list[Section]]] = []
    for line in section.lines:
        words = line.split()
        if len(words) < 2 or words[0][0] not in "0123456789+-.":
            continue
        try:
            stamps.append((float(words[0]), [Section(section.file, words[1])]))
        except ValueError:
            raise StreamkitError(f"{section.where}: found {line[:60]!r}; expected a time and a file") from None
    stamps.sort(key=lambda stamp: stamp[0])
    times = [t for t, _ in stamps][::-1][::every][::-1]
    if len(times) < 2 or not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise StreamkitError(f"{section.where}: expected two times or more, each once, with their files")
    chosen = [found[0] for t, found in stamps][::-1][::every][::-1]
    inner = [sections_of(section.file.parent / named.name) for named in chosen]
    shape = [part.parameters["type"].lower() for part in inner[0]]
    for found in inner:
        if [part.parameters["type"].lower() for part in found] != shape or not set(shape) <= set(TABLES):
            raise StreamkitError(
                f"{found[0].where}: expected the same tables (Multipole, CylSpline) at all times of {section.where}"
            )
        if moved := [(part, name) for part in found for name in MODIFIERS if name in part.parameters]:
            raise StreamkitError(f"{moved[0][0].where}: has {moved[0][1]}; expected it in {section.where}")
    return [_Part(tuple(times), tuple(found[k] for found in inner), fields) for k in range(len(shape))]


def _fields(section: Section) -> tuple[tuple[str, Any], ...]:
    """Return the fields of the run file that turn a part, from AGAMA's modifiers."""
    fields: list[tuple[str, Any]] = []
    if "scale" in section.parameters:
        raise StreamkitError(f"{section.where}: has scale; expected a table without it. Its mass is `factor`")
    if "center" in section.parameters:
        centre = _numbers(section, "center", 3)
        if any(centre):
            raise StreamkitError(f"{section.where}: its center is not the origin; expected a host that is there")
    if "rotation" in section.parameters:
        (turn,) = _numbers(section, "rotation", 1)
        fields.append(("angle", round(float(np.degrees(turn)), 9)))
    if "orientation" in section.parameters:
        angles = _numbers(section, "orientation", 3)
        fields.append(("orientation", tuple(round(float(np.degrees(angle)), 9) for angle in angles)))
    return tuple(fields)


def _numbers(section: Section, name: str, count: int) -> list[float]:
    text = section.parameters[name]
    try:
        numbers = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise StreamkitError(
            f"{section.where}: {name} is {text[:60]!r}; expected {count} number(s): a change in time is not read"
        )
    return numbers
