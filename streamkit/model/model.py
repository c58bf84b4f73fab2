"""The model: parameters to a stream (track, release, integration), its observation, and the likelihood."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from streamkit.components import LiveStripping, Measurement
from streamkit.engine import build_field
from streamkit.errors import ComponentError, OutOfDomain, blamed
from streamkit.model.encounter import flights_past, with_progenitor
from streamkit.model.host import Host
from streamkit.model.integrate import integrate
from streamkit.model.live import follow_live, live_track
from streamkit.model.observation import Measured, Observation
from streamkit.model.progenitor import next_apocentre, progenitor_track
from streamkit.model.records import Records
from streamkit.model.release import other_numbers, random_numbers, release_particles
from streamkit.observe import compare_with_data, measure_host, measure_stream, read_data
from streamkit.runfile import ModelInputs, Source, StreamInputs, as_spec
from streamkit.stream import Array, IntArray, Orbit, Prediction, Stream


class Model:
    """The stream as a function of the free parameters of a run file.

    The random numbers are drawn once from the spec's seed and belong to the particles, so that the stream is a
    deterministic function of the parameters (common random numbers).

    Parameters
    ----------
    spec
        A spec, the path of a run file, or a mapping of the same form.
    threads
        Number of threads for one stream; useful from 10^5 particles on. The stream does not depend on this number.
    fresh
        Whether the random numbers differ between sets of parameters. The seed and the parameters then decide them: the
        noise of two streams is independent, and the same parameters give the same stream.
    """

    def __init__(self, spec: Source, threads: int = 1, fresh: bool = False) -> None:
        self.spec = as_spec(spec)
        self.threads = threads
        self.fresh = fresh
        self._read: dict[tuple[str, str], Measured] = {}

    def __repr__(self) -> str:
        return f"<Model of {self.spec!r}>"

    @property
    def normals(self) -> Array:
        """(draws, n) The random numbers of the only stream's particles; the first n do not depend on their number."""
        return self._draws[self.spec.stream_name()]

    @cached_property
    def _draws(self) -> dict[str, Array]:
        """(draws, n) The random numbers of every stream's particles, by its name."""
        drawn = {}
        for name, stream in self.spec.sections.streams.items():
            stripping = stream.stripping.centre
            with blamed(f"stripping {stripping.kind}"):
                drawn[name] = random_numbers(stripping, self.spec.sections.seed_of(name))
        return drawn

    def _draws_at(self, inputs: StreamInputs) -> Array:
        """(draws, n) The random numbers of a stream's particles at these parameters."""
        numbers = self._draws[inputs.name]
        if not self.fresh:
            return numbers
        place = np.array(list(inputs.values.values())).view(np.uint32).tolist()
        return other_numbers(inputs.stripping, numbers, np.random.default_rng([inputs.seed, *place]))

    def stream(self, parameters: Array | Mapping[str, float] | None = None, name: str | None = None) -> Stream:
        """Return the stream at parameters (d,), or a mapping of some of them; the rest at the prior's centre.

        Its name is needed where there are several. Raises OutOfDomain if there is no such stream; its reason says why.
        Raises ComponentError if a component fails or breaks its contract: with its role, its kind and the parameters.
        """
        return self._made(self.spec.bind(parameters, name))

    def streams(self, parameters: Array | Mapping[str, float] | None = None) -> dict[str, Stream]:
        """Return all streams by name, as `stream` does; a single one without a name is called ``stream``."""
        inputs = self.spec.bind_all(parameters)
        host = Host(inputs.potentials, inputs.bodies)
        return {name: self._made(inputs, host) for name, inputs in inputs.streams.items()}

    def _made(self, inputs: StreamInputs, host: Host | None = None) -> Stream:
        """Return the stream of a bound spec; OutOfDomain begins with its name where there are several."""
        try:
            with self._naming_parameters(inputs.values):
                return simulate(inputs, self._draws_at(inputs), host, self.threads)
        except OutOfDomain as error:
            raise OutOfDomain(
                error.reason if len(self.spec.streams) == 1 else f"{inputs.name}: {error.reason}"
            ) from None

    def observe(self, inputs: StreamInputs, host: Host | None = None) -> tuple[Stream, Prediction | None]:
        """Return the stream of a bound spec, and what its observables say of it (None without one).

        Raises OutOfDomain, ComponentError as `stream`; an observable without a value gives a reason instead.
        """
        stream = self._made(inputs, host)
        with self._naming_parameters(inputs.values):
            data = {one.name: one.data for one in self._of_stream(inputs)}
            return stream, measure_stream(inputs.observables, stream, data)

    def observe_all(self, model_inputs: ModelInputs) -> Observation:
        """Return all streams of a bound spec, in one host, and what their observables say; raises as `observe`."""
        host = Host(model_inputs.potentials, model_inputs.bodies, numbers=model_inputs.numbers)
        streams: dict[str, Stream] = {}
        predictions: dict[str, Prediction] = {}
        for name, inputs in model_inputs.streams.items():
            streams[name], prediction = self.observe(inputs, host)
            if prediction is not None:
                predictions[name] = prediction
        predictions |= {f"data.{name}": one for name, one in self.observe_host(model_inputs, host).items()}
        return Observation(streams, predictions)

    def observe_host(self, model_inputs: ModelInputs, host: Host | None = None) -> dict[str, Prediction]:
        """Return what the host says of the data that are no stream, by their names; raises as `observe`."""
        host = host or Host(model_inputs.potentials, model_inputs.bodies, numbers=model_inputs.numbers)
        with self._naming_parameters(model_inputs.values):
            data = model_inputs.data
            return {name: measure_host(one, host, self._with_data(one, name).data) for name, one in data.items()}

    def measured(self, model_inputs: ModelInputs) -> list[Measured]:
        """Return the measurements of a bound spec with their data: those of the streams, then those of the host."""
        streams = model_inputs.streams.values()
        return [one for inputs in streams for one in self._of_stream(inputs)] + self._of_host(model_inputs)

    def _of_stream(self, inputs: StreamInputs) -> list[Measured]:
        return [self._with_data(observable, name, inputs.name) for name, observable in inputs.observables.items()]

    def _of_host(self, model_inputs: ModelInputs) -> list[Measured]:
        return [self._with_data(measurement, name) for name, measurement in model_inputs.data.items()]

    def _with_data(self, measurement: Measurement, name: str, stream: str = "") -> Measured:
        """Return a measurement with its data, which are read once if no field of the measurement has a prior."""
        measured = self._read.get((stream, name))
        # a measurement with free fields is a new instance in each call
        if measured is None or measured.measurement is not measurement:
            data = read_data(measurement, self.spec.likelihood.noise == "add")
            measured = self._read[stream, name] = Measured(measurement, data, name, stream)
        return measured

    def ln_likelihood(self, model_inputs: ModelInputs, observation: Observation) -> float:
        """Return the ln likelihood of all data, given what was observed of a bound spec.

        The measurements are independent, so their terms add up. Raises ComponentError if a likelihood fails, or is no
        finite number.
        """

        def term(one: Measured) -> float:
            return compare_with_data(one.measurement, observation.prediction_of(one), one.data)

        with self._naming_parameters(model_inputs.values):
            of_streams = (map(term, self._of_stream(inputs)) for inputs in model_inputs.streams.values())
            total = sum(map(sum, of_streams))
            for one in self._of_host(model_inputs):
                total += term(one)  # not by `sum`, which rounds differently from Python 3.12 on
        return total

    @contextmanager
    def _naming_parameters(self, values: Mapping[str, float]) -> Iterator[None]:
        """Add the free parameters to a `ComponentError`; its cause stays."""
        try:
            yield
        except ComponentError as error:
            given = zip(values.items(), self.spec.units, strict=True)
            text = ", ".join(f"{name} = {value!r} {unit}".strip() for (name, value), unit in given)
            raise ComponentError(f"{error}. Parameters: {text or 'none is free'}") from error.__cause__


