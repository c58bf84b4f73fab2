"""Calls of an earlier run that serve a new one: a stream was added, data changed, or the calls were of all streams.

A call of a stream serves where its model is the same. The digest of the run file of this stream alone says so. Where
it differs, because data have changed, some of the calls are made again: where they give the same predictions all of
them serve, and are compared with the data anew. Where data were left out, those of the others are kept.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from streamkit.runfile import DATA, ONLY, Spec
from streamkit.sample.evaluation import Evaluation
from streamkit.sample.factors import FactorPosterior, part_posteriors, whole_posterior
from streamkit.sample.store.evaluation_cache import EvaluationCache
from streamkit.sample.store.storage import Storage
from streamkit.stream import Array

LOG = logging.getLogger("streamkit")
AGAIN = 3  # calls that are made again where the digests differ
CLOSE = 1e-9  # difference of their predictions that rounding may make, relative
# Largest difference of variances and of details where data were left out, relative. An observable may pool the scatter
# of its particles over all data. That is the noise of the model's own estimate: a tenth of it hardly changes ln L.
POOLED = 0.1


def take_earlier(
    factors: Sequence[FactorPosterior], storages: dict[str, Storage], directory: Path, spec: Spec
) -> dict[str, int]:
    """Add the calls of a run in a directory, by its spec, to those of the factors; return how many serve each.

    A run of one stream is one factor, with the data of the host: its calls serve another run of one stream.

    Raises ChainError for calls that cannot be read.
    """
    taken = {}
    one = len(factors) == len(factors[0].full.spec.factors) == len(spec.factors) == 1
    there = {each.name: each for each in ([whole_posterior(spec)] if one else part_posteriors(spec))}
    joint = _joint_calls(directory, spec)
    for each in factors:
        earlier, other = storages[each.name].earlier, there.get(each.name)
        taken[each.name] = 0
        if other is None or other.full.spec.names != each.full.spec.names:
            continue
        calls = other.storage(directory)
        found = {**calls.earlier.all(), **calls.evaluations.all()}
        same = other.full.spec.digest(sampler=False) == each.full.spec.digest(sampler=False)
        if joint is not None and (same or one):
            found = {**part_of_joint(joint, list(there.values()), other), **found}
        if not same:
            fewer = len(each.full.data.values) < len(other.full.data.values)
            if fewer:
                found = _without_left_out(each, other, found)
            if not _same_predictions(each, found, POOLED if fewer else CLOSE):
                LOG.warning("%s: the calls of %s are of another model, and do not serve", directory, each.name)
                continue
            found = _compared_anew(each, found)
        earlier.take(found)
        taken[each.name] = len(found)
    return taken


def stored_streams(directory: Path, spec: Spec) -> list[tuple[FactorPosterior, Storage]]:
    """Return each stream of a run in a directory alone, by its spec, with its calls as those of an earlier run.

    Raises ChainError for calls that cannot be read.
    """
    streams = [each for each in part_posteriors(spec) if each.name != DATA]
    storages = {each.name: Storage() for each in streams}
    take_earlier(streams, storages, directory, spec)
    return [(each, storages[each.name]) for each in streams]


def _joint_calls(directory: Path, spec: Spec) -> EvaluationCache | None:
    """Return the calls of all streams together, which an earlier version made; None if there are none."""
    from streamkit.sample.calls.posterior import Posterior
    from streamkit.sample.store.storage import calls_storage

    data = Posterior(spec, emulated=True).data
    calls = calls_storage(directory, spec.digest(), len(spec.names), data.values, small=False).evaluations
    return calls if len(calls) else None


def part_of_joint(
    joint: EvaluationCache, factors: Sequence[FactorPosterior], factor: FactorPosterior
) -> dict[bytes, Evaluation]:
    """Return what calls of all factors together say of one.

    Calls that failed say nothing, as one of several streams failed; a single stream failed where its host did not.
    """
    good = {key: each for key, each in joint.all().items() if not each.reason}
    if not good:
        return {}
    first = np.frombuffer(next(iter(good)))
    widths = [each.details_at(first[each.parameters.parameters]) for each in factors]
    k = [each.name for each in factors].index(factor.name)
    data = [len(each.full.data.values) for each in factors]
    rows, columns = (slice(*list(pairwise(np.cumsum([0, *each]).tolist()))[k]) for each in (data, widths))
    found = {}
    for key, each in good.items():
        point = np.ascontiguousarray(np.frombuffer(key)[factor.parameters.parameters])
        found[point.tobytes()] = replace(
            each, mean=each.mean[rows], variance=each.variance[rows], details=each.details[columns]
        )
    found = _compared_anew(factor, found)
    return found | (_failed(joint, factors) if [each.name for each in factors] in ([ONLY], [ONLY, DATA]) else {})


def _failed(joint: EvaluationCache, factors: Sequence[FactorPosterior]) -> dict[bytes, Evaluation]:
    """Return the calls in which the only stream failed: its host can be measured there."""
    stream, *hosts = factors
    found = {}
    for key, each in joint.all().items():
        theta = np.frombuffer(key)
        if each.reason and not any(host.full.evaluate(theta[host.parameters.parameters]).reason for host in hosts):
            point = np.ascontiguousarray(theta[stream.parameters.parameters])
            found[point.tobytes()] = stream.full.rejected(each.reason)
    return found


def _without_left_out(
    factor: FactorPosterior, other: FactorPosterior, found: dict[bytes, Evaluation]
) -> dict[bytes, Evaluation]:
    """Return evaluations of a factor of an earlier run with the data that are left in it now; none if others are.

    A call that is made again tells which data are left: those with the same predicted mean.
    """
    point, before = next(((np.frombuffer(key), each) for key, each in found.items() if not each.reason), (None, None))
    if point is None or before is None or (now := factor.full.evaluate(point)).reason:
        return {}
    alike = np.isclose(now.mean[:, None], before.mean, CLOSE, 0)
    if not (alike.sum(axis=1) == 1).all():
        return {}
    rows = np.argmax(alike, axis=1)
    other.details_at(point)
    details = other.full.comparison.details_of_rows(rows)
    return {
        key: factor.full.rejected(each.reason) if each.reason else
        replace(each, mean=each.mean[rows], variance=each.variance[rows], details=each.details[details])
        for key, each in found.items()
    }  # fmt: skip


def _same_predictions(factor: FactorPosterior, found: dict[bytes, Evaluation], scatter: float) -> bool:
    """Make some of the calls again; return whether they give the same means, and the same scatter within a fraction."""
    good = [(np.frombuffer(key), each) for key, each in found.items() if not each.reason]
    for point, before in good[:: max(len(good) // AGAIN, 1)][:AGAIN]:
        now = factor.full.evaluate(point)
        pairs = [(now.mean, before.mean, CLOSE), (now.variance, before.variance, scatter),
                 (now.details, before.details, scatter)]  # fmt: skip
        if now.reason or not all(a.shape == b.shape and np.allclose(a, b, c, 0, equal_nan=True) for a, b, c in pairs):
            return False
    return bool(good)


def _compared_anew(factor: FactorPosterior, found: dict[bytes, Evaluation]) -> dict[bytes, Evaluation]:
    """Return the evaluations with the likelihood of the factor's own data and prior."""
    good = {key: each for key, each in found.items() if not each.reason}
    if not good:
        return dict(found)
    points = np.array([np.frombuffer(key) for key in good])
    mean, variance, details = (np.array([getattr(each, n) for each in good.values()]) for n in
                               ("mean", "variance", "details"))  # fmt: skip
    comparison, add_noise = factor.full.comparison, factor.full.data.add_noise
    if not comparison.knows_shapes:
        comparison.read_shapes(points[0])
    lnl = comparison.ln_likelihood(points, mean, variance if add_noise else 0.0 * variance, details)
    lnp = lnl + _ln_prior(factor, points)
    new = {key: replace(each, lnp=float(total), ln_likelihood=float(likelihood))
           for (key, each), total, likelihood in zip(good.items(), lnp, lnl, strict=True)}  # fmt: skip
    return {key: new.get(key, each) for key, each in found.items()}


def _ln_prior(factor: FactorPosterior, points: Array) -> Array:
    columns = zip(factor.full.spec.priors, points.T, strict=True)
    return np.asarray(sum(prior.lnpdf_of_many(x) for prior, x in columns))
