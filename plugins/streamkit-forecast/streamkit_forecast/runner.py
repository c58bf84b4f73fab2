"""The forecast of a run file: bounds of every quantity by stream, together, and with data that do not exist yet."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from streamkit import Array, Spec, SpecError
from streamkit.runfile import DATA, Source, as_spec
from streamkit_forecast.coordinates import Coordinates, coordinates_at
from streamkit_forecast.information import Source as Informed
from streamkit_forecast.information import covariance, whitened
from streamkit_forecast.one_more import Gain, gains_of, one_more_of
from streamkit_forecast.predict import ONE_MORE, Added
from streamkit_forecast.quantities import Quantity, quantities_at
from streamkit_forecast.slopes import Search, Slopes, slopes_of
from streamkit_forecast.surveys import Survey, added_by, beyond, called

RADII = (10.0, 20.0, 50.0)  # kpc
PRIORS, TOGETHER = "priors alone", "all together"
SEEDS = 8
FEWEST = 3  # seeds that give an error


@dataclass(frozen=True)
class Chosen:
    """Some of the data: those of some streams (None: of all, and of the host), and with them some of the surveys."""

    sources: tuple[str, ...] | None = None
    surveys: tuple[str, ...] = ()


@dataclass(frozen=True)
class Bound:
    """The standard deviations (q,) of all quantities by some data and the priors, and the errors (q,) of these."""

    data: str
    sd: Array
    error: Array


@dataclass(frozen=True, eq=False)
class Forecast:
    """A finished forecast.

    Attributes
    ----------
    spec, at
        The run file, and the coordinates about the place of the forecast.
    quantities
        What is forecast.
    slopes
        Of each stream, and of the data of the host.
    surveys
        The names of the surveys that were added.
    warnings
        Sentences about surveys that are in part where there is no star.
    """

    spec: Spec
    at: Coordinates
    quantities: list[Quantity]
    slopes: list[Slopes]
    surveys: tuple[str, ...]
    warnings: tuple[str, ...] = ()

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters by name at the place of the forecast."""
        return dict(zip(self.spec.names, self.at.parameters(self.at.centre).tolist(), strict=True))

    @cached_property
    def sources(self) -> list[Informed]:
        """The whitened slopes of each stream, and of the data of the host."""
        noise = self.spec.likelihood.noise == "add"
        return [Informed(whitened(each, noise), each.which, self.at.sd[each.which]) for each in self.slopes]

    @property
    def seeds(self) -> int:
        """The number of sets of random numbers."""
        return len(self.slopes[0].of_mean)

    def covariance(self, data: Chosen = Chosen(), seeds: Sequence[int] | None = None) -> Array:
        """(d, d) Return the covariance of the coordinates by some of the data and the priors."""
        d = len(self.at.centre)
        total = np.zeros((d, d))
        for slopes, source in zip(self.slopes, self.sources, strict=True):
            if data.sources is None or slopes.source in data.sources:
                rows = slopes.rows(lambda part: not part.added or part.name in data.surveys)
                total += source.information(rows, range(self.seeds) if seeds is None else seeds, d)
        return covariance(total, self.at.sd)

    def bound(self, name: str, data: Chosen) -> Bound:
        """Return the bounds by some of the data, with their errors by leaving out one seed after the other."""
        sd = self._sds(data, range(self.seeds))
        if self.seeds < FEWEST:
            return Bound(name, sd, np.full(len(sd), np.nan))
        without = [[k for k in range(self.seeds) if k != left] for left in range(self.seeds)]
        each = np.array([self._sds(data, seeds) for seeds in without])
        return Bound(name, sd, np.sqrt((self.seeds - 1) * each.var(axis=0)))

    def _sds(self, data: Chosen, seeds: Sequence[int]) -> Array:
        found = self.covariance(data, seeds)
        return np.array([quantity.sd(found) for quantity in self.quantities])

    @cached_property
    def bounds(self) -> list[Bound]:
        """By the priors alone, each stream, the data of the host, all together, and all with each survey."""
        chosen = {PRIORS: Chosen(())}
        for one in self.slopes:
            shown, names = called(one.source), {part.name for part in one.parts if part.added}
            if any(not part.added for part in one.parts):
                chosen[shown] = Chosen((one.source,))
            chosen |= {f"{shown} with {name}": Chosen((one.source,), (name,)) for name in self.surveys if name in names}
        if len(self.slopes) > 1:
            chosen[TOGETHER] = Chosen()
            chosen |= {f"{TOGETHER}, with {name}": Chosen(None, (name,)) for name in self.surveys}
        if len(self.surveys) > 1:
            chosen[f"{TOGETHER}, with every survey"] = Chosen(None, self.surveys)
        return [self.bound(name, data) for name, data in chosen.items()]

    @cached_property
    def gains(self) -> list[Gain]:
        """What one more datum at each longitude would give, beside all data of the run file."""
        found = self.covariance()
        return [gain for one in self.slopes for gain in gains_of(one, found, self.quantities)]


