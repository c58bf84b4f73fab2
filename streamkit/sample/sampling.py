"""A sampler at work on its target: what it yields is checked, and stored with the evaluations that belong to it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np

from streamkit.components import Ensemble, Sampler, Samples
from streamkit.errors import ChainError, ComponentError
from streamkit.sample.evaluation import blob_dtype
from streamkit.sample.store.step import Step
from streamkit.sample.store.weighted import Weighted
from streamkit.sample.target import PosteriorTarget


def run_sampler(sampler: Sampler, target: PosteriorTarget) -> Iterator[Weighted]:
    """Run a sampler. Steps of a chain are stored; weighted samples are yielded with their evaluations.

    Raises ComponentError for samples of another shape, without a weight, or never evaluated.
    """
    storage = target.storage
    try:
        for state in sampler.sample(target):
            if isinstance(state, Ensemble) != storage.is_chain:
                raise ComponentError(f"sampler {sampler.kind}: yields {type(state).__name__}: a ChainSampler yields an "
                                     "Ensemble after each step, any other sampler yields Samples")  # fmt: skip
            if isinstance(state, Ensemble):
                _store(sampler, target, state)
            else:
                yield _weighted(sampler, target, state)
    finally:
        target.display.close()
        storage.write()
        if storage.chain.last is not None:
            with suppress(ChainError):  # the journal holds all steps; the runner tries again, and raises
                storage.chain.consolidate()


def _store(sampler: Sampler, target: PosteriorTarget, ensemble: Ensemble) -> None:
    """Store the start of a chain, or its next step, with its evaluations; ComponentError for another shape or type."""
    evaluations, chain = target.storage.evaluations, target.storage.chain
    points, last = np.ascontiguousarray(ensemble.points, dtype=float), chain.last
    if points.ndim != 2 or points.shape[1] != target.size or (last and points.shape != last.coords.shape):
        shape = ("walkers", target.size) if last is None else last.coords.shape
        raise ComponentError(f"sampler {sampler.kind}: yields points of shape {points.shape}, expected {shape}")
    if evaluations.missing(points):
        raise ComponentError(f"sampler {sampler.kind}: yields walkers at points that it never evaluated")
    rows = [each.row()[1:] for each in evaluations.get(points)]
    step = Step(
        0 if last is None else last.number + 1,
        points,
        ensemble.ln_probability,
        np.array(rows, dtype=blob_dtype(len(target.data.values))),
        ensemble.accepted,
        ensemble.random_state,
        target.counts() | ({"facts": ensemble.facts} if ensemble.facts else {}),
        ensemble.memory,
        ensemble.history,
    )
    with _blamed(sampler):
        chain.append(step)
    evaluations.keep_only(points)
    if last is not None:
        target.show(1)


def _weighted(sampler: Sampler, target: PosteriorTarget, samples: Samples) -> Weighted:
    """Return weighted samples with their evaluations; ComponentError for wrong shapes, weights or points."""
    storage, evaluations = target.storage, target.storage.evaluations
    points, ln_weights = np.asarray(samples.points, dtype=float), np.asarray(samples.ln_weights, dtype=float)
    if points.ndim != 2 or points.shape != (len(ln_weights), target.size) or not np.isfinite(points).all():
        raise ComponentError(f"sampler {sampler.kind}: gives points of shape {points.shape} and weights of shape "
                             f"{ln_weights.shape}, expected (n, {target.size}) and (n,), finite")  # fmt: skip
    with np.errstate(invalid="ignore"):
        used = ln_weights > -np.inf
    if not used.any() or np.isnan(ln_weights).any() or np.isposinf(ln_weights).any():
        raise ComponentError(f"sampler {sampler.kind}: gives no sample with a weight, or weights that are no numbers")
    points, dtype = np.ascontiguousarray(points[used]), blob_dtype(len(target.data.values))
    if samples.evaluations is None:
        if evaluations.missing(points):
            raise ComponentError(f"sampler {sampler.kind}: gives samples that it never evaluated")
        rows = [each.row() for each in evaluations.get(points)]
        log_prob, blobs = np.array([row[0] for row in rows]), np.array([row[1:] for row in rows], dtype=dtype)
    else:
        given = samples.evaluations
        log_prob, blobs = given.ln_probability[used], np.empty(used.sum(), dtype=dtype)
        for name in dtype.names or ():
            blobs[name] = getattr(given, name)[used]
    counts = {"calls": storage.calls, "search_calls": storage.small_calls, "reasons": storage.reasons}
    weighted = Weighted(
        points,
        ln_weights[used],
        log_prob,
        blobs,
        samples.ln_evidence,
        samples.ln_evidence_error,
        samples.missing,
        {"counts": counts | ({"facts": samples.facts} if samples.facts else {})},
        samples.verdicts,
    )
    with _blamed(sampler):
        return weighted.checked()


@contextmanager
def _blamed(sampler: Sampler) -> Iterator[None]:
    """Name the sampler in the error of a store for what cannot be stored."""
    try:
        yield
    except ComponentError as error:
        raise ComponentError(f"sampler {sampler.kind}: {error}") from None
