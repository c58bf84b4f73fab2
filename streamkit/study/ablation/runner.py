"""Ablation: the fields of a run file varied over a grid, each variant run on the same seeds and measured."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from streamkit import nbody
from streamkit.components import Component, LiveStripping, load_registry
from streamkit.errors import ComponentError, OutOfDomain, SpecError, StreamkitError, nearest
from streamkit.model import Model
from streamkit.runfile import Spec
from streamkit.stream import Prediction, Stream
from streamkit.study.ablation.measures import Portrait, compare, match_rate, observables, portrait_of, pulls
from streamkit.study.grid import ended_before, run_jobs, signal_of

NBODY = "N-body"  # the title of a snapshot
WARM = 64  # particles of the stream that loads the machine code before the time is measured


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

    The reference is a snapshot, a live progenitor or the stream of the first variant. ``stopped`` is the reason of an
    early end.
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


Made = tuple[Stream, Prediction | None, float]  # a stream, the prediction of its observables, the CPU seconds of both


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

    A live progenitor, such as ``restricted_nbody``, has the scheme's number of particles or the run file's, if that is
    larger. ``stream`` is the name of the stream where there are several.
    """
    inputs = spec.bind(stream=stream)
    live = _live_spec(path, spec, stream)
    if live is None and path.isidentifier() and not Path(path).exists():
        kinds = [kind for kind, entry in load_registry().entries["stripping"].items()
                 if issubclass(entry.cls, LiveStripping)]  # fmt: skip
        raise StreamkitError(
            f"the reference {path!r} is no live progenitor.{nearest(path, kinds)} Installed: {', '.join(kinds)}. A "
            "snapshot ends with .npz, .hdf5 or .h5"
        )
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

    Free parameters are at the centres of their priors. The seed of ``spec`` is the first of ``seeds`` consecutive ones.
    ``variants`` and ``reference`` come from `variants_of` and `read_reference`; without a reference, the first variant
    that has a stream is the reference. ``stream`` is the name of the compared stream. With ``match`` the particles get
    weights, so that as many are stripped at each time as in the reference. ``done`` is called after each stream. After
    an interruption the finished streams are returned.

    Raises StreamkitError with the reasons if no variant has a stream.
    """
    outcomes, name = tuple(Outcome(variant) for variant in variants), spec.stream_name(stream)
    jobs = {
        (seed, i): (variant.spec.with_values({"seed": variant.spec.seed + seed}), name)
        for seed in range(seeds)
        for i, variant in enumerate(variants)
    }
    results, stopped = run_jobs(make_stream, jobs, workers, done)
    missing = stopped if signal_of(stopped) else "no stream: its processes died (killed, or out of memory)"
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
    if first is None and signal_of(stopped):
        raise ended_before(spec.source, stopped, "the first variant was finished")
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


@dataclass(frozen=True)
class Variant:
    """One point of the grid: its label, the fields it changes, and the run file with them."""

    label: str
    values: dict[str, Any]
    spec: Spec


def variants_of(spec: Spec, vary: Mapping[str, Sequence[Any]]) -> list[Variant]:
    """Return every combination of the values, validated as in the file.

    A kind other than the run file's starts from the defaults of the kind. Fields that all kinds of a section share
    (particles, progenitor_gravity ...) keep their values. A `SpecError` names a field that does not exist, or a value
    that is not allowed, in any of the variants.
    """
    if not vary:
        raise SpecError(f"{spec.source}: nothing is varied: name a field and its values")
    last = {path: path.rpartition(".")[2] for path in vary}
    labels = {path: name if list(last.values()).count(name) == 1 else path for path, name in last.items()}
    variants = []
    for point in itertools.product(*vary.values()):
        values = dict(zip(vary, point, strict=True))
        label = ", ".join(_label(labels[path], value) for path, value in values.items())
        try:
            variants.append(Variant(label, values, varied(spec, values)))
        except SpecError as error:
            raise SpecError(f"variant {label!r}: {error}") from None
    return variants


def varied(spec: Spec, values: Mapping[str, Any]) -> Spec:
    """Return the spec with other values; a new kind drops the fields that it does not have."""
    reset: dict[str, Any] = {}
    for path, cls, _ in spec.components():
        if not issubclass(cls, Component) or values.get(f"{path}.kind", cls.kind) == cls.kind:
            continue
        base = next(each for each in cls.__mro__[1:] if issubclass(each, Component) and "kind" not in each.__dict__)
        for name, info in cls.model_fields.items():
            if name not in base.model_fields and not info.is_required():
                reset[f"{path}.{name}"] = info.get_default(call_default_factory=True)
    return (spec.with_values(reset) if reset else spec).with_values(values)


def _label(name: str, value: Any) -> str:
    """Return a short label of a change: ``mlcs``, ``without progenitor gravity``, ``sigma = 10 km/s``."""
    if isinstance(value, bool):
        return f"{'with' if value else 'without'} {name.replace('_', ' ')}"
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if name == "kind" else f"{name} = {text}"
