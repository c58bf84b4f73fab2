"""The release: times, positions and velocities of the particles, and the mass loss of the progenitor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr, ndtri

from streamkit.components import LiveStripping, Stripping, StrippingScheme
from streamkit.errors import ComponentError, blamed
from streamkit.model.satellite import Satellite
from streamkit.runfile import StreamInputs
from streamkit.stream import LEADING, TRAILING, Array, IntArray, Orbit, read_only

# Smallest probability of a shifted draw: its normal is then finite.
EDGE = 1e-12


@dataclass(frozen=True)
class Start:
    """The initial state of n particles."""

    orbit: Orbit  # the progenitor's whole track, with its remaining mass and the tidal radius of that mass
    at_release: Orbit  # the progenitor at the release times (n,)
    tail: IntArray  # (n,) Lagrange point of each particle
    # (3, n) their positions and velocities.
    q: Array
    v: Array


def release_particles(inputs: StreamInputs, track: Orbit, normals: Array, orbit: Orbit | None = None) -> Start:
    """Return the particles at their release from the progenitor's track, with normals (draws, n).

    ``orbit`` is the `stripped` track, if it is known. ComponentError if the scheme fails, or returns wrong numbers.
    """
    scheme, n = inputs.stripping, inputs.stripping.particles
    name = f"stripping {scheme.kind}"
    if not isinstance(scheme, Stripping):
        raise TypeError(f"{name} releases no particles")
    times = release_times(scheme, track)
    orbit = stripped(inputs, track) if orbit is None else orbit
    with blamed(name):
        tail = read_only(np.where(np.arange(n) % 2 == 0, LEADING, TRAILING))
        at_release = orbit.at(times)
        release = scheme.release(at_release, tail, inputs.mass * at_release.mass_left, read_only(normals))
        for what, values in (("q", release.q), ("v", release.v)):
            if np.shape(values) != (3, n):
                shape = np.shape(values)
                raise ComponentError(f"{name}: released `{what}` has the shape {shape}, expected (3, {n})")
            if not np.isfinite(values).all():
                raise ComponentError(f"{name}: released `{what}` holds numbers that are not finite")
    return Start(orbit, at_release, tail, release.q, release.v)


def stripped(inputs: StreamInputs, track: Orbit) -> Orbit:
    """Return the progenitor's track with its remaining mass, as far as that mass is known before the stream.

    The mass of a live progenitor is a result of the stream: this track has the whole mass.
    """
    scheme = inputs.stripping
    if not isinstance(scheme, Stripping):
        return track
    satellite = Satellite(inputs.satellite, inputs.mass)
    return losing_mass(track, satellite, scheme.mass_loss, release_times(scheme, track))


def release_times(scheme: Stripping, orbit: Orbit) -> Array:
    """(n,) The release times of the scheme.

    Raises ComponentError if there is not one for each particle, in increasing order and within the orbit.
    """
    name, n = f"stripping {scheme.kind}", scheme.particles
    with blamed(name):
        times = np.asarray(scheme.times(orbit), dtype=float)
    if times.shape != (n,):
        raise ComponentError(f"{name}: `times` returned the shape {times.shape}, expected ({n},)")
    if not ((np.diff(times) >= 0).all() and orbit.t[0] <= times[0] and times[-1] <= orbit.t[-1]):
        raise ComponentError(f"{name}: the release times must increase from the look-back time to today")
    return times


def losing_mass(orbit: Orbit, satellite: Satellite, loss: float, times: Array) -> Orbit:
    """Return the orbit with the remaining mass of the progenitor, and the tidal radius of that mass.

    The mass is lost with the particles, released at ``times`` (n,): all of them together carry the fraction ``loss``.
    """
    if loss == 0:
        return orbit
    pairs = times[::2]
    gone = np.interp(orbit.t, [*pairs, orbit.t[-1]], np.linspace(0.0, 1.0, len(pairs) + 1))
    left = 1.0 - loss * gone
    return replace(orbit, r_tidal=satellite.shrunk(orbit.r_tidal, left), mass_left=left)


def random_numbers(scheme: StrippingScheme, seed: int) -> Array:
    """(draws, n) The random numbers of a scheme from the seed; column i belongs to particle i whatever n is.

    Standard normals, or for a live progenitor uniform numbers between 0 and 1.
    """
    return uniform_points(scheme, seed) if isinstance(scheme, LiveStripping) else standard_normals(scheme, seed)


def other_numbers(scheme: StrippingScheme, numbers: Array, rng: np.random.Generator) -> Array:
    """(draws, n) Return random numbers of the same kind as `random_numbers`, independent of the given ones."""
    live = isinstance(scheme, LiveStripping)
    if not scheme.quasi_random:
        shape = numbers.T.shape
        return np.ascontiguousarray((rng.random(shape) if live else rng.standard_normal(shape)).T)
    if live:
        return np.asarray(np.clip((numbers + rng.random((len(numbers), 1))) % 1.0, EDGE, 1.0 - EDGE))
    return shifted_normals(numbers, rng)


def uniform_points(scheme: StrippingScheme, seed: int) -> Array:
    """(draws, n) Uniform numbers between 0 and 1, all particles in one scrambled Sobol sequence."""
    n, draws, rng = scheme.particles, scheme.draws, np.random.default_rng(seed)
    if not scheme.quasi_random:
        return np.ascontiguousarray(rng.random((n, draws)).T)
    from scipy.stats import qmc  # slow to import

    points = qmc.Sobol(draws, scramble=True, rng=rng).random_base2(max(n - 1, 1).bit_length())[:n].T
    return np.ascontiguousarray(np.clip(points, 1e-12, 1 - 1e-12))  # a scrambled point may be 0


def standard_normals(stripping: StrippingScheme, seed: int) -> Array:
    """(draws, n) Standard normals from the seed; column i belongs to particle i whatever n is.

    The two tails, which alternate, have a Sobol sequence each: one sequence for both would give each tail one half
    of the first coordinate. Release times grow with the index, which completes the sequence to a Hammersley set.
    """
    n, draws = stripping.particles, stripping.draws
    if not stripping.quasi_random:
        return np.ascontiguousarray(np.random.default_rng(seed).standard_normal((n, draws)).T)
    from scipy.stats import qmc  # slow to import

    out = np.empty((draws, n))
    for tail, stream in enumerate(np.random.default_rng(seed).spawn(2)):
        count = len(range(tail, n, 2))
        points = qmc.Sobol(draws, scramble=True, rng=stream).random_base2(max(count - 1, 1).bit_length())
        out[:, tail::2] = ndtri(points[:count].T)
    return out


def shifted_normals(normals: Array, rng: np.random.Generator) -> Array:
    """(draws, n) Return other standard normals from quasi-random ones: as even as they are, and independent of them.

    Each coordinate of each tail is shifted, modulo 1, by one random number (Cranley & Patterson 1976).
    """
    shifts = np.tile(rng.random((len(normals), 2)), (normals.shape[1] + 1) // 2)[:, : normals.shape[1]]
    return np.asarray(ndtri(np.clip((ndtr(normals) + shifts) % 1.0, EDGE, 1.0 - EDGE)))
