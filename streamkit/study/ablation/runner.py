"""Ablation: the fields of a run file varied over a grid, each variant run on the same seeds and measured."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from streamkit import nbody
from streamkit.components import LiveStripping
from streamkit.errors import ComponentError, OutOfDomain, SpecError, StreamkitError
from streamkit.model import Model
from streamkit.runfile import Spec
from streamkit.stream import Prediction, Stream
from streamkit.study.ablation.measures import Portrait, compare, match_rate, observables, portrait_of, pulls
from streamkit.study.ablation.variants import Variant, varied
from streamkit.study.grid import INTERRUPTED, run_jobs

NBODY = "N-body"  # the title of a snapshot
WARM = 64  # particles of the stream that loads the machine code before the clock starts


@dataclass
class Outcome:
    """The result of a variant: by seed, portraits and measures of its streams; reasons of missing streams.

    Each reason is listed once. A stream without observables has a reason too.
    """

    variant: Variant
    portraits: dict[int, Portrait] = field(default_factory=dict)
    measures: dict[int, dict[str, float]] = field(default_factory=dict)
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
    """A finished ablation: the run file that the variants start from, and their outcomes in the grid's order.

    The reference is a snapshot or a live progenitor, or the first variant's own stream. ``stopped`` says why it ended
    early.
    """

    spec: Spec
    outcomes: tuple[Outcome, ...]
    reference: Portrait
    stopped: str = ""

    @property
    def beside(self) -> str:
        """The reference of the comparison, in words."""
        if self.reference.title:
            return "the snapshot" if self.reference.title == NBODY else f"a live progenitor by {self.reference.title}"
        return next(f"the variant {o.variant.label!r}" for o in self.outcomes if o.first)


Made = tuple[Stream, Prediction | None, float]  # a stream, what the observable says of it, and the CPU seconds of both


def make_stream(job: tuple[Spec, str]) -> Made | str:
    """Return what a run file gives for the stream of this name at the centres of its priors, or why there is none."""
    spec, name = job
    small = spec.with_particles(WARM)
    with suppress(OutOfDomain, ComponentError):  # the full stream gives the reason, or succeeds
        Model(small).observe(small.bind(stream=name))
    begin = time.process_time()
    try:
        made = Model(spec).observe(spec.bind(stream=name))
    except OutOfDomain as error:
        return f"no stream: {error.reason}"
    except ComponentError as error:
        return f"no stream: {error}"
    return *made, time.process_time() - begin


def read_reference(path: str, spec: Spec, stream: str | None = None) -> Portrait:
    """Return the reference of an ablation: an N-body snapshot, or the stream of a live progenitor by its kind.

    The latter, such as ``restricted_nbody``, has the scheme's own number of particles or the run file's, if that is
    larger. Of the stream of this name where there are several.
    """
    inputs = spec.bind(stream=stream)
    live = _live_spec(path, spec, stream)
    try:
        if live is not None:
            made, prediction = Model(live).observe(live.bind(stream=stream))
            return Portrait(made, inputs, prediction, path)
        return portrait_of(nbody.as_stream(nbody.read_snapshot(path), inputs), inputs, title=NBODY)
    except OutOfDomain as error:
        raise StreamkitError(
            f"{spec.source}: the progenitor has no orbit to compare the reference with: {error}"
        ) from None


def _live_spec(kind: str, spec: Spec, stream: str | None) -> Spec | None:
    """Return the run file with a live progenitor of this kind; None if it names no such scheme."""
    if not kind.isidentifier():
        return None
    section = f"{spec.prefix(stream)}stripping"
    try:
        live = varied(spec, {f"{section}.kind": kind})
    except SpecError:
        return None
    scheme = live.bind(stream=stream).stripping
    if not isinstance(scheme, LiveStripping):
        return None
    fewest = int(type(scheme).model_fields["particles"].default)
    return live.with_values({f"{section}.particles": max(scheme.particles, fewest)})


def run_ablation(
    spec: Spec,
    variants: Sequence[Variant],
    reference: Portrait | None = None,
    *,
    stream: str | None = None,
    seeds: int = 1,
    workers: int = 1,
    match: bool = False,
    done: Callable[[], object] = lambda: None,
) -> Ablation:
    """Make every variant on the same seeds and measure it against the reference, or against the first variant.

    Free parameters stand at the centres of their priors. The seed of ``spec`` is the first of ``seeds`` consecutive
    ones. ``variants`` and ``reference`` are those of `variants_of` and `read_reference`; without the latter, the first
    variant that has a stream is the one. ``stream`` is the name of the stream that is compared. With ``match`` the
    particles are weighed so that as many are stripped at each time as in the reference. ``done`` is called after each
    stream. After an interruption the finished streams are returned.

    Raises StreamkitError with the reasons if no variant has a stream.
    """
    outcomes, name = tuple(Outcome(variant) for variant in variants), spec.stream_name(stream)
    jobs = {
        (seed, i): (variant.spec.with_values({"seed": variant.spec.seed + seed}), name)
        for seed in range(seeds)
        for i, variant in enumerate(variants)
    }
    results, stopped = run_jobs(make_stream, jobs, workers, done)
    missing = INTERRUPTED if stopped == INTERRUPTED else "no stream: its processes died (killed, or out of memory)"
    cpu = {}
    for (seed, i), job in jobs.items():
        made = results.get((seed, i), missing)
        if isinstance(made, str):
            outcomes[i].blame(made)
        else:
            cpu[seed, i] = made[2]
            _keep(outcomes[i], seed, Portrait(made[0], job[0].bind(stream=name), made[1]), reference if match else None)
    for i, outcome in enumerate(outcomes):
        for seed, portrait in outcome.portraits.items():
            other = reference or next(o.portraits[seed] for o in outcomes if seed in o.portraits)
            measures = {**portrait.measures(), **compare(portrait, other), **observables(portrait)}
            try:
                measures |= pulls(portrait, other)
            except ComponentError as error:
                outcome.blame(f"the reference has no observables: {error}")
            outcome.measures[seed] = {**measures, "cpu": cpu[seed, i]}
    first = next((outcome.first for outcome in outcomes if outcome.first), None)
    if first is None:
        reasons = "; ".join(f"{o.variant.label}: {', '.join(o.reasons)}" for o in outcomes)
        raise StreamkitError(f"{spec.source}: no variant has a stream. {reasons}")
    return Ablation(spec, outcomes, reference or first, stopped)


def _keep(outcome: Outcome, seed: int, portrait: Portrait, rate: Portrait | None) -> None:
    """Keep a stream, with the stripping rate of another one if it is given and observables measured again."""
    if portrait.stream.bound.all():
        outcome.blame("no particle has left the progenitor")
    elif portrait.prediction is not None and portrait.prediction.why_not:
        outcome.blame(f"no observables: {portrait.prediction.why_not}")
    if rate is not None:
        stream = match_rate(portrait.stream, rate.stream)
        try:
            portrait = portrait_of(stream, portrait.inputs)
        except ComponentError as error:
            outcome.blame(f"no observables at the reference's stripping rate: {error}")
            portrait = Portrait(stream, portrait.inputs)
    outcome.portraits[seed] = portrait
