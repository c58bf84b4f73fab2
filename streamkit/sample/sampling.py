"""A sampler at work on its target: what it yields is checked, and stored with the evaluations that belong to it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np

from streamkit.components import Ensemble, Sampler, Samples
from streamkit.errors import ChainError, ComponentError, blamed, brief
from streamkit.sample.calls.signals import Stopped
from streamkit.sample.evaluation import blob_dtype
from streamkit.sample.store.step import Step, as_floats
from streamkit.sample.store.weighted import Weighted
from streamkit.sample.target import PosteriorTarget
from streamkit.stream import Array

SAME = 1e-6  # difference of ln p, relative to its size where that is above 1, which is rounding


def run_sampler(sampler: Sampler, target: PosteriorTarget) -> Iterator[Weighted]:
    """Run a sampler. Steps of a chain are stored; weighted samples are yielded with their evaluations.

    Raises ComponentError if the sampler fails or exits; for what no file can hold, or samples of another shape, without
    a weight, or never evaluated. The results before are stored.
    """
    storage = target.storage
    try:
        for state in _states(sampler, target):
            if not isinstance(state, Ensemble | Samples) or isinstance(state, Ensemble) != storage.is_chain:
                raise ComponentError(f"sampler {sampler.kind}: yields {type(state).__name__}: a ChainSampler yields an "
                                     "Ensemble after each step, any other sampler yields Samples")  # fmt: skip
            if isinstance(state, Ensemble):
                with _blamed(sampler):
                    _store(target, state)
            else:
                with _blamed(sampler):
                    weighted = _weighted(target, state)
                yield weighted
    finally:
        target.display.close()
        storage.write()
        if storage.chain.last is not None:
            with suppress(ChainError):  # the journal holds all steps; the runner tries again, and raises
                storage.chain.consolidate()


def _states(sampler: Sampler, target: PosteriorTarget) -> Iterator[object]:
    """Yield what a sampler yields; ComponentError if it fails, or calls ``sys.exit``."""
    end, stopped = object(), None
    with blamed(f"sampler {sampler.kind}"):
        states: Iterator[object] = iter(sampler.sample(target))
    while True:
        with blamed(f"sampler {sampler.kind}"):
            try:
                state = next(states, end)
            except Stopped as request:  # by a signal: no fault of the sampler
                stopped = request
        if stopped is not None:
            raise stopped
        if state is end:
            return
        yield state


def _store(target: PosteriorTarget, ensemble: Ensemble) -> None:
    """Store the start of a chain, or its next step, with its evaluations; ComponentError for another shape or type."""
    evaluations, chain = target.storage.evaluations, target.storage.chain
    points, last = as_floats("points", ensemble.points), chain.last
    if points.ndim != 2 or points.shape[1] != target.size or (last and points.shape != last.coords.shape):
        shape = ("walkers", target.size) if last is None else last.coords.shape
        raise ComponentError(f"yields points of shape {points.shape}, expected {shape}")
    if evaluations.missing(points):
        raise ComponentError("yields walkers at points that it never evaluated")
    rows = [each.row() for each in evaluations.get(points)]
    _check_ln_probability(ensemble.ln_probability, np.array([row[0] for row in rows]))
    step = Step(
        0 if last is None else last.number + 1,
        points,
        ensemble.ln_probability,
        np.array([row[1:] for row in rows], dtype=blob_dtype(len(target.data.values))),
        ensemble.accepted,
        ensemble.random_state,
        target.counts() | ({"facts": ensemble.facts} if ensemble.facts else {}),
        ensemble.memory,
    )
    chain.append(step)
    evaluations.keep_only(points)
    if last is not None:
        target.show(1)


def _check_ln_probability(given: Array, evaluated: Array) -> None:
    """Check that each walker has ln prior + ln likelihood of its own point; ComponentError with a wrong one."""
    given = as_floats("ln_probability", given)
    if given.shape != evaluated.shape:
        raise ComponentError(f"yields ln_probability of shape {given.shape}, expected {evaluated.shape}")
    with np.errstate(invalid="ignore"):  # infinity less infinity
        wrong = ~(np.abs(given - evaluated) <= SAME * np.maximum(np.abs(evaluated), 1.0))
    if wrong.any():
        i = int(np.argmax(wrong))
        raise ComponentError(
            f"yields ln_probability {given[i]:.10g} of walker {i}, expected ln prior + ln likelihood of its point, "
            f"which is {evaluated[i]:.10g}; it must be finite"
        )


def _weighted(target: PosteriorTarget, samples: Samples) -> Weighted:
    """Return weighted samples with their evaluations; ComponentError for wrong shapes, weights or points."""
    storage, evaluations = target.storage, target.storage.evaluations
    points, ln_weights = as_floats("points", samples.points), as_floats("ln_weights", samples.ln_weights)
    if points.ndim != 2 or (len(points), target.size) != points.shape or ln_weights.shape != points.shape[:1]:
        raise ComponentError(f"yields points of shape {points.shape} and weights of shape {ln_weights.shape}, "
                             f"expected (n, {target.size}) and (n,)")  # fmt: skip
    if not np.isfinite(points).all():
        raise ComponentError("yields points that are NaN or infinite")
    with np.errstate(invalid="ignore"):
        used = ln_weights > -np.inf
    if not used.any() or np.isnan(ln_weights).any() or np.isposinf(ln_weights).any():
        raise ComponentError("yields no sample with a weight, or weights that are no numbers")
    points, dtype = np.ascontiguousarray(points[used]), blob_dtype(len(target.data.values))
    if samples.evaluations is None:
        if evaluations.missing(points):
            raise ComponentError("yields samples that it never evaluated")
        rows = [each.row() for each in evaluations.get(points)]
        log_prob, blobs = np.array([row[0] for row in rows]), np.array([row[1:] for row in rows], dtype=dtype)
    else:
        given = samples.evaluations
        log_prob, blobs = as_floats("ln_probability", given.ln_probability)[used], np.empty(used.sum(), dtype=dtype)
        for name in dtype.names or ():
            blobs[name] = as_floats(name, getattr(given, name))[used]
        has_stream = np.isfinite(log_prob)  # the reader of the samples asks for the same sum
        sums = target.ln_prior(points) + blobs["ln_likelihood"]
        away = np.abs(sums[has_stream] - log_prob[has_stream])
        if not (away <= SAME * np.maximum(np.abs(log_prob[has_stream]), 1.0)).all():
            raise ComponentError("yields evaluations whose ln_probability is not ln prior + ln_likelihood")
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
    return weighted.checked()


@contextmanager
def _blamed(sampler: Sampler) -> Iterator[None]:
    """Name the sampler in the error for what it yields, which cannot be stored. ChainError passes."""
    try:
        yield
    except ComponentError as error:
        raise ComponentError(f"sampler {sampler.kind}: {error}") from None
    except (ValueError, TypeError, AttributeError, LookupError) as error:
        raise ComponentError(f"sampler {sampler.kind}: what it yields cannot be stored: {brief(error)}") from error