def forecast(
    run_file: Source,
    point: Mapping[str, Any] | None = None,
    *,
    surveys: Mapping[str, Survey] | None = None,
    radii: Sequence[float] = RADII,
    errors: Mapping[str, float] | None = None,
    seeds: int = SEEDS,
    workers: int = 1,
    where: str = "surveys",
    done: Callable[[], object] = lambda: None,
) -> Forecast:
    """Forecast what the data of a run file, and surveys added to them, tell.

    Parameters
    ----------
    run_file
        A spec, the path of a run file, or a mapping of the same form.
    point
        Values of parameters, by name, where the forecast is made; the others are at the prior's centre.
    surveys
        Data that do not exist yet, by name.
    radii
        Radii in kpc of masses and flattenings.
    errors
        Errors of one more datum, by column; otherwise the typical one of the stream's own, or a survey's of today.
    seeds
        Sets of random numbers for the slopes. Two are needed for slopes without bias, three for an error.
    workers
        Processes. Nothing depends on their number.
    where
        The name of the file of surveys, for messages.
    done
        Called after each call of the model.

    Raises SpecError for a run file without a prior, a wrong name, a point outside the priors or a survey where there is
    no star; StreamkitError where there is no stream.
    """
    spec = as_spec(run_file)
    if not spec.names:
        raise SpecError(f"{spec.source}: no field has a prior: there is nothing to forecast")
    theta = np.array(list(spec.bind_all(dict(point or {})).values.values()))
    at = coordinates_at(spec, theta)
    given = dict(surveys or {})
    added = added_by(spec, theta, given, where)
    warnings = beyond(spec, theta, added, where)
    for name in spec.streams:
        if extra := one_more_of(spec, name, theta, dict(errors or {})):
            added.setdefault(name, {})[ONE_MORE] = extra
    searches = [
        Search(spec, part.name, part.parameters, at, added)
        for part in spec.parts
        if _is_measured(spec, part.name, added)
    ]
    if not searches:
        raise SpecError(f"{spec.source}: nothing is measured: there is no observable, no data, and no survey was added")
    shared = np.array(sorted(set(np.concatenate([part.shared for part in spec.parts]).tolist())), dtype=int)
    quantities = quantities_at(spec, at, shared, radii)
    if not quantities:
        raise SpecError(f"{spec.source}: no number of the host has a prior, so its mass is known; give one a prior")

    def together(slopes: list[Slopes]) -> Array:
        return Forecast(spec, at, quantities, slopes, tuple(given)).covariance(Chosen(None, tuple(given)))

    slopes = slopes_of(searches, together, seeds, workers, done)
    return Forecast(spec, at, quantities, slopes, tuple(given), tuple(warnings))


def _is_measured(spec: Spec, source: str, added: Added) -> bool:
    if source == DATA:
        return bool(spec.sections.data)
    return bool(spec.sections.streams[source].observables or added.get(source))
