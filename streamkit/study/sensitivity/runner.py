"""The response of the observables to each parameter, which is varied over its prior while the others are fixed."""

from __future__ import annotations

import pickle
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np

from streamkit.errors import ComponentError, OutOfDomain, SpecError, StreamkitError, nearest
from streamkit.observe import UNNAMED
from streamkit.runfile import ONLY, Spec
from streamkit.sample import Evaluation, Posterior
from streamkit.stream import Data
from streamkit.study.grid import ended_before, run_jobs
from streamkit.study.sensitivity.curves import Curve, curve_of, prior_grid, with_fixed
from streamkit.units import datum_unit


@dataclass(frozen=True)
class Sensitivity:
    """The finished curves in the requested order, and the reason if others are missing.

    With the run file, the point where the parameters are fixed, by name, the m observables with their units, the data
    that they are compared with, and the number of streams per point.
    """

    spec: Spec
    point: dict[str, float]
    names: tuple[str, ...]
    units: tuple[str, ...]
    data: Data
    seeds: int
    curves: tuple[Curve, ...]
    stopped: str = ""

    @cached_property
    def reasons(self) -> Counter[str]:
        """The reasons of missing values, over all streams."""
        return sum((reason for curve in self.curves for reason in curve.reasons), Counter())


def chosen(spec: Spec, fields: Sequence[str]) -> tuple[str, ...]:
    """Return the parameters to vary: those named, or all. A `SpecError` says which is not free, or named twice."""
    fields = [spec.path_of(name) for name in fields]
    for name in fields:
        if name not in spec.names:
            hint = nearest(name, spec.names)
            if _is_field(spec.document, name):
                hint = f" To vary a fixed one, give it a prior: --set '{name}={{ uniform = [low, high] }}'."
            raise SpecError(
                f"{spec.source}: {name!r} is no free parameter.{hint} Free: {', '.join(spec.names) or 'none'}."
            )
        if fields.count(name) > 1:
            raise SpecError(f"{spec.source}: {name}: given twice; a parameter is varied once")
    return tuple(fields) or spec.names


def _is_field(document: Any, path: str) -> bool:
    for name in path.split("."):
        if not isinstance(document, Mapping) or name not in document:
            return False
        document = document[name]
    return True


def fixed_point(spec: Spec, point: Mapping[str, Any]) -> dict[str, float]:
    """Return the values of all free parameters: those of ``point``, and the centres of the other priors.

    A `SpecError` says which name is no free parameter, or which value lies outside its prior.
    """
    values = spec.bind_all(point).values
    for name, prior, unit in zip(spec.names, spec.priors, spec.units, strict=True):
        if not np.isfinite(prior.lnpdf(values[name])):
            raise SpecError(
                f"{spec.source}: {name}: found {values[name]:g}, outside its prior, {prior.text(unit)}: no fit would "
                "go there. Choose a value inside, or --set another prior"
            )
    return values


def run_sensitivity(
    spec: Spec,
    point: Mapping[str, Any] | None = None,
    *,
    fields: Sequence[str] = (),
    points: int = 15,
    seeds: int = 1,
    workers: int = 1,
    done: Callable[[], object] = lambda: None,
) -> Sensitivity:
    """Vary every parameter over its prior with the others fixed, on the same seeds, and measure the streams.

    After an interruption, or the death of a worker, the finished parameters are returned.

    The seed of ``spec`` is the first of ``seeds`` consecutive ones. ``point`` holds the values, by name, where
    parameters are fixed; the others are at the prior's centre. ``fields`` are the parameters to vary, each over a grid
    of so many ``points`` and the fixed one; none for all. ``done`` is called after each stream.

    Raises SpecError if nothing can be fitted, a parameter is not free, or the point is outside the prior. Raises
    StreamkitError if there is no stream at the fixed point, or the end came before the first parameter was finished.
    Raises ComponentError if a component fails at the fixed point. Where others are varied it is a reason.
    """
    names, values = chosen(spec, fields), fixed_point(spec, point or {})
    packed, fixed = pickle.dumps(spec), tuple(values[name] for name in spec.names)
    first = posterior(packed, 0)
    try:
        prediction = first.observe(np.array(fixed)).prediction
    except OutOfDomain as error:
        raise StreamkitError(
            f"{spec.source}: there is no stream where the parameters are fixed: {error}. Choose another place "
            "with --set"
        ) from None
    observables = prediction.names
    grids = {}  # for each parameter: its index, its values, and all parameters at each value
    for name in names:
        i = spec.names.index(name)
        x = with_fixed(prior_grid(spec.priors[i], points), values[name])
        grids[name] = i, x, [(*fixed[:i], value, *fixed[i + 1 :]) for value in x.tolist()]
    places = [fixed, *(theta for _, _, thetas in grids.values() for theta in thetas)]
    jobs = {(theta, seed): (packed, seed, theta) for theta in places for seed in range(seeds)}  # the fixed one once
    evaluations, stopped = run_jobs(evaluate, jobs, workers, done)
    curves = []
    for name, (i, x, thetas) in grids.items():
        if all((theta, seed) in evaluations for theta in thetas for seed in range(seeds)):
            unit = spec.units[i]
            by_point = [[evaluations[at, k] for k in range(seeds)] for at in thetas]
            curves.append(curve_of(name, unit, spec.priors[i], values[name], x, by_point))
    if not curves:
        raise ended_before(spec.source, stopped, "the first parameter was finished")
    units = _units(spec, observables)
    return Sensitivity(spec, values, observables, units, first.data, seeds, tuple(curves), stopped)


@cache
def posterior(packed: bytes, seed: int) -> Posterior:
    """Return the posterior of a pickled run file at the n-th of its seeds, made once in a process."""
    spec: Spec = pickle.loads(packed)  # noqa: S301  our own, from the process that started this one
    return Posterior(spec.with_values({"seed": spec.seed + seed}))


def evaluate(job: tuple[bytes, int, tuple[float, ...]]) -> Evaluation:
    """Evaluate a run file with the n-th of its seeds at parameters (d,); a component that fails is a reason."""
    packed, seed, theta = job
    try:
        return posterior(packed, seed).evaluate(np.array(theta))
    except ComponentError as error:
        return posterior(packed, seed).rejected(str(error).partition(". Parameters: ")[0])


def _units(spec: Spec, names: Sequence[str]) -> tuple[str, ...]:
    """Return the units of the observables that are called as the run file's data are; '' for others."""
    units: dict[str, str] = {}
    for stream, parts in spec.sections.streams.items():
        for key, section in parts.observables.items():
            before = [part for part, unnamed in ((stream, ONLY), (key, UNNAMED)) if part != unnamed]
            units |= {".".join([*before, n]): datum_unit(field) for n, field in section.cls.model_fields.items()}
    for key, data in spec.sections.data.items():
        units |= {f"data.{key}.{n}": datum_unit(field) for n, field in data.cls.model_fields.items()}
    return tuple(units.get(name, "") for name in names)
