"""How the observables respond to each parameter, the others fixed: every one varied over its prior."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from streamkit.errors import ComponentError, OutOfDomain, SpecError, StreamkitError, nearest
from streamkit.observe import Data
from streamkit.sample import Evaluation, Posterior, Signals, Stopped, Workers
from streamkit.spec import Spec
from streamkit.stream import Array
from streamkit.study.sensitivity.curves import Curve, collect, prior_grid, without_fixed
from streamkit.units import datum_unit


@dataclass(frozen=True)
class Sensitivity:
    """All curves.

    Attributes
    ----------
    spec
        The run file.
    point
        Where the parameters are fixed, by name.
    names, units
        The m observables.
    data
        What they are compared with.
    seeds
        Streams per point.
    curves
        In the order asked for; those that were finished.
    stopped
        Why there are no others; empty if all are there.
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
        """Why there was no value, over all streams."""
        return sum((reason for curve in self.curves for reason in curve.reasons), Counter())


def chosen(spec: Spec, fields: Sequence[str]) -> tuple[str, ...]:
    """Return the parameters to vary: those named, or all.

    Raises
    ------
    SpecError
        If one is not free, or named twice.
    """
    for name in fields:
        if name not in spec.names:
            raise SpecError(
                f"{spec.source}: {name!r} is no free parameter.{nearest(name, spec.names)} "
                f"Free: {', '.join(spec.names) or 'none'}. To vary a fixed one, give it a prior: "
                f"--set '{name}={{ uniform = [low, high] }}'"
            )
        if fields.count(name) > 1:
            raise SpecError(f"{spec.source}: {name}: given twice; a parameter is varied once")
    return tuple(fields) or spec.names


def fixed_point(spec: Spec, point: Mapping[str, Any]) -> dict[str, float]:
    """Return the values of all free parameters: those of ``point``, and the centres of the other priors.

    Raises
    ------
    SpecError
        If a name is no free parameter, or a value lies outside its prior.
    """
    values = spec.bind(point).values
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
    done: Callable[[int], object] = int,
) -> Sensitivity:
    """Vary every parameter over its prior with the others fixed, on the same seeds, and measure the streams.

    An interruption, or a worker that dies, ends the work and keeps the parameters that are finished.

    Parameters
    ----------
    spec
        The run file; its seed is the first.
    point
        Where parameters are fixed, by name; the others are at the prior's centre.
    fields
        The parameters to vary; none for all.
    points
        Of each grid; the fixed one comes on top.
    seeds
        Streams per point, with consecutive seeds.
    workers
        Processes.
    done
        Called with the number of streams that were finished.

    Raises
    ------
    SpecError
        If nothing can be fitted, a parameter is not free, or the point is outside the prior.
    StreamkitError
        If there is no stream at the fixed point, or the end came before the first parameter was finished.
    ComponentError
        If a component fails at the fixed point. Where others are varied it is a reason.
    """
    names, values = chosen(spec, fields), fixed_point(spec, point or {})
    model = _Seeds(spec, seeds)
    first = model.posteriors[0]
    try:
        observables = first.predict(np.array(list(values.values())))[1].names
    except OutOfDomain as error:
        raise StreamkitError(
            f"{spec.source}: there is no stream where the parameters are fixed: {error}. Choose another place "
            "with --set"
        ) from None
    curves: list[Curve] = []
    stopped = ""
    with Workers({"full": model}, workers) as pool, Signals(pool):
        try:
            middle = pool.evaluate(_rows(spec, values, "", np.empty(1), seeds))
            done(seeds)
            for name in names:
                x = without_fixed(prior_grid(spec.priors[spec.names.index(name)], points), values[name])
                found = pool.evaluate(_rows(spec, values, name, x, seeds))
                done(len(found))
                curves.append(collect(spec, name, values[name], np.append(x, values[name]), [*found, *middle], seeds))
        except Stopped:
            stopped = "interrupted"
        except StreamkitError as error:
            stopped = str(error)
    if not curves:
        raise StreamkitError(f"{spec.source}: {stopped} before the first parameter was finished")
    units = _units(spec, observables)
    return Sensitivity(spec, values, observables, units, first.data, seeds, tuple(curves), stopped)


class _Seeds:
    """The posteriors of several seeds as one function of the seed's number and the parameters."""

    def __init__(self, spec: Spec, seeds: int) -> None:
        self.posteriors = [Posterior(spec.with_values({"seed": spec.seed + i})) for i in range(seeds)]

    def evaluate(self, row: Array) -> Evaluation:
        """Evaluate at (number of the seed, parameters); a component that fails is a reason."""
        posterior = self.posteriors[int(row[0])]
        try:
            return posterior.evaluate(row[1:])
        except ComponentError as error:
            return posterior.rejected(str(error).partition(". Parameters: ")[0])


def _rows(spec: Spec, values: Mapping[str, float], name: str, x: Array, seeds: int) -> Array:
    """(len(x) * seeds, 1 + d) What to evaluate: all seeds of the first x, then of the next; '' varies nothing."""
    theta = np.array([[at if path == name else values[path] for path in spec.names] for at in x])
    return np.column_stack([np.tile(np.arange(float(seeds)), len(x)), np.repeat(theta, seeds, axis=0)])


def _units(spec: Spec, names: Sequence[str]) -> tuple[str, ...]:
    """Return the units of the observables that are called as the run file's data are; '' for others."""
    observable = spec.parts.observable
    fields = {} if observable is None else observable.cls.model_fields
    return tuple(datum_unit(fields[name]) if name in fields else "" for name in names)
