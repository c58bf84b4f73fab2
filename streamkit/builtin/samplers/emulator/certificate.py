"""The certificate: whether fresh calls at samples of the emulated posterior are what the emulator said, but for noise.

A call of the model is noisy, so that true and emulated ln likelihood differ even where the emulator is perfect. All
tests therefore compare with the noise: residuals of the predictions with the variances that belong to them, and ln
likelihood with that of the residuals of *other* points put on the emulated predictions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from streamkit import Array
from streamkit.builtin.samplers.emulator.changes import change_of, changes_of, every_so_often, with_axes
from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.learn.emulator import Predictions
from streamkit.builtin.samplers.emulator.learn.of_target import LikelihoodOnly
from streamkit.builtin.samplers.emulator.learn.points import nearest
from streamkit.builtin.samplers.emulator.learn.polynomial import regress
from streamkit.builtin.samplers.emulator.learn.problem import Problem
from streamkit.builtin.samplers.emulator.places import to_call
from streamkit.builtin.samplers.emulator.walk.density import Emulated

# Largest mean square of a residual in units of its variance, over all data and of one of them.
SIZE, ONE_SIZE = 1.5, 3.0
# Standard deviations of a parameter that a trend of the residuals may move it, or change its width by as a fraction.
MOVED = 0.12
# Fraction of trends by chance alone that must be smaller for one to count, and how many are tried at least.
CHANCE, TRIES = 0.95, 40
# A trend that exceeds this by such a factor is more than chance, whatever more calls would say.
SURELY = 1.5
# Largest trend by chance that still tests anything: calls so noisy were certified with a width off by a half.
BLIND = 0.3
# Fresh calls at a time, and how often they are made at most: until a trend by chance alone is below `MOVED`, and longer
# until it is below `BLIND`, as of many parameters one has a large trend by chance.
FRESH, BATCHES, MOST_BATCHES = 128, 3, 12
# Differences of ln likelihood from what the noise makes of it: standard errors, and nats, of the median; ratio of their
# spreads.
OFF, NATS, WIDER = 4.0, 0.7, 2.0
# Fraction of points of the posterior that may have no prediction.
EMPTY = 0.1
# What the emulator's own error may change: the standard deviation of a parameter by this fraction. The error is part of
# the likelihood, so that it widens intervals and hides nothing. A twentieth refused emulators that were right.
# And the ln weight of one sample by so much: see `blur_of`.
BLURRED, MOST_OF_ONE = 0.1, 1.0
# Errors of the data that count as noise in any case.
FLOOR = 1e-3
# Largest squared residual that counts, in units of the typical one.
OUTLIER = 25.0


@dataclass(frozen=True)
class Certificate:
    """What fresh calls say of an emulator.

    Attributes
    ----------
    calls
        How many there were.
    size, worst
        Mean square of the residuals in units of their variance: of all data, and of the worst one.
    trend, trend_by_chance
        What the trend of the residuals along the parameters changes, see `change_of`; and the same of residuals in
        another order, whose trend is chance: the largest in 95 of 100 cases.
    offset, spread
        Median and standard deviation of true minus emulated ln likelihood.
    noise_offset, noise_spread
        The same if only noise made it.
    blur
        Fraction of a standard deviation that the emulator's own error adds, at most.
    empty
        Fraction of the points without a prediction.
    weighed, weighed_by_chance
        What weights of true over emulated likelihood change of the fresh samples, see `change_of`, beyond the mean of
        what noise changes; and the same where only noise makes the weights: the largest in 95 of 100 cases.
    faults
        Sentences: why the posterior must not be used; none if it is certified.
    held_out
        How many of the calls were held out of those that it had, and not fresh.
    """

    calls: int
    size: float
    worst: float
    trend: float
    trend_by_chance: float
    offset: float
    spread: float
    noise_offset: float
    noise_spread: float
    blur: float
    empty: float
    weighed: float
    weighed_by_chance: float
    faults: tuple[str, ...]
    held_out: int = 0


class Trend(NamedTuple):
    """What a linear trend of the residuals along the parameters changes of the posterior, see `change_of`.

    Attributes
    ----------
    measured
        That of the residuals as they are.
    by_calls
        That of residuals in another order, whose trend is chance: the largest in 95 of 100 cases.
    by_learned
        The same of the noise of the calls that were learned from, where it counts as chance.
    """

    measured: float
    by_calls: float
    by_learned: float = 0.0

    @property
    def by_chance(self) -> float:
        """The largest that all noise makes in 95 of 100 cases."""
        return float(np.hypot(self.by_calls, self.by_learned))

    @property
    def would_show(self) -> float:
        """What is more than may be, and than chance makes."""
        return max(MOVED, self.by_chance)

    @property
    def counts(self) -> bool:
        """Whether it is as much."""
        return self.measured > self.would_show

    @property
    def counts_surely(self) -> bool:
        """Whether it is as much more as chance makes in one of some hundred cases."""
        return self.measured > SURELY * self.would_show


def fresh_calls(
    emulated: Emulated,
    problem: Problem,
    samples: Array,
    rng: np.random.Generator,
    chance: float = CHANCE,
    most: int = MOST_BATCHES * FRESH,
) -> tuple[Calls, Trend | None]:
    """Call the model at some of the samples (n, d): so often that a trend of the residuals can be told from chance.

    The fraction of trends by chance that must be smaller for one to count is ``chance``. After ``most`` calls no more
    are made, but for `FRESH` in any case.
    """
    places = to_call(emulated, samples, len(samples), rng)

    def called(batch: int) -> Calls:
        return Calls.at(problem, emulated.space, places[batch * FRESH : (batch + 1) * FRESH])

    fresh = called(0)
    trend = trend_of(emulated, fresh, samples, rng, chance)
    for batch in range(1, min(most // FRESH, MOST_BATCHES)):
        if trend is None or not trend.by_calls > (MOVED if batch < BATCHES else BLIND):
            break
        fresh += called(batch)
        trend = trend_of(emulated, fresh, samples, rng, chance)
    return fresh, trend


def trend_of(
    emulated: Emulated, fresh: Calls, samples: Array, rng: np.random.Generator, chance: float = CHANCE
) -> Trend | None:
    """Measure what a trend of the residuals of fresh calls changes; None where too few of them have a prediction."""
    some = every_so_often(samples, 1000)
    changes = changes_by_trend(emulated, fresh, some, rng, _tries(chance))
    if changes is None:
        return None
    measured, *by_chance = (change_of(some, each) for each in changes)
    return Trend(measured, float(np.quantile(by_chance, chance)))


def _tries(chance: float) -> int:
    """Return how many changes by chance say which fraction ``chance`` of them is smaller.

    The largest of forty is exceeded by one more in forty: of thirty streams that are right, one would be refused.
    """
    return max(TRIES, round(1 / (1 - chance)))


def changes_by_trend(
    emulated: Emulated,
    fresh: Calls,
    some: Array,
    rng: np.random.Generator,
    tries: int = TRIES,
    by_sign: bool = False,
) -> Array | None:
    """(1 + ``tries``, n) Return what a linear trend of the residuals of fresh calls adds to ln L at samples (n, d).

    The first row is that of the residuals as they are, the others those of residuals in another order, whose trends are
    chance; or ``by_sign`` each call's with a sign by chance, whose mean is chance too. NaN where the calls do not span
    the parameters; None where too few of them have a prediction.
    """
    fresh = fresh.take(fresh.good)
    if len(fresh) < 3 * some.shape[1]:
        return None
    space, problem, z = emulated.space, fresh.problem, fresh.z
    used = np.isfinite(problem.values)
    residual = ((fresh.answers.mean - emulated.emulator.predict(fresh.y).mean) / problem.errors)[:, used]
    centre, scale = z.mean(axis=0), np.maximum(z.std(axis=0), 1e-300)
    terms = np.concatenate([np.ones((len(fresh), 1)), (z - centre) / scale], axis=1)
    predicted, theta = emulated.emulator.predict(space.learned(some)), space.points(some)
    variance = predicted.fit_variance + predicted.noise * emulated.noise
    base = problem.compare(theta, predicted.mean, variance, predicted.details)
    there = np.concatenate([np.ones((len(some), 1)), np.clip((some - centre) / scale, -3.0, 3.0)], axis=1)

    def change(rows: Array) -> Array:
        slope = regress(terms, rows, np.ones(len(rows)), 1e-6).coefficients
        mean = predicted.mean.copy()
        mean[:, used] += (there @ slope) * problem.errors[used]
        return problem.compare(theta, mean, variance, predicted.details) - base

    def by_chance() -> Array:
        signs = rng.choice([-1.0, 1.0], size=(len(residual), 1)) if by_sign else None
        return np.asarray(rng.permutation(residual) if signs is None else signs * residual)

    try:
        return np.array([change(residual), *(change(by_chance()) for _ in range(tries))])
    except LinAlgError:
        return np.full((1 + tries, len(some)), np.nan)


def certify(
    emulated: Emulated,
    fresh: Calls,
    trend: Trend | None,
    samples: Array,
    rng: np.random.Generator,
    chance: float = CHANCE,
    before: Calls | None = None,
) -> Certificate:
    """Compare an emulator with fresh calls at samples of its posterior; samples z (n, d) are more of these.

    The fraction of changes by chance that must be smaller for one to count is ``chance``. Calls ``before`` these, which
    it has learned from, tell as well whether the noise of ln L varies: more calls cannot mend that.
    """
    empty = float(np.mean(~fresh.good))
    tried, fresh = len(fresh), fresh.take(fresh.good)
    faults = []
    if empty > EMPTY:
        faults.append(f"{100 * empty:.0f} % of its samples have no prediction")
    if trend is None:
        faults.append("too few of its samples have a prediction to test it")
        nan = float("nan")
        return Certificate(tried, nan, nan, nan, nan, nan, nan, nan, nan, nan, empty, nan, nan, tuple(faults))
    problem, predicted = fresh.problem, emulated.emulator.predict(fresh.y)
    used = np.isfinite(problem.values)
    residual = (fresh.answers.mean - predicted.mean)[:, used]
    variance = (predicted.fit_variance + np.maximum(predicted.noise, fresh.answers.variance))[:, used]
    floor = (FLOOR * problem.errors[used]) ** 2
    squares = np.minimum(residual**2 / (variance + floor), 100.0)
    size, worst = float(squares.mean()), float(squares.mean(axis=0).max())
    if size > SIZE or worst > ONE_SIZE:
        faults.append(f"residuals of its predictions are {np.sqrt(max(size, worst / 2)):.1f} times what noise makes")
    if trend.counts:
        faults.append(
            "residuals have a trend along the parameters, which moves one or changes its width by "
            f"{trend.measured:.2f} standard deviations"
        )
    elif trend.by_calls > BLIND:
        faults.append(
            f"calls are too noisy for a test: a mean or a width off by {trend.by_chance:.2f} standard deviations would "
            "not show. " + ("Raise sampler.max_calls" if tried < MOST_BATCHES * FRESH else "Take more particles")
        )
    true, by_noise = _differences(emulated, fresh, predicted, rng)
    offset, spread = float(np.median(true)), _spread(true)
    noise_offset, noise_spread = float(np.median(by_noise)), _spread(by_noise)
    error = 1.25 * np.hypot(spread, noise_spread) / np.sqrt(len(true))
    if abs(offset - noise_offset) > OFF * error + NATS or spread > WIDER * noise_spread + NATS:
        faults.append(
            f"true minus emulated ln L is {offset:.1f} +- {spread:.1f}, where noise makes {noise_offset:.1f} +- "
            f"{noise_spread:.1f}"
        )
    varies = _noise_varies(emulated, fresh, before, samples, rng)
    if varies is not None and varies.counts:
        faults.append(
            "ln L is learned as a whole, and its noise varies over the posterior: its mean and the logarithm of the "
            f"mean likelihood differ by {varies.measured:.2f} standard deviations. Take more particles"
        )
    blur = blur_of(emulated, samples)
    if blur > BLURRED:
        faults.append(f"its own error changes the width of a parameter by {100 * blur:.0f} %")
    weighed = _weighed(emulated, fresh, predicted, true, rng, chance)._replace(by_learned=trend.by_learned)
    if weighed.counts and weighed.by_calls < BLIND:
        faults.append(
            f"true over emulated likelihood moves a mean or a width by {weighed.measured:.2f} standard deviations, "
            f"where noise makes {weighed.by_chance:.2f}"
        )
    return Certificate(
        tried, size, worst, trend.measured, trend.by_chance, offset, spread, noise_offset, noise_spread, blur, empty,
        weighed.measured, weighed.by_chance, tuple(faults),
    )  # fmt: skip


def _near(calls: Calls) -> Calls:
    """Return the calls near the data."""
    good = calls.take(calls.good)
    return good.take(nearest(good.answers.ln_likelihood, good.theta.shape[1]))


def _noise_varies(
    emulated: Emulated, fresh: Calls, before: Calls | None, samples: Array, rng: np.random.Generator
) -> Trend | None:
    """Measure what half the variance of ln L changes of the posterior; None where predictions are learned.

    Calls give the mean of ln L. The ln of the mean likelihood is higher by half the variance, and ln L of infinitely
    many particles by about as much: where the noise is the same everywhere, all three have one posterior.
    """
    if not isinstance(fresh.problem, LikelihoodOnly):
        return None
    if before is not None:
        fresh = fresh + _near(before)
    half = 0.5 * (fresh.answers.mean - emulated.emulator.predict(fresh.y).mean) ** 2
    half = np.minimum(half, OUTLIER * np.median(half) + 1e-300)
    z = fresh.z
    centre, scale = z.mean(axis=0), np.maximum(z.std(axis=0), 1e-300)
    terms = np.concatenate([np.ones((len(fresh), 1)), (z - centre) / scale], axis=1)
    some = every_so_often(samples, 1000)
    there = np.concatenate([np.ones((len(some), 1)), np.clip((some - centre) / scale, -3.0, 3.0)], axis=1)

    def moved(rows: Array) -> float:
        return change_of(some, there @ regress(terms, rows, np.ones(len(rows)), 1e-6).coefficients[:, 0])

    by_chance = [moved(rng.permutation(half)) for _ in range(TRIES)]
    return Trend(moved(half), float(np.quantile(by_chance, CHANCE)))


def _differences(
    emulated: Emulated, fresh: Calls, predicted: Predictions, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return true minus emulated ln likelihood (n,), and the same with the residuals of other points (n,)."""
    problem, answers = fresh.problem, fresh.answers
    stated = answers.variance * emulated.noise
    true = problem.compare(fresh.theta, answers.mean, np.nan_to_num(stated), answers.details)
    at = emulated.emulator.ln_likelihood(fresh.y, fresh.theta, emulated.noise, emulated.most_by_error)
    return true - at, _by_noise(fresh, predicted, stated, rng) - at


