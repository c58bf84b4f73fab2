"""Slopes of the predictions in the parameters, by streams with common random numbers on both sides of a place.

First each parameter takes a step by itself, as long as moves the data by a few errors. The bounds that follow say how
far the parameters may go together: the final steps go along their principal axes, one standard deviation far. So the
slopes are those over the extent of the posterior, where the noise of the particles matters least. Each set of random
numbers (seed) gives slopes of its own: products of the slopes of two seeds have no bias by their noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from streamkit import Array, BoolArray, IntArray, Spec, StreamkitError
from streamkit.runfile import DATA
from streamkit.study.grid import ended_before, run_jobs
from streamkit_forecast.coordinates import Coordinates
from streamkit_forecast.predict import Added, Job, Part, Predicted, evaluate, packed, parts

FIRST = 0.01  # first step, in standard deviations of the prior
LONGEST = 0.5  # longest one of a parameter by itself
AWAY = 3.0  # errors of all data together by which such a step moves them
ROUNDS = 3  # how often its length is chosen anew
FASTEST = 30.0  # largest factor from one length to the next
ROOM = 0.9  # of the way to the end of a prior, for a step
TRIES = 6  # how often a step without a stream is halved

Key = tuple[str, int, int, int]  # source, seed, direction, side
Found = dict[Key, Predicted]


@dataclass(frozen=True, eq=False)
class Slopes:
    """What is predicted of one stream, or of the host, about a place, by seed.

    Attributes
    ----------
    source
        The name of the stream, or `DATA`.
    parts
        The measurements, in the order of the m data.
    which
        (k,) The parameters that the predictions may depend on, of all d.
    mean, variance
        (m,) the prediction, and the variance of a datum about it, over the seeds.
    of_mean, of_variance
        (seeds, m, k) slopes in the coordinates.
    """

    source: str
    parts: list[Part]
    which: IntArray
    mean: Array
    variance: Array
    of_mean: Array
    of_variance: Array

    def rows(self, chosen: Callable[[Part], bool]) -> BoolArray:
        """(m,) Return which data belong to the chosen measurements, and exist."""
        return np.concatenate([part.used & chosen(part) for part in self.parts]).astype(bool)


class Search:
    """The steps of the parameters of one stream, or of the host, while they are chosen.

    Attributes
    ----------
    directions
        (k, k) Columns are the directions of the steps in the coordinates.
    step
        (k,) Their lengths in units of these.
    """

    def __init__(self, spec: Spec, source: str, which: IntArray, at: Coordinates, added: Added) -> None:
        self.spec, self.source, self.which, self.at = spec, source, which, at
        self.content = packed(spec, added)
        self.parts = parts(spec, source, added, at.parameters(at.centre))
        counted = [part.used & (not part.one_more) for part in self.parts]
        self.used = np.concatenate(counted).astype(bool)
        self.room = ROOM * np.minimum(at.centre - at.low, at.high - at.centre)[which]
        self.directions = np.diag(at.sd[which])
        self.most = np.minimum(LONGEST, self.room / at.sd[which])
        self.step = np.minimum(FIRST, self.most)

    def turn(self, covariance: Array) -> None:
        """Let the steps go along the principal axes of a covariance (d, d), in units of the priors."""
        sd = self.at.sd[self.which]
        inside = covariance[np.ix_(self.which, self.which)] / np.outer(sd, sd)
        value, vector = np.linalg.eigh(inside)
        self.directions = sd[:, None] * vector * np.sqrt(value)
        self.most = (self.room[:, None] / np.maximum(np.abs(self.directions), 1e-300)).min(axis=0)
        self.step = np.minimum(1.0, self.most)

    def job(self, seed: int, k: int, sign: int) -> Job:
        """Return the call one step up or down in the k-th direction; with ``sign`` 0 the place itself."""
        z = self.at.centre.copy()
        z[self.which] += sign * self.step[k] * self.directions[:, k]
        return self.content, seed, self.source, tuple(self.at.parameters(z).tolist())

    def jobs(self, seeds: range) -> dict[Key, Job]:
        """Return all calls: the place itself, and both sides in each direction."""
        sides = [(k, sign) for k in range(len(self.which)) for sign in (-1, 1)]
        return {(self.source, seed, k, sign): self.job(seed, k, sign) for seed in seeds for k, sign in [(0, 0), *sides]}

    def lengthen(self, found: Found, seed: int) -> None:
        """Choose each length anew from the calls of one seed: towards `AWAY` errors of all data together."""
        centre = self.centre(found, seed)
        for k in range(len(self.which)):
            low, high = (found[self.source, seed, k, sign] for sign in (-1, 1))
            away = ((high.mean - low.mean) / 2)[self.used] ** 2 / centre.variance[self.used]
            factor = np.clip(AWAY / max(np.sqrt(away.sum()), 1e-12), 1 / FASTEST, FASTEST)
            self.step[k] = min(self.step[k] * factor, self.most[k])

    def shorten(self, found: Found) -> bool:
        """Halve the steps that end where there is no stream; return whether there was one."""
        lost = {k for (source, _, k, sign), one in found.items() if source == self.source and sign and one.reason}
        for k in lost:
            self.step[k] /= 2
            self.most[k] = self.step[k]
        return bool(lost)

    def centre(self, found: Found, seed: int) -> Predicted:
        """Return the call at the place; StreamkitError if there is no stream."""
        centre = found[self.source, seed, 0, 0]
        if centre.reason:
            what = "host that can be measured" if self.source == DATA else f"stream {self.source!r}"
            raise StreamkitError(
                f"{self.spec.source}: there is no {what} where the forecast is made: {centre.reason}. Choose another "
                "place with --set or --run"
            )
        return centre

    def slopes(self, found: Found, seeds: range) -> Slopes:
        """Return the slopes of all seeds."""
        centres = [self.centre(found, seed) for seed in seeds]
        mean, variance = (np.mean([getattr(one, name) for one in centres], axis=0) for name in ("mean", "variance"))
        back = np.linalg.inv(self.directions)  # (directions, k)

        def slopes(name: str, seed: int) -> Array:
            sides = ([getattr(found[self.source, seed, k, sign], name) for k in range(len(back))] for sign in (-1, 1))
            low, high = (np.array(side).reshape(len(back), -1) for side in sides)
            return np.asarray(((high - low) / (2 * self.step[:, None])).T @ back)

        of_mean, of_variance = (np.array([slopes(name, seed) for seed in seeds]) for name in ("mean", "variance"))
        return Slopes(self.source, self.parts, self.which, mean, variance, of_mean, of_variance)


def slopes_of(
    searches: Sequence[Search],
    covariance_of: Callable[[list[Slopes]], Array],
    seeds: int,
    workers: int = 1,
    done: Callable[[], object] = lambda: None,
) -> list[Slopes]:
    """Return the slopes of each stream and of the host; StreamkitError without a stream, or if it is interrupted.

    ``covariance_of`` returns the covariance (d, d) of the coordinates that follows from slopes.
    """
    few = range(min(seeds, 2))
    for _ in range(ROUNDS):
        found = _calls(searches, range(1), workers, done)
        for search in searches:
            search.lengthen(found, 0)
    for some in (few, few, range(seeds)):
        found = _calls(searches, some, workers, done)
        slopes = [search.slopes(found, some) for search in searches]
        if some is few:
            whole = covariance_of(slopes)
            for search in searches:
                search.turn(whole)
    return slopes


def _calls(searches: Sequence[Search], seeds: range, workers: int, done: Callable[[], object]) -> Found:
    """Make the calls of all searches; steps that end where there is no stream are halved."""
    found: Found = {}
    left = list(searches)
    for _ in range(TRIES):
        jobs = {key: job for search in left for key, job in search.jobs(seeds).items()}
        new, stopped = run_jobs(evaluate, jobs, workers, done)
        if stopped:
            raise ended_before(searches[0].spec.source, stopped, "the slopes were known")
        found |= new
        for search in left:
            search.centre(found, 0)
        left = [search for search in left if search.shorten(new)]
        if not left:
            return found
    lost = left[0]
    reason = next(one.reason for key, one in found.items() if key[0] == lost.source and one.reason)
    raise StreamkitError(
        f"{lost.spec.source}: there is no stream beside the place of the forecast, however short the step: {reason}. "
        "Choose another place with --set or --run"
    )
