"""From parameters to a stream and what is observed of it: the progenitor's track, the release, the march to today."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property

import numpy as np

from streamkit.components import Observable, Stripping
from streamkit.engine import Field, build_field
from streamkit.errors import ComponentError, OutOfDomain, blamed
from streamkit.march import march
from streamkit.phase import Array, Orbit, Prediction, Stream
from streamkit.release import losing_mass, release_times, released
from streamkit.spec import Setup, Spec
from streamkit.units import GYR, G

NODE = 0.002 * GYR
"""Spacing of the progenitor's track: its interpolation error stays far below that of any particle."""

SHARPEST = 1.5
"""Most that the progenitor may turn between two nodes of its track, radians: its revolutions are counted by them."""

FUTURE = 6.0 * GYR
"""How far ahead the progenitor's next apocentre is looked for."""


class Model:
    """The stream as a function of the free parameters of a run file.

    The random numbers are drawn once from the spec's seed and belong to the particles, so that the stream is a
    deterministic function of the parameters (common random numbers).
    """

    def __init__(self, spec: Spec) -> None:
        self.spec = spec

    @cached_property
    def normals(self) -> Array:
        """(draws, n) The standard normals of all particles; the first n do not depend on their number."""
        setup = self.spec.bind()
        with blamed(f"stripping {setup.stripping.kind}"):
            return standard_normals(setup.stripping, setup.seed)

    def stream(self, parameters: Array | Mapping[str, float] | None = None) -> Stream:
        """Return the stream at parameters (d,), or a mapping of some of them; the rest at the prior's centre.

        Raises
        ------
        OutOfDomain
            If there is no such stream; its reason says why.
        ComponentError
            If a component fails or breaks its contract: with its role, its kind and the parameters.
        """
        setup = self.spec.bind(parameters)
        with self.naming_parameters(setup):
            return simulate(setup, self.normals)

    def observe(self, setup: Setup) -> tuple[Stream, Prediction | None]:
        """Return the stream of a bound spec, and what its observable says of it (None without one).

        Raises
        ------
        OutOfDomain, ComponentError
            As `stream`; an observable without a value gives a reason instead.
        """
        with self.naming_parameters(setup):
            stream = simulate(setup, self.normals)
            return stream, None if setup.observable is None else measure(setup.observable, stream)

    @contextmanager
    def naming_parameters(self, setup: Setup) -> Iterator[None]:
        """Add the free parameters to a `ComponentError`; its cause stays."""
        try:
            yield
        except ComponentError as error:
            given = zip(setup.values.items(), self.spec.units, strict=True)
            text = ", ".join(f"{name} = {value!r} {unit}".strip() for (name, value), unit in given)
            raise ComponentError(f"{error}. Parameters: {text or 'none is free'}") from error.__cause__


def standard_normals(stripping: Stripping, seed: int) -> Array:
    """(draws, n) Standard normals from the seed; column i belongs to particle i whatever n is.

    The two tails, which alternate, have a Sobol sequence each: one sequence for both would give each tail one half
    of the first coordinate. Release times grow with the index, which completes the sequence to a Hammersley set.
    """
    n, draws = stripping.particles, stripping.draws
    if not stripping.quasi_random:
        return np.ascontiguousarray(np.random.default_rng(seed).standard_normal((n, draws)).T)
    from scipy.special import ndtri
    from scipy.stats import qmc  # slow to import

    out = np.empty((draws, n))
    for tail, stream in enumerate(np.random.default_rng(seed).spawn(2)):
        count = len(range(tail, n, 2))
        points = qmc.Sobol(draws, scramble=True, rng=stream).random_base2(max(count - 1, 1).bit_length())
        out[:, tail::2] = ndtri(points[:count].T)
    return out


def simulate(setup: Setup, normals: Array) -> Stream:
    """Return the stream of fully bound components, with normals (draws, n) that belong to the particles."""
    host = build_field(list(setup.potentials.values()))
    orbit, times = progenitor_track(host, setup)
    start, tail, release = released(setup, orbit, times, normals)
    field = host
    if setup.stripping.progenitor_gravity:
        field = host.with_followers(build_field([setup.satellite]), orbit)
    done = march(field, setup.integrator, orbit, start, release.q, release.v)
    if not (np.isfinite(done.q).all() and np.isfinite(done.v).all()):
        raise OutOfDomain("the orbit of a particle is not finite")
    return Stream(
        q=done.q,
        v=done.v,
        t_release=start.t,
        t_strip=np.where(done.bound, 0.0, done.t_strip),
        dq_galactocentric=done.dq_strip,
        dv_galactocentric=done.dv_strip,
        tail=tail,
        winding=done.winding,
        chi=done.chi,
        bound=done.bound,
        weight=np.ones(len(start.t)),
        orbit=orbit,
        future=next_apocentre(host, setup),
        parameters=dict(setup.values),
    )


