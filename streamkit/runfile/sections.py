"""The validated sections of a run file, and their values at parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from streamkit.components import (
    HostCentre,
    HostData,
    Integrator,
    Observable,
    Potential,
    Sampler,
    StrippingScheme,
    find_host_centre,
)
from streamkit.runfile.body_table import BodyTable, Meeting, Together
from streamkit.runfile.encounter import Encounter
from streamkit.runfile.inputs import ONLY, Body, FlyBy, ModelInputs, StreamInputs, mass_of
from streamkit.runfile.progenitor import MOST_LOOKBACK, BodyPlace, PhaseSpace, Sun
from streamkit.runfile.section import Section
from streamkit.runfile.settings import Engine, Likelihood
from streamkit.stream import Frame


@dataclass(frozen=True)
class StreamSections:
    """The validated sections of one stream, the observables by name; a single one may be called ``observable``."""

    satellite: Section[Potential]
    phase: Section[PhaseSpace]
    stripping: Section[StrippingScheme]
    observables: dict[str, Section[Observable]]

    def measured(self, values: Mapping[str, float]) -> dict[str, Observable]:
        """Return the observables at the values of the free parameters by name."""
        return {name: section.build(values) for name, section in self.observables.items()}

    @property
    def frame(self) -> Frame:
        """The frame of phi1 and phi2: the progenitor's, or else an observable's; None without one."""
        of_observables = (section.centre.sky_frame() for section in self.observables.values())
        frames = (getattr(self.phase.centre, "frame", None), *of_observables)
        return next((frame for frame in frames if frame is not None), None)

    @property
    def lookback(self) -> tuple[str, float]:
        """The path of the look-back time, and the longest that its prior allows, in Gyr."""
        prior = self.phase.priors.get("lookback")
        longest = self.phase.centre.lookback if prior is None else min(prior.support[1], MOST_LOOKBACK)
        return f"{self.phase.path}.lookback", longest


@dataclass(frozen=True)
class Sections:
    """The validated sections of a run file."""

    seed: int
    sun: Section[Sun]
    potentials: dict[str, Section[Potential]]
    # a potential and its place or its encounter, or a table of bodies and what they share
    bodies: dict[
        str, tuple[Section[Any], Section[BodyPlace] | Section[Encounter] | Section[Meeting] | Section[Together]]
    ]
    streams: dict[str, StreamSections]
    data: dict[str, Section[HostData]]
    integrator: Section[Integrator]
    likelihood: Section[Likelihood]
    sampler: Section[Sampler]
    engine: Section[Engine]

    @property
    def all(self) -> list[Section[Any]]:
        """All of them, in the default order."""
        first = self.of_host
        for stream in self.streams.values():
            first += [stream.satellite, stream.phase, stream.stripping]
        observables = [section for stream in self.streams.values() for section in stream.observables.values()]
        return [*first, self.integrator, *observables, *self.data.values(), self.likelihood, self.sampler, self.engine]

    @property
    def encounters(self) -> dict[str, Section[Encounter]]:
        """The encounters, by the names of the bodies."""
        return {name: place for name, (_, place) in self.bodies.items() if place.cls is Encounter}

    @property
    def tables(self) -> dict[str, tuple[Section[BodyTable], Section[Meeting]]]:
        """The tables of bodies, and what their encounters share, by their names."""
        return {name: (table, meeting) for name, (table, meeting) in self.bodies.items() if meeting.cls is Meeting}

    @property
    def met(self) -> dict[str, str]:
        """The streams of the encounters, by the names of the bodies and tables."""
        shared = {name: meeting for name, (_, meeting) in self.tables.items()}
        return {name: self.stream_met(section.centre) for name, section in (self.encounters | shared).items()}

    def stream_met(self, encounter: Encounter | Meeting) -> str:
        """Return the name of the stream of an encounter; empty where it gives none of several."""
        only = next(iter(self.streams)) if len(self.streams) == 1 else ""
        return encounter.stream or only

    def seed_of(self, stream: str) -> int:
        """Return the seed of a stream's own random draws."""
        return stream_seed(self.seed, "" if stream == ONLY else stream)

    def host(self, values: Mapping[str, float]) -> dict[str, Potential]:
        """Return the potentials of the host; those that depend on it see the others; raises as `bound`.

        Where the host's centre moves, they are as seen from it, with the force of this frame.
        """
        force = None if self.host_centre is None else self.host_centre.force
        parts = self._parts(values)
        return parts if force is None else parts | {force.kind: force}

    def _parts(self, values: Mapping[str, float]) -> dict[str, Potential]:
        if not any(section.priors for section in self.potentials.values()):
            return dict(self._centre_of_host)
        return self._joined({name: section.build(values) for name, section in self.potentials.items()})

    @cached_property
    def host_centre(self) -> HostCentre | None:
        """The path of the host's centre, from which its parts are then seen; None if it is the origin."""
        parts = {name: section.centre for name, section in self.potentials.items()}
        found = find_host_centre(beside_each_other(parts).values())
        if found is not None:
            for part in parts.values():
                part.see_from(found.path)
        return found

    @cached_property
    def _centre_of_host(self) -> dict[str, Potential]:
        """The host is made once: prepared values and expansions are kept."""
        return self._joined({name: section.centre for name, section in self.potentials.items()}, centre=True)

    def _joined(self, potentials: dict[str, Potential], centre: bool = False) -> dict[str, Potential]:
        """Return the parts of a host, with the grids of the parts at the prior's centre."""
        made = beside_each_other(potentials)
        for name, section in self.potentials.items():
            if section.cls.asks_for_host():
                made[name].share_grid_of(made[name] if centre else self._centre_of_host[name], section.path)
        return made

    def bound(self, values: Mapping[str, float]) -> ModelInputs:
        """Return all streams at the values of the free parameters by name; OutOfDomain if one breaks its field."""
        potentials = self.host(values)
        sun, integrator = self.sun.build(values).tied(potentials.values()), self.integrator.build(values)
        q0, v0 = (np.zeros(3), np.zeros(3)) if self.host_centre is None else self.host_centre.today
        seen = sun if self.host_centre is None else sun.beside(q0, v0)
        bodies: dict[str, Body] = {}
        flybys: dict[str, dict[str, FlyBy]] = {name: {} for name in self.streams}
        for name, (potential, place) in self.bodies.items():
            at, body = place.build(values), potential.build(values)
            if isinstance(at, Encounter | Meeting):
                met = self.stream_met(at)
                frame = self.streams[met].frame if at.frame is None else at.frame
                several = [(body, at)] if isinstance(at, Encounter) else body.bodies(at)
                for i, (each, encounter) in enumerate(several, start=1):
                    key = name if isinstance(at, Encounter) else f"{name}, row {i}"
                    flybys[met][key] = FlyBy(each, encounter, frame)
                continue
            rows = body.bodies(at) if isinstance(at, Together) else [(body, at)]
            for i, (each, there) in enumerate(rows, start=1):
                q, v = there.today(sun)
                key = f"{name}, row {i}" if isinstance(at, Together) else name
                bodies[key] = Body(each, q - q0, v - v0, there.friction != "none", there.reflex)
        streams = {}
        for name, stream in self.streams.items():
            satellite, phase = stream.satellite.build(values), stream.phase.build(values)
            q, v = phase.today(sun)
            streams[name] = StreamInputs(
                potentials=potentials,
                satellite=satellite,
                mass=mass_of(satellite, "the progenitor"),
                q=q - q0,
                v=v - v0,
                lookback=phase.lookback,
                stripping=stream.stripping.build(values),
                integrator=integrator,
                observables=stream.measured(values),
                seed=self.seed_of(name),
                values=dict(values),
                bodies=bodies,
                flybys=flybys[name],
                friction=phase.friction == "chandrasekhar",
                reflex=bool(phase.reflex),
                sun=seen,
                name=name,
            )
        data = self._data(values)
        numbers = {path: values.get(path, number) for path, number in self._read.items()}
        return ModelInputs(potentials, bodies, seen, streams, data, dict(values), numbers)

    def measurements(self, values: Mapping[str, float]) -> tuple[dict[str, dict[str, Observable]], dict[str, HostData]]:
        """Return the observables of each stream, and the data of the host; raises as `bound`."""
        return {name: stream.measured(values) for name, stream in self.streams.items()}, self._data(values)

    def _data(self, values: Mapping[str, float]) -> dict[str, HostData]:
        return {name: section.build(values) for name, section in self.data.items()}

    @property
    def of_host(self) -> list[Section[Any]]:
        """The sections of the host: the Sun, the potentials and the bodies."""
        return [self.sun, *self.potentials.values(), *(section for pair in self.bodies.values() for section in pair)]

    @cached_property
    def _read(self) -> dict[str, float]:
        """The numbers of the host that the data read, by their paths, at the centres of the priors."""
        wanted = {path for datum in self.data.values() for path in datum.centre.reads()}
        there = {f"{section.path}.{name}": section for section in self.of_host for name in section.cls.model_fields}
        return {path: float(getattr(there[path].centre, path.rpartition(".")[2])) for path in sorted(wanted)}


def beside_each_other(potentials: Mapping[str, Potential]) -> dict[str, Potential]:
    """Return the parts of a host; those that depend on the host see those that do not."""
    others = tuple(p for p in potentials.values() if not p.asks_for_host())
    return {name: p.beside(others) if p.asks_for_host() else p for name, p in potentials.items()}


def stream_seed(seed: int, name: str) -> int:
    """Return the seed of a stream's own draws: its name decides. It is the given one for a stream without a name."""
    return int(np.random.SeedSequence([seed, *name.encode()]).generate_state(1)[0]) if name else seed
