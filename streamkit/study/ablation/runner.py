"""Ablation: the fields of a run file varied over a grid, each variant run on the same seeds and measured."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field

from streamkit.errors import ComponentError, OutOfDomain
from streamkit.model import Model
from streamkit.observe import measure_stream
from streamkit.sample import pool
from streamkit.spec import Setup, Spec
from streamkit.stream import Prediction, Stream
from streamkit.study.ablation.grid import Variant
from streamkit.study.ablation.measures import Portrait, compare, observables, pulls
from streamkit.study.ablation.weights import match_rate

INTERRUPTED = "interrupted"
"""The reason of a variant that was not run, or not on every seed, since the user stopped it."""
WARM = 64
"""Particles of the stream that loads the machine code before the clock starts."""


@dataclass
class Outcome:
    """What became of a variant: one entry per seed that has a stream.

    Attributes
    ----------
    portraits
        By seed.
    measures
        The measures of each, by name.
    cpu
        CPU seconds of each stream with its observables.
    reasons
        Why there is none, or no observables, for the other seeds; each once.
    """

    variant: Variant
    portraits: dict[int, Portrait] = field(default_factory=dict)
    measures: dict[int, dict[str, float]] = field(default_factory=dict)
    cpu: dict[int, float] = field(default_factory=dict)
    reasons: list[str] = field(default_factory=list)

    def blame(self, reason: str) -> None:
        """Keep a reason, once."""
        if reason not in self.reasons:
            self.reasons.append(reason)

    @property
    def first(self) -> Portrait | None:
        """The portrait at the lowest seed that has a stream."""
        return self.portraits[min(self.portraits)] if self.portraits else None


@dataclass(frozen=True)
class Ablation:
    """A finished ablation.

    Attributes
    ----------
    spec
        The run file that the variants start from.
    outcomes
        In the order of the grid.
    reference
        What they were compared with; the first variant's own stream where no snapshot was given.
    external
        Whether the reference is a snapshot.
    """

    spec: Spec
    outcomes: tuple[Outcome, ...]
    reference: Portrait | None
    external: bool

    @property
    def beside(self) -> str:
        """What the variants are compared with, in words."""
        if self.external:
            return "the snapshot"
        return next((f"the variant {o.variant.label!r}" for o in self.outcomes if o.first), "nothing")


@dataclass(frozen=True)
class _Made:
    """What a worker hands back: a stream, or the reason why there is none."""

    stream: Stream | None
    prediction: Prediction | None
    cpu: float
    reason: str


def _make(spec: Spec) -> _Made:
    with suppress(OutOfDomain, ComponentError):  # the full stream says why, or does better
        _observe(spec.with_values({"stripping.particles": min(WARM, spec.bind().stripping.particles)}))
    begin = time.process_time()
    try:
        stream, prediction = _observe(spec)
    except OutOfDomain as error:
        return _Made(None, None, 0.0, f"no stream: {error.reason}")
    except ComponentError as error:
        return _Made(None, None, 0.0, f"no stream: {error}")
    return _Made(stream, prediction, time.process_time() - begin, "")


def _observe(spec: Spec) -> tuple[Stream, Prediction | None]:
    return Model(spec).observe(spec.bind())


def run_ablation(
    spec: Spec,
    variants: Sequence[Variant],
    reference: Stream | None = None,
    *,
    seeds: int = 1,
    workers: int = 1,
    match: bool = False,
    done: Callable[[], object] = lambda: None,
) -> Ablation:
    """Make every variant on the same seeds and measure it against the reference, or against the first variant.

    Free parameters stand at the centres of their priors. An interruption ends the work and keeps what is finished.

    Parameters
    ----------
    spec
        What the variants start from; its seed is the first.
    variants
        From `grid`.
    reference
        An N-body snapshot as a stream; None to compare with the first variant that has a stream.
    seeds
        Streams per variant, with consecutive seeds.
    workers
        Processes.
    match
        Whether the particles are weighed so that as many are stripped at each time as in the reference.
    done
        Called after each stream.
    """
    portrait = None if reference is None else make_portrait(reference, spec.bind())
    outcomes = tuple(Outcome(variant) for variant in variants)
    jobs = [
        (i, seed, variant.spec.with_values({"seed": variant.spec.seed + seed}))
        for seed in range(seeds)
        for i, variant in enumerate(variants)
    ]
    left = {(i, seed) for i, seed, _ in jobs}
    try:
        for i, seed, made in _results(jobs, workers):
            left.discard((i, seed))
            _keep(outcomes[i], seed, made)
            done()
    except KeyboardInterrupt:
        for i, _ in left:
            outcomes[i].blame(INTERRUPTED)
    for outcome in outcomes:
        if match and reference is not None:
            _match(outcome, reference)
        _measure(outcome, portrait, outcomes)
    shown = portrait or next((o.first for o in outcomes if o.first), None)
    return Ablation(spec, outcomes, shown, reference is not None)


def make_portrait(stream: Stream, setup: Setup) -> Portrait:
    """Return a stream with what the run file's observable says of it."""
    observable = setup.observable
    return Portrait(stream, setup, None if observable is None else measure_stream(observable, stream))


Job = tuple[int, int, Spec]


def _results(jobs: list[Job], workers: int) -> Iterator[tuple[int, int, _Made]]:
    """Yield variant, seed and what was made, as they come."""
    if workers == 1:
        yield from ((i, seed, _make(spec)) for i, seed, spec in jobs)
        return

    executor: ProcessPoolExecutor = pool(workers)
    try:
        futures = {executor.submit(_make, spec): (i, seed) for i, seed, spec in jobs}
        for future in as_completed(futures):
            try:
                made = future.result()
            except BrokenProcessPool:
                made = _Made(None, None, 0.0, "no stream: its process died (killed, or out of memory)")
            yield *futures[future], made
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


def _keep(outcome: Outcome, seed: int, made: _Made) -> None:
    if made.stream is None:
        outcome.blame(made.reason)
        return
    outcome.portraits[seed] = Portrait(made.stream, outcome.variant.spec.bind(), made.prediction)
    outcome.cpu[seed] = made.cpu
    if made.stream.bound.all():
        outcome.blame("no particle has left the progenitor")
    elif made.prediction is not None and made.prediction.why_not:
        outcome.blame(f"no observables: {made.prediction.why_not}")


def _match(outcome: Outcome, reference: Stream) -> None:
    """Give every stream the stripping rate of the reference, and measure its observables again."""
    for seed, portrait in outcome.portraits.items():
        stream = match_rate(portrait.stream, reference)
        try:
            outcome.portraits[seed] = make_portrait(stream, portrait.setup)
        except ComponentError as error:
            outcome.blame(f"no observables at the reference's stripping rate: {error}")
            outcome.portraits[seed] = Portrait(stream, portrait.setup)


def _measure(outcome: Outcome, reference: Portrait | None, outcomes: Sequence[Outcome]) -> None:
    """Fill in the measures of every seed; without a reference, each is set against the first variant's same seed."""
    for seed, portrait in outcome.portraits.items():
        other = reference or next((o.portraits[seed] for o in outcomes if seed in o.portraits), portrait)
        found = {**portrait.own(), **compare(portrait, other), **observables(portrait)}
        try:
            found |= pulls(portrait, other)
        except ComponentError as error:
            outcome.blame(f"the reference has no observables: {error}")
        outcome.measures[seed] = {**found, "cpu": outcome.cpu[seed]}
