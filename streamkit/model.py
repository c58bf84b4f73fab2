"""From parameters to a stream: the progenitor's track, the release, the march to today."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np

from streamkit.components import Stripping
from streamkit.engine import Field, build_field
from streamkit.errors import OutOfDomain
from streamkit.march import march
from streamkit.phase import LEADING, TRAILING, Array, Orbit, Stream
from streamkit.spec import Setup, Spec
from streamkit.units import GYR, G

NODE = 0.002 * GYR
"""Spacing of the progenitor's track: its interpolation error stays far below that of any particle."""

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
        setup = self.spec.bind(self.spec.centre())
        return standard_normals(setup.stripping, setup.seed)

    def stream(self, parameters: Array | Mapping[str, float] | None = None) -> Stream:
        """Return the stream at parameters (d,), or a mapping of some of them; the rest at the prior's centre.

        Raises
        ------
        OutOfDomain
            If there is no such stream; its reason says why.
        ComponentError
            If a component fails.
        """
        return simulate(self.spec.bind(self.spec.centre() if parameters is None else parameters), self.normals)


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
    orbit = progenitor_track(host, setup)
    times = setup.stripping.times(orbit)
    tail = np.where(np.arange(len(times)) % 2 == 0, LEADING, TRAILING)
    release = setup.stripping.release(orbit.at(times), tail, setup.mass, normals)
    field = host
    if setup.stripping.progenitor_gravity:
        field = host.with_followers(build_field([setup.satellite]), orbit)
    done = march(field, setup.integrator, orbit, times, release.q, release.v)
    if not (np.isfinite(done.q).all() and np.isfinite(done.v).all()):
        raise OutOfDomain("the orbit of a particle is not finite")
    return Stream(
        q=done.q,
        v=done.v,
        t_release=times,
        t_strip=np.where(done.bound, 0.0, done.t_strip),
        dq_strip=done.dq_strip,
        dv_strip=done.dv_strip,
        tail=tail,
        winding=done.winding,
        chi=done.chi,
        bound=done.bound,
        orbit=orbit,
        future=next_apocentre(host, setup),
        parameters=dict(setup.values),
    )


def progenitor_track(host: Field, setup: Setup) -> Orbit:
    """Integrate the progenitor back over the look-back time in the host alone, with its tidal radius.

    r_t = [G M / (Omega^2 - d^2 Phi / dr^2)]^(1/3), Omega = |L| / r^2 instantaneous (Gibbons+ 2014, eq. 1).
    """
    orbit = host.orbit(setup.q, setup.v, 0.0, -setup.lookback * GYR, NODE)
    if not (np.isfinite(orbit.q).all() and np.isfinite(orbit.v).all()):
        raise OutOfDomain("the orbit of the progenitor is not finite")
    r_tidal = tidal_radius(host, orbit, setup.mass)
    if np.isnan(r_tidal).any():
        raise OutOfDomain("the progenitor has no tidal radius somewhere on its track (Omega^2 <= d2Phi/dr2)")
    return Orbit(orbit.t, orbit.q, orbit.v, orbit.a, r_tidal)


def tidal_radius(host: Field, orbit: Orbit, mass: float) -> Array:
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
