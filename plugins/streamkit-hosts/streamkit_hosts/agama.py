"""Read the hosts of AGAMA: INI files with `Multipole`, `CylSpline`, `Evolving` and what moves them, without AGAMA.

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
from streamkit_hosts.agama_motion import Curve, curve_of
from streamkit_hosts.agama_tables import Sphere, cylinder_rows, multipole_of
from streamkit_hosts.expansion import Expansion
from streamkit_hosts.ini import Section, sections_of

TABLES = ("multipole", "cylspline")
UNIFORM = "uniformacceleration"
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
    """A part of a host: multipoles, the columns of a table `cylspline`, or fields alone; how it is turned and moved."""

    kind: str
    times: Array  # (T,) in Gyr, 0 today
    expansion: Expansion | None = None
    columns: dict[str, Array] = field(default_factory=dict)
    fields: dict[str, Any] = field(default_factory=dict)
    centre: dict[str, list[float]] = field(default_factory=dict)  # the columns of a table, in kpc, km/s and Gyr


@dataclass(frozen=True)
class _Frame:
    """How a part is turned and moved, in the file's unit of time and radians."""

    centre: Curve | None = None
    rotation: Curve | None = None
    orientation: tuple[float, ...] | None = None
    where: str = field(default="", compare=False)

    def fields(self, units: Units, today: float) -> dict[str, Any]:
        """Return the fields of a section that turn it."""
        angles = [round(float(np.degrees(angle)), 9) for angle in self.orientation or (0.0, 0.0, 0.0)]
        if self.rotation is not None and self.rotation.in_time:
            turn = self.rotation.changed(units.time, float(np.degrees(1.0)), today).knots(0, f"{self.where}: rotation")
            turn["values"] = [round(value + angles[2], 9) for value in turn["values"]]
            return {"orientation": [*angles[:2], turn]}
        fields: dict[str, Any] = {}
        if self.rotation is not None:
            fields["angle"] = round(float(np.degrees(self.rotation.rows[0][1])), 9)
        return fields | ({} if self.orientation is None else {"orientation": angles})

    def centre_rows(self, units: Units, today: float) -> dict[str, list[float]]:
        """Return the columns of its centre; none at the origin."""
        return {} if self.centre is None else self.centre.changed(units.time, units.length, today).centre()


@dataclass(frozen=True)
class _Part:
    """The sections of one part of a host at its times (T,), in the file's unit; a single time of 0 at rest."""

    times: tuple[float, ...]
    sections: tuple[Section, ...]
    frame: _Frame

    @property
    def kind(self) -> str:
        return self.sections[0].parameters["type"].lower()


def read(
    path: Path, units: Units, *, l_max: int | None = None, every: int = 1, today: float | None = None
) -> list[Host]:
    """Return the parts of a host of AGAMA: one of all multipoles with the same times and frame, one for each cylinder.

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
        frame = part.frame.fields(units, now), part.frame.centre_rows(units, now)
        if part.kind == "multipole":
            spheres.setdefault((part.times, part.frame), []).append(part)
            continue
        if part.kind == UNIFORM:
            hosts.append(Host("uniform_acceleration", np.zeros(1), fields=_acceleration(part.sections[0], units, now)))
            continue
        times = (np.array(part.times) - now) * units.time
        rows = [cylinder_rows(section, units.length, units.velocity) for section in part.sections]
        sizes = {len(each["R"]) for each in rows}
        if len(sizes) > 1 or any(not np.allclose(each[k], rows[0][k]) for each in rows for k in ("m", "R", "z")):
            raise StreamkitError(f"{part.sections[0].where}: its grid changes in time; expected the same at all times")
        columns = {name: np.concatenate([each[name] for each in rows]) for name in rows[0]}
        if len(times) > 1:
            columns = {"t": np.repeat(times, sizes.pop()), **columns}
        hosts.append(Host("cylspline", times, None, columns, *frame))
    made = []
    for (stamps, frame_of_all), same in spheres.items():
        times = (np.array(stamps) - now) * units.time
        scale = units.length, units.velocity
        each = [[multipole_of(part.sections[k], *scale) for part in same] for k in range(len(times))]
        frame = frame_of_all.fields(units, now), frame_of_all.centre_rows(units, now)
        made.append(Host("multipole", times, _summed(times, each, l_max), {}, *frame))
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
    frame, kind = _frame(section), section.parameters["type"].lower()
    if kind in TABLES:
        return [_Part((0.0,), (section,), frame)]
    if kind == UNIFORM:
        if frame != _Frame():
            raise StreamkitError(f"{section.where}: is turned or moved; expected the acceleration alone")
        return [_Part((0.0,), (section,), frame)]
    if kind != "evolving":
        raise StreamkitError(
            f"{section.where}: has the type {section.parameters['type']}, which is no table; expected Multipole, "
            "CylSpline, Evolving or UniformAcceleration. Give it a section of its own in the run file, as kind = "
            '"agama" or a built-in one'
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
    return [_Part(tuple(times), tuple(found[k] for found in inner), frame) for k in range(len(shape))]


def _frame(section: Section) -> _Frame:
    """Return how a part is turned and moved, by AGAMA's modifiers: about its z axis, to its axes, to its centre."""
    given = section.parameters
    if "scale" in given:
        raise StreamkitError(f"{section.where}: has scale; expected a table without it. Its mass is `factor`")
    centre = curve_of(section, "center", 3) if "center" in given else None
    if centre is not None and not centre.in_time and not any(centre.rows[0][1:]):
        centre = None
    rotation = curve_of(section, "rotation", 1) if "rotation" in given else None
    orientation = curve_of(section, "orientation", 3) if "orientation" in given else None
    if orientation is not None and orientation.in_time:
        raise StreamkitError(f"{section.where}: orientation changes in time; expected three numbers, as AGAMA does")
    angles = None if orientation is None else orientation.rows[0][1:4]
    return _Frame(centre, rotation, angles, section.where)


def _acceleration(section: Section, units: Units, today: float) -> dict[str, Any]:
    """Return the fields of a uniform acceleration, whose file has the columns t, ax, ay and az."""
    if "file" not in section.parameters:
        raise StreamkitError(f"{section.where}: has no file; expected one with rows of a time and an acceleration")
    curve = curve_of(section, "file", 3).changed(units.time, units.velocity / (units.time * GYR), today)
    names = ("ax", "ay", "az")
    if not curve.in_time:
        return dict(zip(names, curve.rows[0][1:4], strict=True))
    return {name: curve.knots(k, f"{section.where}: file") for k, name in enumerate(names)}
