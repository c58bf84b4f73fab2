"""Data that do not exist yet: the surveys of a file as observables beside those of the run file.

A survey measures stars, or means, at even longitudes along a stream, each with the same errors. Its values are
placeholders: what data tell depends on their errors alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from streamkit import (
    Angle,
    Array,
    Frame,
    Length,
    Model,
    Number,
    Observable,
    OutOfDomain,
    ProperMotion,
    Spec,
    SpecError,
    Speed,
)
from streamkit.errors import brief, nearest
from streamkit.runfile import DATA, ONLY, StreamInputs, read_toml
from streamkit_forecast.predict import Added

PLACEHOLDER = {"distance": 10.0}  # values of the columns in which 0 is none
COPIED = ("frame", "kernel", "arm", "velocity_frame", "gsr_sun", "unwrapped")  # settings of the stream's own track
MOST = 100_000  # stars of one survey


class Errors(BaseModel):
    """Standard errors of one star, or mean, by column."""

    model_config = ConfigDict(extra="forbid")
    phi2: Angle | None = Field(default=None, gt=0)
    distance: Length | None = Field(default=None, gt=0)
    distance_modulus: Number | None = Field(default=None, gt=0)
    pm_phi1_cosphi2: ProperMotion | None = Field(default=None, gt=0)
    pm_phi2: ProperMotion | None = Field(default=None, gt=0)
    radial_velocity: Speed | None = Field(default=None, gt=0)

    def by_column(self) -> dict[str, float]:
        """Return the errors of the columns that are measured."""
        return {name: error for name, error in self if error is not None}


class Survey(BaseModel):
    """One section of the file of surveys."""

    model_config = ConfigDict(extra="forbid")
    stream: str | None = None  # its name; all streams if left out
    phi1: tuple[Angle, Angle]  # from, to
    stars: int | None = Field(default=None, ge=1, le=MOST)
    means: int | None = Field(default=None, ge=1, le=MOST)
    errors: Errors
    frame: Frame = None
    kernel: Angle | None = Field(default=None, gt=0, le=45)

    def longitudes(self) -> Array:
        """Return phi1 of the stars or means: the middles of equal parts of the range."""
        n = self.stars or self.means or 0
        low, high = self.phi1
        return np.asarray(low + (np.arange(n) + 0.5) / n * (high - low))


def read_surveys(path: Path) -> dict[str, Survey]:
    """Read the surveys of a file by name; SpecError for what is not one, with the section and the field."""
    document = read_toml(path)
    if not document:
        raise SpecError(f"{path}: there is no survey; expected sections such as [desi] with phi1, stars and errors")
    return {name: _survey(f"{path}: {name}", section) for name, section in document.items()}


def _survey(where: str, section: Any) -> Survey:
    if not isinstance(section, Mapping):
        raise SpecError(f"{where}: found {section!r}, expected a section [NAME] with phi1, stars and errors")
    try:
        survey = Survey.model_validate(section)
    except ValidationError as error:
        faults = error.errors(include_url=False)  # a misspelled name first: the right one is missing then
        first = next((fault for fault in faults if fault["type"] == "extra_forbidden"), faults[0])
        if first["type"] != "extra_forbidden":
            raise SpecError(f"{where}.{brief(error)}") from None
        *above, name = map(str, first["loc"])
        fields = Errors.model_fields if above else Survey.model_fields
        known = f"{nearest(name, fields)} Allowed: {', '.join(fields)}."
        raise SpecError(f"{where}: there is no field {'.'.join([*above, name])!r}.{known}") from None
    if (survey.stars is None) == (survey.means is None):
        raise SpecError(f"{where}: expected either stars, a number of single stars, or means, a number of binned means")
    if not survey.errors.by_column():
        raise SpecError(f"{where}.errors: nothing is measured; expected one of {', '.join(Errors.model_fields)}")
    low, high = survey.phi1
    if not -360 <= low < high <= 360:
        raise SpecError(f"{where}.phi1: found {low:g} to {high:g} deg; expected two longitudes, the smaller one first")
    return survey


def added_by(spec: Spec, theta: Array, surveys: Mapping[str, Survey], where: str) -> Added:
    """Return the surveys as observables of their streams; SpecError for a name of no stream, or without a frame."""
    bound, added = spec.bind_all(theta), Added()
    for name, survey in surveys.items():
        if survey.stream is not None and survey.stream not in spec.streams:
            known = f"{nearest(survey.stream, spec.streams)} Streams: {', '.join(spec.streams) or 'none'}."
            raise SpecError(f"{where}: {name}.stream: no stream is called {survey.stream!r}.{known}")
        for stream in spec.streams if survey.stream is None else (survey.stream,):
            own = {key: value for key in ("frame", "kernel") if (value := getattr(survey, key)) is not None}
            added.setdefault(stream, {})[name] = track(
                spec, bound.streams[stream], survey.longitudes(), survey.errors.by_column(),
                stars=survey.errors.by_column() if survey.stars else (), own=own, where=f"{where}: {name}",
            )  # fmt: skip
    return added


def beyond(spec: Spec, theta: Array, added: Added, where: str) -> list[str]:
    """Say which surveys are in part where their stream has no star; SpecError for one that is all there.

    A stream that cannot be made, or without debris, is said where its slopes are taken.
    """
    model, bound, found = Model(spec), spec.bind_all(theta), []
    for stream, surveys in added.items():
        try:
            made, _ = model.observe(bound.streams[stream])
        except OutOfDomain:
            continue
        if made.bound.all():
            continue
        for name, survey in surveys.items():
            like: Any = survey  # it is a track
            phi1, lon = np.asarray(like.table["phi1"]), np.sort(made.seen(like.frame).lon[~made.bound])
            around, x = np.concatenate([lon - 360, lon, lon + 360]), (phi1 + 180) % 360 - 180
            after = np.searchsorted(around, x)
            lost = int(np.sum(np.minimum(x - around[after - 1], around[after] - x) > like.kernel))
            text = f"{name}: {lost} of {len(phi1)} longitudes have no star of {called(stream)} within "
            text += f"{like.kernel:g} deg: it reaches from {lon[0]:.0f} to {lon[-1]:.0f} deg"
            if lost == len(phi1):
                raise SpecError(f"{where}: {text}")
            found += [f"{text}, and its lines are extrapolated there"] if lost else []
    return found


def called(source: str) -> str:
    """Return what tables and messages call a stream, or the host."""
    return {DATA: "data on the host", ONLY: "the stream"}.get(source, source)


def own_track(inputs: StreamInputs) -> Observable | None:
    """Return the first track that a stream is compared with; None without one."""
    return next((each for each in inputs.observables.values() if each.kind == "track"), None)


def track(
    spec: Spec, inputs: StreamInputs, phi1: Array, errors: Mapping[str, float], *, stars: Iterable[str],
    own: Mapping[str, Any] | None = None, where: str = "",
) -> Observable:  # fmt: skip
    """Return a track with these errors at longitudes phi1 (n,), otherwise as the track of the stream.

    The columns ``stars`` are of single stars, the others means. All have the dispersions of the stream's own track.
    """
    cls: Any = spec.registry.find("observable", "track", where)
    like: Any = own_track(inputs)
    fields = {} if like is None else {name: getattr(like, name) for name in COPIED}
    fields |= {} if like is None else {f"{name}_dispersion": getattr(like, f"{name}_dispersion") for name in errors}
    fields |= own or {}
    if "frame" not in fields:
        raise SpecError(f"{where}: the stream has no track, and so no frame; expected frame")
    table: dict[str, Any] = {"phi1": phi1.tolist()}
    for name, error in errors.items():
        table |= {name: [PLACEHOLDER.get(name, 0.0)] * len(phi1), f"{name}_error": [error] * len(phi1)}
    made: Observable = cls(**fields, table=table, stars=tuple(stars))
    return made
