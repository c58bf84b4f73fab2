"""Trial streams over the prior: the share that the observables can measure, and their cost."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass

import numpy as np

from streamkit.errors import OutOfDomain
from streamkit.model import Model, Observation
from streamkit.report import Progress
from streamkit.runfile import ModelInputs, Spec
from streamkit.sample import first_call
from streamkit.stream import Array

TRIAL_PARTICLES = 1000  # particles of the trial streams over the prior: enough to decide whether there is a stream
BUDGET = 15.0  # CPU seconds after which no further trial stream is started


@dataclass(frozen=True)
class Trial:
    """One set of parameters with a stream that the observables can measure, and what they measure."""

    bound: ModelInputs
    observation: Observation


@dataclass(frozen=True)
class PriorDraws:
    """Trial streams of `TRIAL_PARTICLES` particles at draws from the prior."""

    draws: int  # number of draws
    good: Array  # (good, d) The draws with a stream that the observable can measure
    seconds: Array  # (good,) CPU seconds of each of them
    reasons: Counter[str]  # reasons of the other draws, with their numbers
    total: float = 0.0  # CPU seconds of all of them
    trials: tuple[Trial, ...] = ()  # the streams of the draws in ``good``, and their predictions


def observe(model: Model, theta: Array) -> tuple[Trial | None, str]:
    """Return the streams at theta (d,) with their predictions, and the reason if a value is missing.

    Raises CallTimeout if that takes too long.
    """
    try:
        bound = model.spec.bind_all(theta)
        observation = first_call(model.spec.sampler.call_limit, model.observe_all, bound)
    except OutOfDomain as error:
        return None, error.reason
    return Trial(bound, observation), "" if observation.prediction is None else observation.prediction.why_not


def try_prior_draws(spec: Spec, draws: int, progress: bool = False) -> PriorDraws:
    """Try streams with few particles at random points of the prior, drawn from the run's seed.

    No further one is begun after `BUDGET`.
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
            if begin - start > BUDGET:
                break
            done += 1
            trial, reason = observe(model, theta)
            end = time.process_time()
            if trial is None or reason:
                reasons[reason] += 1
            else:
                good.append(theta)
                trials.append(trial)
                seconds.append(end - begin)
            bar.expect(min(draws, int(done * BUDGET / max(end - start, 1e-9)) + 1))
            bar.update()
    points = np.array(good).reshape(-1, len(spec.names))
    return PriorDraws(done, points, np.array(seconds), reasons, time.process_time() - start, tuple(trials))
