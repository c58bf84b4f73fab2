"""Checks of a sampler: a correlated Gaussian whose moments and evidence are known in closed form."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from typing import TypeVar

import numpy as np

import streamkit as sk
from streamkit.testing import common
from streamkit.testing.common import Check, require

T = TypeVar("T")

RHO, SD = 0.6, 0.4
INVERSE = np.linalg.inv(SD**2 * np.array([[1.0, RHO], [RHO, 1.0]]))
LN_NORM = -math.log(2 * math.pi * SD**2 * math.sqrt(1 - RHO**2))
# The values of a normalised Gaussian far from the ends of a prior that is uniform between -5 and 5.
LN_EVIDENCE = -2 * math.log(10.0)

BEFORE, AFTER = 30, 80  # steps of a chain before it is resumed, and after


class Gaussian:
    """The Gaussian as a `streamkit.Target`, for one use of a sampler; a tenth of the prior has no stream.

    Its two data are the parameters themselves.
    """

    def __init__(self, seed: int = 1, last: sk.Ensemble | None = None, steps: Sequence[sk.Ensemble] = ()) -> None:
        self.size, self.seed, self.workers, self.progress = 2, seed, 4, False
        self.priors = (sk.Uniform(-5.0, 5.0), sk.Uniform(-5.0, 5.0))
        self.data = sk.Data(np.zeros(2), np.full(2, SD), covariance=np.linalg.inv(INVERSE))
        self.coordinates: sk.BoolArray = np.ones(2, dtype=bool)
        self.undeclared: Sequence[str] = ()
        self.calls: Counter[bytes] = Counter()
        self.steps = list(steps)
        self._last = last

    def from_unit(self, u: sk.Array) -> sk.Array:
        """Return 10 u - 5."""
        return np.asarray(10.0 * np.asarray(u) - 5.0)

    def ln_prior(self, points: sk.Array) -> sk.Array:
        """Return -2 ln 10 inside."""
        return np.where((np.abs(points) <= 5).all(axis=1), LN_EVIDENCE, -np.inf)

    def evaluate(self, points: sk.Array) -> sk.Array:
        """Return the ln density."""
        self.calls.update(point.tobytes() for point in np.ascontiguousarray(np.atleast_2d(points), dtype=float))
        return self._ln_likelihood(np.atleast_2d(points))

    def _ln_likelihood(self, points: sk.Array) -> sk.Array:
        lnl = LN_NORM - 0.5 * np.einsum("ni,ij,nj->n", points, INVERSE, points)
        return np.where((points[:, 0] > 4) | ~np.isfinite(self.ln_prior(points)), -np.inf, lnl)

    factors: tuple[sk.TargetFactor, ...] = ()
    small_is_full = False
    earlier = np.empty((0, 2))

    def call_factors(self, points: Mapping[str, sk.Array]) -> None:
        """Call no factors: there are none."""

    def at_once(self, tasks: Sequence[Callable[[], T]], /) -> list[T]:
        """Run tasks one after another."""
        return [task() for task in tasks]

    def predictions(self, points: sk.Array, small: bool = False) -> sk.Evaluations:
        """Return the parameters as predictions without noise."""
        self.evaluate(points)
        return self._evaluations(points)

    def _evaluations(self, points: sk.Array) -> sk.Evaluations:
        lnl = self._ln_likelihood(points)
        mean = np.where(np.isfinite(lnl)[:, None], points, np.nan)
        reasons = tuple("" if there else "no stream" for there in np.isfinite(lnl))
        details = np.empty((len(points), 0))
        return sk.Evaluations(self.ln_prior(points) + lnl, lnl, mean, 0.0 * mean, reasons, details)

    def compare(self, points: sk.Array, mean: sk.Array, variance: sk.Array, details: sk.Array) -> sk.Array:
        """Return the ln density of predictions, with their variances added to those of the data."""
        covariance = np.linalg.inv(INVERSE) + variance[:, :, None] * np.eye(2)
        away = np.einsum("ni,nij,nj->n", mean, np.linalg.inv(covariance), mean)
        return np.asarray(-0.5 * away - 0.5 * np.log(np.linalg.det(2 * math.pi * covariance)))

    def start(self, count: int, particles: int) -> sk.Ensemble:
        """Return points near the maximum."""
        points = SD * np.random.default_rng([self.seed, 1]).standard_normal((count, 2))
        lnp = self.ln_prior(points) + self.evaluate(points)
        return sk.Ensemble(points, lnp, np.zeros(count, dtype=bool), np.random.RandomState(self.seed).get_state())

    def restore(self) -> sk.Ensemble | None:
        """Return the step that a resumed chain begins with."""
        return self._last

    def chain(self) -> sk.Array:
        """Return the points of all steps."""
        return np.array([step.points for step in self.steps]) if self.steps else np.empty((0, 0, 2))

    def chain_evaluations(self) -> sk.Evaluations:
        """Return the density and the predictions at the points of all steps."""
        return self._evaluations(self.chain().reshape(-1, 2))

    def expect(self, calls: float) -> None:
        """Show nothing."""

    def remark(self, text: str) -> None:
        """Show nothing."""

    def time_left(self) -> float:
        """Return infinity."""
        return math.inf


def sampled(component: sk.Sampler, seed: int = 1, most: int | None = None) -> tuple[Gaussian, sk.Samples]:
    """Return the target after its use, and the last samples; for a chain the second half of it, with equal weights.

    A chain ends after ``most`` steps.
    """
    target, last = Gaussian(seed), None
    for number, state in enumerate(islice(component.sample(target), most and most + 1)):
        if isinstance(state, sk.Ensemble):
            check_step(target, state)
            target.steps += [state] if number else []  # the first is the start
        else:
            last = state
    if target.steps:
        points = target.chain()[len(target.steps) // 2 :].reshape(-1, 2)
        last = sk.Samples(points, np.zeros(len(points)))
    if last is None:
        raise AssertionError("sample yields nothing: the last samples, or the steps, that it yields are the result")
    return target, last


_USES: dict[tuple[type[sk.Sampler], str], tuple[Gaussian, sk.Samples]] = {}


def first_use(component: sk.Sampler) -> tuple[Gaussian, sk.Samples]:
    """Return the result of `sampled`, computed once for all checks of a sampler: a use may take a minute."""
    key = type(component), repr(component)
    if key not in _USES:
        _USES[key] = sampled(component)
    return _USES[key]


def check_step(target: Gaussian, step: sk.Ensemble) -> None:
    """Check the shapes of a step of a chain, and its ln posterior."""
    require(step.points.ndim == 2 and step.points.shape[1] == 2, "points of a step are (walkers, d)")
    walkers = len(step.points)
    shapes = np.shape(step.ln_probability), np.shape(step.accepted)
    require(shapes == ((walkers,), (walkers,)), "ln_probability and accepted of a step are (walkers,)")
    lnp = target.ln_prior(step.points) + target.evaluate(step.points)
    require(np.allclose(step.ln_probability, lnp), "ln_probability of a step is ln prior + ln likelihood of its points")


def samples_a_gaussian(component: sk.Sampler) -> None:
    """Check shapes, weights, means, standard deviations, correlation and evidence."""
    target, samples = first_use(component)
    n = len(samples.points)
    require(samples.points.shape == (n, 2) and samples.ln_weights.shape == (n,), "points are (n, d), ln_weights (n,)")
    evaluated = all(point.tobytes() in target.calls for point in np.ascontiguousarray(samples.points))
    require(evaluated or samples.evaluations is not None, "gives points that it never asked target.evaluate for")
    weights = np.exp(samples.ln_weights - samples.ln_weights.max())
    weights /= weights.sum()
    error = math.sqrt(float(np.sum(weights**2)))
    if target.steps:  # samples of a chain depend on each other
        tau = sk.autocorrelation_times(target.chain()[len(target.steps) // 2 :])
        error *= math.sqrt(float(np.nan_to_num(tau, nan=n).max()))
    mean = weights @ samples.points
    away = samples.points - mean
    covariance = (away * weights[:, None]).T @ away
    require((np.abs(mean) < 5 * SD * error).all(), f"the means of a Gaussian at 0 with sd {SD} are {mean}")
    sd = np.sqrt(np.diag(covariance))
    require((np.abs(sd / SD - 1) < 5 * error).all(), f"standard deviations of {SD} are found as {sd}")
    rho = covariance[0, 1] / sd.prod()
    require(abs(rho - RHO) < 5 * error, f"a correlation of {RHO} is found as {rho:.3f}")
    if np.isfinite(samples.ln_evidence):
        off = abs(samples.ln_evidence - LN_EVIDENCE)
        text = f"ln evidence {samples.ln_evidence:.3f} +- {samples.ln_evidence_error:.3f}, {LN_EVIDENCE:.3f} is right"
        require(off < max(5 * samples.ln_evidence_error, 0.02), text)


def repeats_itself(component: sk.Sampler) -> None:
    """Check that the same target gives the same samples, and another seed others: resuming rests on this."""
    (first, one), (again, two) = first_use(component), sampled(component)
    require(first.calls.keys() == again.calls.keys(), "the same target is asked for other points the second time")
    same = np.array_equal(one.points, two.points) and np.array_equal(one.ln_weights, two.ln_weights)
    require(same, "the same target gives other samples the second time: take all chance from target.seed")
    other = Gaussian(seed=2)
    asks = (not other.calls.keys() <= first.calls.keys() for _ in component.sample(other))
    require(any(asks), "another seed gives the same samples")  # seen long before the last of them


def resumes(component: sk.Sampler) -> None:
    """Check that a chain that is resumed after any of its steps takes the steps of an unbroken one."""
    if not isinstance(component, sk.ChainSampler):
        return
    whole = sampled(component, most=BEFORE + AFTER)[0].steps
    for done in (1, min(BEFORE, len(whole) - 1)):
        target = Gaussian(1, whole[done - 1], whole[:done])
        for step in islice(component.walk(target, whole[done - 1]), min(len(whole) - done, AFTER)):
            number = len(target.steps)
            same = np.array_equal(step.points, whole[number].points)
            reason = "the points, random_state or memory of a step must hold all that the next depends on"
            require(same, f"a chain that is resumed after step {done} has another step {number + 1}: {reason}")
            target.steps.append(step)


def returns_what_it_says(component: sk.Sampler) -> None:
    """Check the types and values that the optional methods return, for the two parameters of the Gaussian."""
    cls, fields = type(component), type(component).model_fields
    reason = component.reject_dimension(2)
    require(isinstance(reason, str), f"reject_dimension returns {reason!r}: a text, empty if d parameters are allowed")
    require(not reason, f"reject_dimension(2) returns {reason!r}: the kit samples two parameters; change the example")
    quick = component.quick_settings(2)
    require(isinstance(quick, dict), f"quick_settings returns {quick!r}: a dict of fields and their values")
    cls(**{**component.model_dump(), **quick})  # pydantic says what is wrong
    strange = [name for name in (*quick, *cls.stopping) if name not in fields]
    require(not strange, f"quick_settings and stopping name fields of the class: {strange} are none")
    size = component.search_size()
    require(_are(size, int) and len(size) == 2, f"search_size returns {size!r}: a tuple of two integers")
    calls = component.calls(2)
    known = isinstance(calls, tuple) and len(calls) == 2 and _are(calls[:1], int) and _are(calls[1:], str)
    require(known and calls[0] >= 0, f"calls returns {calls!r}: a tuple, the number of calls and how it comes about")
    advice = component.advice(2)
    require(_are(advice, str), f"advice returns {advice!r}: a tuple of sentences")
    cites = component.cites()
    require(isinstance(cites, dict) and _are((*cites, *cites.values()), str), f"cites returns {cites!r}: a dict")
    if isinstance(component, sk.ChainSampler):
        chain = np.random.default_rng(1).standard_normal((200, 2 * component.walkers, 2))
        left = component.learning_steps(chain)
        require(_are((left,), int) and left >= 0, f"learning_steps returns {left!r}: a number of steps")


def _are(values: object, kind: type) -> bool:
    """Return whether this is a tuple of values of one kind; integers of numpy, and truth values, are no integers."""
    return isinstance(values, tuple) and all(isinstance(each, kind) and type(each) is not bool for each in values)


CHECKS: tuple[Check, ...] = (*common.COMMON, returns_what_it_says, samples_a_gaussian, repeats_itself, resumes)