def measure(observable: Observable, stream: Stream) -> Prediction:
    """Return what the observable says of the stream.

    Raises
    ------
    ComponentError
        If it fails, or predicts other shapes than its data have, or no number without a reason.
    """
    name = f"observable {observable.kind}"
    with blamed(name):
        prediction, (data, _) = observable.predict(stream), observable.data()
        mean, variance = np.shape(prediction.mean), np.shape(prediction.variance)
        if prediction.why_not:
            return prediction
        if not len(prediction.names) == len(data) or not mean == variance == np.shape(data):
            raise ComponentError(
                f"{name}: predicted {mean} values with {variance} variances and {len(prediction.names)} names "
                f"for {np.shape(data)} data"
            )
        if not (np.isfinite(prediction.mean).all() and (prediction.variance >= 0).all()):
            raise ComponentError(
                f"{name}: predicted {np.asarray(prediction.mean).tolist()} with variances "
                f"{np.asarray(prediction.variance).tolist()}, not all of them usable numbers, and gave no reason"
            )
    return prediction


def progenitor_track(host: Field, setup: Setup) -> tuple[Orbit, Array]:
    """Return the progenitor over the look-back time in the host alone, and when it releases its particles (n,).

    With the mass that it has left, and the tidal radius of that mass:
    r_t = [G M / (Omega^2 - d^2 Phi / dr^2)]^(1/3), Omega = |L| / r^2 instantaneous (Gibbons+ 2014, eq. 1).

    Raises
    ------
    OutOfDomain
        If there is no such orbit, no such radius, or no orbital plane.
    ComponentError
        As `release_times`.
    """
    with np.errstate(all="ignore"):  # what is not finite is found below, and has a reason of its own
        orbit = host.orbit(setup.q, setup.v, 0.0, -setup.lookback * GYR, NODE)
        if not (np.isfinite(orbit.q).all() and np.isfinite(orbit.v).all()):
            raise OutOfDomain(_not_finite(setup))
        if not orbit.omega.max() > 0:
            raise OutOfDomain("the progenitor moves on a line through the Galactic centre: there is no orbital plane")
        if not orbit.omega.max() * NODE <= SHARPEST:
            raise OutOfDomain("the progenitor passes too near the Galactic centre to be followed")
        r_tidal = tidal_radius(host, orbit, setup.mass)
    if np.isnan(r_tidal).any():
        raise OutOfDomain("the progenitor has no tidal radius somewhere on its track (Omega^2 <= d2Phi/dr2)")
    track = Orbit(orbit.t, orbit.q, orbit.v, orbit.a, r_tidal)
    times = release_times(setup.stripping, track)
    return losing_mass(track, setup.stripping.mass_loss, times), times


def _not_finite(setup: Setup) -> str:
    """Return the reason for an orbit that is not finite: by name the potential without a force, if one has none."""
    for potential in setup.potentials.values():
        if not np.isfinite(build_field([potential]).acceleration(0.0, setup.q[:, None])).all():
            return f"the acceleration of the potential {potential.kind} is not finite where the progenitor is today"
    return "the orbit of the progenitor is not finite"


def tidal_radius(host: Field, orbit: Orbit, mass: float | Array) -> Array:
    """(n,) Tidal radius along an orbit; NaN where Omega^2 - d^2 Phi / dr^2 is not positive and there is none."""
    bracket = orbit.omega**2 - host.radial_second_derivative(orbit.t, orbit.q)
    return np.cbrt(G * mass / np.where(bracket > 0, bracket, np.nan))


def next_apocentre(host: Field, setup: Setup) -> Orbit | None:
    """Integrate the progenitor ahead until just past its next apocentre; None if it has none within 6 Gyr."""
    reach = 0.25 * GYR
    while reach <= FUTURE:
        orbit = host.orbit(setup.q, setup.v, 0.0, reach, NODE)
        if len(orbit.apocentres()):
            return orbit
        reach *= 2
    return None