def simulate(inputs: StreamInputs, draws: Array, shared: Host | None = None, threads: int = 1) -> Stream:
    """Return the stream of fully bound components, with random numbers (draws, n) that belong to the particles.

    The host may be there already, ``shared`` by streams whose progenitors are test particles in it.
    """
    moved = inputs.companion
    host = Host(inputs.potentials, inputs.bodies, moved) if shared is None or moved else shared
    track = progenitor_track(host, inputs)
    if isinstance(inputs.stripping, LiveStripping):
        track = live_track(inputs, inputs.stripping, host, track)
        orbit, done, tail, weight = follow_live(inputs, inputs.stripping, host, track, draws, threads)
        return _stream(inputs, host, orbit, done, tail, np.full(len(tail), track.t[0]), weight)
    start = release_particles(inputs, track, draws)
    field = with_progenitor(host.until(float(track.t[0])), inputs, start.orbit)
    flights = flights_past(inputs, host, track, start.orbit, field)
    if flights:
        field = field.with_passing([(build_field([one.potential]), one.orbit, one.size) for one in flights])
    encounters = [(flight.time, flight.duration) for flight in flights]
    done = integrate(replace(field, threads=threads), inputs.integrator, start, encounters)
    return _stream(inputs, host, start.orbit, done, start.tail, start.at_release.t, np.ones(len(start.tail)))


def _stream(
    inputs: StreamInputs, host: Host, orbit: Orbit, done: Records, tail: IntArray, t_release: Array, weight: Array
) -> Stream:
    """Return the stream of particles that have arrived today; OutOfDomain if a particle's orbit is not finite."""
    if not (np.isfinite(done.q).all() and np.isfinite(done.v).all()):
        raise OutOfDomain("the orbit of a particle is not finite")
    return Stream(
        q=done.q,
        v=done.v,
        t_release=t_release,
        t_strip=np.where(done.bound, 0.0, done.t_strip),
        dq_galactocentric=done.dq_strip,
        dv_galactocentric=done.dv_strip,
        tail=tail,
        winding=done.winding,
        chi=done.chi,
        bound=done.bound,
        weight=weight,
        orbit=orbit,
        ahead=partial(next_apocentre, host, inputs),
        parameters=dict(inputs.values),
        sun=inputs.sun.observer,
        mass=inputs.mass,
    )
