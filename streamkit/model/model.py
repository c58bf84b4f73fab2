"""The model: parameters to a stream, in one way through. Track, release, integration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property, partial

import numpy as np

from streamkit.components import Observable
from streamkit.engine import build_field
from streamkit.errors import ComponentError, OutOfDomain, blamed
from streamkit.model.host import Host
from streamkit.model.integrate import integrate
from streamkit.model.progenitor import next_apocentre, progenitor_track
from streamkit.model.release import release_particles, standard_normals
from streamkit.observe import Data, measure_stream, read_data
from streamkit.spec import Setup, Source, as_spec
from streamkit.stream import Array, Prediction, Stream


class Model:
    """The stream as a function of the free parameters of a run file.

    The random numbers are drawn once from the spec's seed and belong to the particles, so that the stream is a
    deterministic function of the parameters (common random numbers).
    """

    def __init__(self, spec: Source) -> None:
        self.spec = as_spec(spec)
        self._asked: tuple[Observable, Data] | None = None

    def data(self, observable: Observable) -> Data:
        """Return the data of an observable of this run file; asked for once where no field of it has a prior."""
        if self._asked is None or self._asked[0] is not observable:  # one with free fields is new at every parameter
            self._asked = observable, read_data(observable, self.spec.likelihood.noise == "add")
        return self._asked[1]

    @cached_property
    def normals(self) -> Array:
        """(draws, n) The standard normals of all particles; the first n do not depend on their number."""
        setup = self.spec.bind()
        with blamed(f"stripping {setup.stripping.kind}"):
            return standard_normals(setup.stripping, setup.seed)

    def stream(self, parameters: Array | Mapping[str, float] | None = None) -> Stream:
        """Return the stream at parameters (d,), or a mapping of some of them; the rest at the prior's centre.

        Raises OutOfDomain if there is no such stream; its reason says why. Raises ComponentError if a component fails
        or breaks its contract: with its role, its kind and the parameters.
        """
        setup = self.spec.bind(parameters)
        with self.naming_parameters(setup):
            return simulate(setup, self.normals)

    def observe(self, setup: Setup) -> tuple[Stream, Prediction | None]:
        """Return the stream of a bound spec, and what its observable says of it (None without one).

        Raises OutOfDomain, ComponentError as `stream`; an observable without a value gives a reason instead.
        """
        with self.naming_parameters(setup):
            stream = simulate(setup, self.normals)
            observable = setup.observable
            return stream, None if observable is None else measure_stream(observable, stream, self.data(observable))

    @contextmanager
    def naming_parameters(self, setup: Setup) -> Iterator[None]:
        """Add the free parameters to a `ComponentError`; its cause stays."""
        try:
            yield
        except ComponentError as error:
            given = zip(setup.values.items(), self.spec.units, strict=True)
            text = ", ".join(f"{name} = {value!r} {unit}".strip() for (name, value), unit in given)
            raise ComponentError(f"{error}. Parameters: {text or 'none is free'}") from error.__cause__


def simulate(setup: Setup, normals: Array) -> Stream:
    """Return the stream of fully bound components, with normals (draws, n) that belong to the particles."""
    host = Host(setup.potentials, setup.bodies, setup.companion)
    track = progenitor_track(host, setup)
    start = release_particles(setup, track, normals)
    field = host.until(float(track.t[0]))
    if setup.stripping.progenitor_gravity:
        field = field.with_moving(build_field([setup.satellite]), start.orbit)
    done = integrate(field, setup.integrator, start)
    if not (np.isfinite(done.q).all() and np.isfinite(done.v).all()):
        raise OutOfDomain("the orbit of a particle is not finite")
    return Stream(
        q=done.q,
        v=done.v,
        t_release=start.at_release.t,
        t_strip=np.where(done.bound, 0.0, done.t_strip),
        dq_galactocentric=done.dq_strip,
        dv_galactocentric=done.dv_strip,
        tail=start.tail,
        winding=done.winding,
        chi=done.chi,
        bound=done.bound,
        weight=np.ones(len(start.tail)),
        orbit=start.orbit,
        ahead=partial(next_apocentre, host, setup),
        parameters=dict(setup.values),
        sun=setup.sun.observer,
    )
