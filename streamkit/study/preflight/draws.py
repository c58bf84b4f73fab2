"""Trial streams over the prior, with the fraction that the observables can measure; and the cost of a run."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from streamkit.errors import OutOfDomain, SpecError
from streamkit.model import Host, Model, Observation
from streamkit.report import Progress
from streamkit.runfile import ONLY, ModelInputs, Spec
from streamkit.sample import Posterior, expected_calls, first_call
from streamkit.stream import Array, Prediction, Stream

TRIAL_PARTICLES = 1000  # particles of the trial streams over the prior: enough to decide whether there is a stream
BUDGET = 15.0  # CPU seconds after which no further trial stream is started
# Draws at which all streams can be measured that are enough: in examples with mistakes put into their data, 32 and 64
# draws led to the same warnings in 116 of 117 cases.
ENOUGH = 32


@dataclass(frozen=True)
class Trial:
    """One set of parameters, with the streams and the predictions that there are.

    Attributes
    ----------
    bound
        The run file at the parameters.
    observation
        The streams, and the predictions; without those of a stream that does not exist.
    reasons
        Why a stream cannot be measured, by its name; none for a stream that the observables can measure.
    """

    bound: ModelInputs
    observation: Observation
    reasons: dict[str, str]

    @property
    def reason(self) -> str:
        """The first of the reasons, after the name of its stream where there are several; empty without one."""
        return next((_named(name, reason) for name, reason in self.reasons.items()), "")


def _named(stream: str, reason: str) -> str:
    return reason if stream == ONLY else f"{stream}: {reason}"


@dataclass(frozen=True)
class PriorDraws:
    """Trial streams of `TRIAL_PARTICLES` particles at draws from the prior."""

    draws: int  # number of draws
    good: Array  # (good, d) the draws at which every stream can be measured
    seconds: Array  # (good,) CPU seconds of each of them
    reasons: Counter[str]  # reasons why streams cannot be measured, with their numbers
    total: float = 0.0  # CPU seconds of all of them
    trials: tuple[Trial, ...] = ()  # the draws at which some stream can be measured

    def measured(self, stream: str) -> int:
        """Return the number of draws at which a stream can be measured."""
        return sum(stream not in trial.reasons for trial in self.trials)


def observe(model: Model, theta: Array) -> tuple[Trial | None, str]:
    """Return the streams at theta (d,) with their predictions, and the reason if one cannot be measured.

    Raises CallTimeout if that takes too long.
    """
    try:
        bound = model.spec.bind_all(theta)
        trial = first_call(model.spec.sampler.call_limit, _tried, model, bound)
    except OutOfDomain as error:
        return None, error.reason
    return trial, trial.reason


def _tried(model: Model, bound: ModelInputs) -> Trial:
    """Make each stream of a bound spec that there is."""
    host = Host(bound.potentials, bound.bodies, numbers=bound.numbers)
    streams: dict[str, Stream] = {}
    predictions: dict[str, Prediction] = {}
    reasons: dict[str, str] = {}
    for name, inputs in bound.streams.items():
        try:
            streams[name], prediction = model.observe(inputs, host)
        except OutOfDomain as error:
            reasons[name] = error.reason.removeprefix(f"{name}: ")
            continue
        if prediction is not None:
            predictions[name] = prediction
            reasons |= {name: prediction.why_not} if prediction.why_not else {}
    predictions |= {f"data.{name}": one for name, one in model.observe_host(bound, host).items()}
    reasons |= {name: one.why_not for name, one in predictions.items() if one.why_not and name not in streams}
    return Trial(bound, Observation(streams, predictions), reasons)


def try_prior_draws(spec: Spec, draws: int, progress: bool = False) -> PriorDraws:
    """Try streams with few particles at random points of the prior, drawn from the run's seed.

    ``draws`` is their largest number: none is begun after `BUDGET`, or when `ENOUGH` can be measured.
    """
    model = Model(spec.with_particles(TRIAL_PARTICLES))
    rng = np.random.default_rng(spec.seed)
    points = np.stack([prior.sample(rng, draws) for prior in spec.priors], axis=1)
    reasons: Counter[str] = Counter()
    good: list[Array] = []
    seconds: list[float] = []
    trials: list[Trial] = []
    done, start = 0, time.process_time()
    with Progress("trial streams over the prior", draws, "stream", shown=progress) as bar:
        for theta in points:
            begin = time.process_time()
            if begin - start > BUDGET or len(good) == ENOUGH:
                break
            done += 1
            trial, reason = observe(model, theta)
            end = time.process_time()
            if trial is None:
                reasons[reason] += 1
            else:
                reasons.update(_named(name, why) for name, why in trial.reasons.items())
                measured = trial.bound.streams.keys() - trial.reasons.keys()
                trials += [trial] if measured or not (trial.bound.streams or reason) else []
            if trial is not None and not reason:
                good.append(theta)
                seconds.append(end - begin)
            in_time, needed = done * BUDGET / max(end - start, 1e-9), done * ENOUGH / max(len(good), 1e-9)
            bar.expect(int(min(draws, in_time + 1, np.ceil(needed))))
            bar.update()
    points = np.array(good).reshape(-1, len(spec.names))
    return PriorDraws(done, points, np.array(seconds), reasons, time.process_time() - start, tuple(trials))


SLOW = 5.0  # CPU seconds above which a first call is not repeated: loading machine code is a small part of it


@dataclass(frozen=True)
class Cost:
    """CPU seconds of the first call of a process and of a later one, at the parameters ``where``, and of the search."""

    first: float
    call: float
    where: str
    # approximate number of streams in the search for a start; 0 where nothing can be fitted or was tried.
    search_calls: int = 0
    search: float = 0.0  # their approximate CPU seconds
    compiled: bool = False  # whether machine code was compiled in the first call


def search_cost(spec: Spec, tried: PriorDraws | None, call: float) -> tuple[int, float]:
    """Estimate the streams of the search for a start and their CPU seconds, from trial streams over the prior."""
    if tried is None or not tried.draws:
        return 0, 0.0
    points, particles = spec.sampler.search_size()
    if not points:
        return 0, 0.0
    cheap, full = expected_calls(points, len(spec.names), len(tried.good) / tried.draws)
    each = tried.total / tried.draws * min(1.0, particles / TRIAL_PARTICLES)
    return cheap + full, cheap * each + full * call


def time_call(spec: Spec, theta: Array, first: float, *, compiled: bool) -> tuple[float, str]:
    """Return the CPU seconds of a call at theta (d,): the median of a few, or ``first`` if that was `SLOW`.

    Those of a first call in which machine code was ``compiled`` say nothing of later ones. The call is one of the
    posterior, or of the stream alone where nothing can be fitted; the second value is then the reason why.
    """
    unfit = ""
    call: Callable[[Array], object] = partial(observe, Model(spec))
    try:
        call = Posterior(spec)
    except SpecError as error:
        unfit = str(error).removeprefix(f"{spec.source}: ")
    if first > SLOW and not compiled:
        return first, unfit
    begin = time.process_time()
    first_call(spec.sampler.call_limit, call, theta)  # draws the random numbers of a new process
    again = time.process_time() - begin
    if again > SLOW:
        return again, unfit
    seconds: list[float] = []
    while len(seconds) < 3 and sum(seconds) < 3.0:
        begin = time.process_time()
        call(theta)
        seconds.append(time.process_time() - begin)
    return float(np.median(seconds)), unfit
