"""Checks of a stripping scheme, on an eccentric, inclined orbit."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from pydantic import ValidationError

from streamkit import GYR, LEADING, TRAILING, Array, IntArray, Orbit, Release, Stripping
from streamkit.testing.common import Check, require
from streamkit.testing.hosts import MASS, progenitor_orbit
from streamkit.testing.speed import stripping_is_fast

LOOKBACK = -3.0
# A rotation about (1, 1, 1) whose matrix is rational.
ROTATION = np.array([[2.0, -1.0, 2.0], [2.0, 2.0, -1.0], [-1.0, 2.0, 2.0]]) / 3.0


def case(scheme: Stripping, count: int, seed: int = 7) -> tuple[Orbit, IntArray, Array]:
    """Return the progenitor at ``count`` release times, tails in turn, and normals."""
    t = np.linspace(LOOKBACK, 0.0, count, endpoint=False) * GYR
    tail = np.where(np.arange(count) % 2, TRAILING, LEADING).astype(np.int64)
    normals = np.random.default_rng(seed).standard_normal((scheme.draws, count))
    return progenitor_orbit(LOOKBACK).at(t), tail, normals


def _both(release: Release) -> Array:
    return np.concatenate([release.q, release.v])


def says_how_many_draws(scheme: Stripping) -> None:
    """Check that ``draws`` is a number of standard normals per particle."""
    draws = getattr(type(scheme), "draws", None)
    require(isinstance(draws, int) and draws >= 0, f"draws must be an integer of 0 or more, found {draws!r}")


def releases_as_many_as_asked(scheme: Stripping) -> None:
    """Check that ``times`` gives ``particles`` times, odd or even, in order, within the look-back time."""
    track = progenitor_orbit(LOOKBACK)
    fields = scheme.model_dump()
    for rates in ("uniform", "pericentre"):
        for particles in (2, 7, 1000):
            asked = type(scheme)(**{**fields, "particles": particles, "release_times": rates})
            t = asked.times(track)
            require(t.shape == (particles,), f"{particles} particles asked for, times has shape {t.shape}")
            require((np.diff(t) >= 0).all(), f"the times of {particles} {rates} releases decrease")
            outside = ((t < track.t[0]) | (t > 0)).sum()
            require(not outside, f"{outside} of {particles} {rates} releases lie outside the look-back time")


def release_has_the_right_shape(scheme: Stripping) -> None:
    """Check that ``release`` returns finite q, v (3, n), for zero normals too, and alters no argument."""
    orbit, tail, normals = case(scheme, 50)
    for draws in (normals, np.zeros_like(normals)):
        before = [a.copy() for a in (orbit.q, orbit.v, tail, draws)]
        release = scheme.release(orbit, tail, MASS, draws)
        require(
            release.q.shape == release.v.shape == (3, 50),
            f"50 particles gave q {release.q.shape} and v {release.v.shape}",
        )
        require(np.isfinite(_both(release)).all(), "positions or velocities are not finite")
        unchanged = zip(before, (orbit.q, orbit.v, tail, draws), strict=True)
        require(all(np.array_equal(a, b) for a, b in unchanged), "release changes its arguments")


def chance_is_an_argument(scheme: Stripping) -> None:
    """Check that the same normals give the same, and each particle depends on its own column alone."""
    orbit, tail, normals = case(scheme, 50)
    whole = _both(scheme.release(orbit, tail, MASS, normals))
    again = _both(scheme.release(orbit, tail, MASS, normals))
    require(np.array_equal(whole, again), "two calls with the same normals differ: draw nothing yourself")
    some = np.arange(1, 50, 3)
    part = Orbit(orbit.t[some], orbit.q[:, some], orbit.v[:, some], orbit.a[:, some], orbit.r_tidal[some])
    subset = _both(scheme.release(part, tail[some], MASS, normals[:, some]))
    require(
        np.allclose(subset, whole[:, some], rtol=1e-13, atol=1e-13),
        "a particle's release depends on which others are released with it",
    )


def tails_lie_on_their_sides(scheme: Stripping) -> None:
    """Check that with zero normals tail -1 starts nearer to the Galactic centre, tail +1 farther out."""
    orbit, tail, normals = case(scheme, 50)
    release = scheme.release(orbit, tail, MASS, np.zeros_like(normals))
    offset = np.sqrt((release.q**2).sum(axis=0)) - orbit.r
    wrong = (offset * tail <= 0).sum()
    require(not wrong, f"{wrong} of 50 particles start on the other side")


def turns_with_the_orbit(scheme: Stripping) -> None:
    """Check that the cloud rotates with the orbit: exactly for zero normals, else in mean and covariance."""
    orbit, tail, normals = case(scheme, 50)
    turned = Orbit(orbit.t, ROTATION @ orbit.q, ROTATION @ orbit.v, ROTATION @ orbit.a, orbit.r_tidal)
    zero = np.zeros_like(normals)
    here, there = scheme.release(orbit, tail, MASS, zero), scheme.release(turned, tail, MASS, zero)
    same = [np.allclose(ROTATION @ a, b, atol=1e-9) for a, b in ((here.q, there.q), (here.v, there.v))]
    require(all(same), "with zero normals the releases do not turn with the progenitor")
    count, sigmas = 20000, 6.0
    one = np.zeros(count, dtype=np.int64)
    normals = np.random.default_rng(8).standard_normal((scheme.draws, count))
    clouds = []
    for states, back in ((orbit, np.eye(3)), (turned, ROTATION.T)):
        state = Orbit(*(a[..., one] for a in (states.t, states.q, states.v, states.a, states.r_tidal)))
        release = scheme.release(state, one + TRAILING, MASS, normals)
        clouds.append(np.concatenate([back @ release.q, back @ release.v]))
    a, b = clouds
    spread = a.std(axis=1) + 1e-9
    shift = np.abs(a.mean(axis=1) - b.mean(axis=1)) / spread
    far = shift.max()
    require(far <= sigmas * np.sqrt(2 / count), f"the mean turns otherwise by {far:.2g} dispersions")
    change = np.abs(np.cov(a) - np.cov(b)) / np.outer(spread, spread)
    far = change.max()
    require(far <= sigmas * np.sqrt(4 / count), f"the covariance turns otherwise by {far:.2g}")


def uses_its_draws(scheme: Stripping) -> None:
    """Check that every row of the normals changes the release: ``draws`` is not too large."""
    for name in (name for name in type(scheme).parameters() if getattr(scheme, name) == 0 and name != "mass_loss"):
        with suppress(ValidationError):  # a dispersion of zero hides its normals
            scheme = type(scheme)(**{**scheme.model_dump(), name: 1.0})
    orbit, tail, normals = case(scheme, 50)
    try:
        whole = _both(scheme.release(orbit, tail, MASS, normals))
    except (IndexError, ValueError) as error:
        raise AssertionError(f"{error}, with draws = {scheme.draws}: declare as many as are used") from error
    for row in range(scheme.draws):
        other = normals.copy()
        other[row] = np.random.default_rng(9).standard_normal(50)
        require(
            not np.array_equal(_both(scheme.release(orbit, tail, MASS, other)), whole),
            f"normals[{row}] changes nothing: draws is {scheme.draws}, declare as many as are used",
        )


CHECKS: tuple[Check, ...] = (
    says_how_many_draws,
    releases_as_many_as_asked,
    release_has_the_right_shape,
    uses_its_draws,
    chance_is_an_argument,
    tails_lie_on_their_sides,
    turns_with_the_orbit,
    stripping_is_fast,
)