def _by_noise(fresh: Calls, predicted: Predictions, stated: Array, rng: np.random.Generator) -> Array:
    """(n,) Return ln likelihood of the emulated predictions with the residuals of other points.

    Each is in units of the noise that is predicted at its place: noise may be larger in one part of the posterior.
    """
    other = rng.permutation(len(fresh))
    size = np.sqrt(predicted.noise + predicted.fit_variance + (FLOOR * fresh.problem.errors) ** 2)
    swapped = predicted.mean + ((fresh.answers.mean - predicted.mean) / size)[other] * size
    return fresh.problem.compare(fresh.theta, swapped, np.nan_to_num(stated[other]), predicted.details)


def _weighed(
    emulated: Emulated, fresh: Calls, predicted: Predictions, true: Array, rng: np.random.Generator, chance: float
) -> Trend:
    """Measure what weights by true minus emulated ln likelihood (n,) change of the fresh samples, and what noise would.

    Noise alone makes weights too, of a few samples where it is large, and narrows what it grows along: so it is from
    what noise does in the mean that changes are measured.
    """
    moving, stated = with_axes(fresh.z), fresh.answers.variance * emulated.noise
    without = fresh.problem.compare(fresh.theta, predicted.mean, np.nan_to_num(stated), predicted.details)
    noise = (_by_noise(fresh, predicted, stated, rng) - without for _ in range(_tries(chance)))
    tries = np.array([changes_of(moving, each) for each in noise])
    away = np.abs(np.array([changes_of(moving, true), *tries]) - tries.mean(axis=0)).max(axis=(1, 2))
    return Trend(float(away[0]), float(np.quantile(away[1:], chance)))


def blur_of(emulated: Emulated, samples: Array) -> float:
    """Return what the emulator's own error changes, see `change_of`; each ln weight by `MOST_OF_ONE` at most.

    With its own error, the likelihood is the mean of what the true one may be. Without, it is the largest that the true
    one may be: where the error takes 5 from ln L, one sample in a thousand would have a tenth of the weight.
    """
    some = every_so_often(samples, 3000)
    return change_of(some, -emulated.change_by_error(some), (-MOST_OF_ONE, MOST_OF_ONE))


def _spread(values: Array) -> float:
    """Return a standard deviation that leaves the wildest alone."""
    low, high = np.quantile(values, [0.16, 0.84])
    return float(0.5 * (high - low))
