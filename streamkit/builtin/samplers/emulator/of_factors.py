"""A run of several streams as the emulator sees it: its factors, and what becomes of their samples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from streamkit import Array, Evaluations, Samples, Target, Verdict
from streamkit.builtin.samplers.emulator.certificate import MOVED
from streamkit.builtin.samplers.emulator.coordinates import Space
from streamkit.builtin.samplers.emulator.factor import Factor
from streamkit.builtin.samplers.emulator.factor_starts import Known
from streamkit.builtin.samplers.emulator.factored import Factored, JointProgress
from streamkit.builtin.samplers.emulator.learn import learn_predictions
from streamkit.builtin.samplers.emulator.of_target import LikelihoodOnly, OfTarget
from streamkit.builtin.samplers.emulator.problem import Problem

MOST = 4000  # samples that are given
SUBJECT = "fresh calls beside the emulators"
RULE = "fresh calls of every stream at samples of the joint posterior, compared with what the noise makes of them"


def sample_factors(target: Target, max_calls: int, noise: bool, starts: int) -> Iterator[Samples]:
    """Yield samples of the joint posterior of the streams of a run after every round; ``max_calls`` of each stream."""
    factors = [
        Factor(each.name, *_problems(each.target), each.shared, each.own, each.target.earlier)
        for each in target.factors
    ]
    space = Space(OfTarget(target))
    target.expect(max_calls * len(factors))
    for progress in Factored(factors, space, noise, starts, target.remark, target.call_factors).run(max_calls):
        yield _samples(target, space, progress)


def _problems(target: Target) -> tuple[Problem, Problem]:
    """Return a factor with all particles and with few; they are one where these are the same."""
    full: Problem = OfTarget(target)
    small: Problem = full if target.small_is_full else OfTarget(target, small=True)
    if not target.undeclared:
        return full, small
    whole = LikelihoodOnly(full)
    return whole, whole if small is full else LikelihoodOnly(small)


def _samples(target: Target, space: Space, progress: JointProgress) -> Samples:
    """Return samples of the joint posterior, with what the emulators predict there."""
    chosen = np.linspace(0, len(progress.populations.samples) - 1, MOST).astype(int)
    y = progress.populations.samples[chosen]
    points = np.ascontiguousarray(space.back(y))
    lnl = progress.populations.terms.ln_likelihood[chosen].sum(axis=1)
    parts = [
        _predictions(each.target, known, y[:, known.factor.columns])
        for each, known in zip(target.factors, progress.known, strict=True)
    ]
    mean, variance, details = (np.concatenate(arrays, axis=1) for arrays in zip(*parts, strict=True))
    evaluations = Evaluations(target.ln_prior(points) + lnl, lnl, mean, variance, ("",) * len(y), details)
    facts = {f"stream {each.factor.name}" if len(each.factor.own) else "data of the host": row
             for each, row in zip(progress.known, _rows(progress), strict=True)}  # fmt: skip
    return Samples(
        points, np.zeros(len(y)), missing=progress.missing, verdicts=(_verdict(progress),), facts=facts,
        evaluations=evaluations,
    )  # fmt: skip


def _predictions(target: Target, known: Known, y: Array) -> tuple[Array, Array, Array]:
    """Return the emulated predictions of a factor at samples y (n, p), their variances and details."""
    emulator = known.emulated.emulator
    if target.undeclared:  # ln L is learned as a whole; calls that were made give the predictions too
        problem = OfTarget(target)
        of_data = learn_predictions(problem, known.calls.y, problem.evaluate(known.calls.theta))
        if of_data is None:
            nothing = np.full((len(y), len(target.data.values)), np.nan)
            return nothing, nothing, np.empty((len(y), 0))
        emulator = of_data
    predicted = emulator.predict(y)
    return predicted.mean, predicted.fit_variance, predicted.details


def _rows(progress: JointProgress) -> Sequence[str]:
    """Return a line for each factor: its calls, its emulator's error, its certificate, and its tension."""
    samples = progress.populations.samples
    rows = []
    for each in progress.known:
        some = samples[:: max(len(samples) // 1000, 1)][:, each.factor.columns]
        tension = each.alone - float(np.max(each.emulated.ln_likelihood(some)))
        certificate = each.certificate
        tested = "not tested" if certificate is None else "refused" if certificate.faults else "confirmed"
        fresh = f" by {certificate.calls} fresh calls" if certificate is not None else ""
        rows.append(
            f"{len(each.calls)} calls, error of the emulator {each.doubt:.2f} in ln L, {tested}{fresh}, "
            f"best ln L {max(tension, 0.0):.1f} below that of this factor alone"
        )
    return rows


def _verdict(progress: JointProgress) -> Verdict:
    """Return the verdict of the fresh calls of all factors."""
    tested = [each.certificate for each in progress.known if each.certificate is not None]
    more = "Raise sampler.max_calls and --resume, or take the sampler emcee."
    if not tested:
        sentence = f"No fresh calls have tested the emulators: {progress.missing}. {more}"
        return Verdict(SUBJECT, "do not use", "none", sentence, RULE)
    calls = sum(each.calls for each in tested)
    value = f"their trends move the posterior by {progress.trend:.2f} sd"
    if progress.missing:
        return Verdict(SUBJECT, "do not use", value, f"Not certified: {progress.missing}. {more}", RULE)
    shown, both = max(progress.trend_by_chance, MOVED), progress.populations
    sentence = (
        f"{calls} fresh calls confirm the emulators of {len(tested)} factors, each and together. A mean or a width "
        f"that is off by {shown:.2f} standard deviations would show; the noise of all calls leaves "
        f"{progress.uncertain:.2f} at most. Two populations of {both.independent:.0f} independent samples agree: R-hat "
        f"is {both.r_hat:.3f}."
    )
    return Verdict(SUBJECT, "fine", value, sentence, RULE)
