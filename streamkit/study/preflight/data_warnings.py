"""Warnings about data far from all trial streams, with the likely mistake in the data."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from streamkit.components import Measurement, Observable
from streamkit.errors import StreamkitError
from streamkit.model import Host
from streamkit.observe import UNNAMED, measure_host, measure_stream, parts_of, scatter_of
from streamkit.runfile import Spec
from streamkit.stream import IntArray, Prediction
from streamkit.study.preflight.corrections import OPPOSITE, corrected
from streamkit.study.preflight.draws import Trial

# Data are near a trial stream if the median distance is within so many errors, or within the spread of all trial
# streams: a few draws from a broad prior come no nearer.
NEAR_ERRORS = 3.0
# Smallest distances of the nearest trial stream, in errors or in spreads, for a warning: with and without a correction
# that brings the data near.
DOUBTFUL, HOPELESS = 5.0, 30.0
WRONG_SIGN = 8.0  # errors of the median datum from the stream at the prior's centre, from which on signs are tried
FEW_TRIALS = 8  # with fewer trials their spread is unknown
MOST_TRIALS = 16  # largest number of trial streams for the comparison with corrected data


@dataclass(frozen=True)
class _Measured:
    """One measurement in all trials that have it: path in the run file, predictions, a function that measures anew."""

    path: str
    measurement: Measurement
    trials: list[Trial]
    predictions: list[Prediction]
    predict: Callable[[Any, Trial], Prediction | None]


class _Distance(NamedTuple):
    """The distance of the median datum from the nearest trial stream."""

    errors: float  # in standard deviations of the likelihood, the noise of the trial stream included
    spreads: float  # in standard deviations of the predictions of all trials; 0 where they are few
    nearness: float  # in units of the larger of `NEAR_ERRORS` errors and one spread
    rank: float  # in spreads, or in predicted values where trials are few; independent of the errors of the data

    def beyond(self, limit: float) -> bool:
        """Return whether the data are farther than a limit in errors or in spreads, and not near."""
        return self.nearness > 1 and max(self.errors, self.spreads) > limit


NOWHERE = _Distance(np.nan, np.nan, np.nan, np.nan)  # without a datum or a prediction


def data_warnings(spec: Spec, trials: Sequence[Trial]) -> list[str]:
    """Return a warning for each measured quantity whose data are far from all trial streams.

    With few trials of a run file with free parameters there is no warning.
    """
    warnings = []
    for measured in _measured(spec, trials):
        if spec.names and len(measured.trials) < FEW_TRIALS:
            continue
        for name, rows in measured.measurement.quantities().items():
            distance = _distance(measured.measurement, measured.predictions, rows)
            if not distance.beyond(DOUBTFUL):
                continue
            if (correction := _correction(measured, name)) or distance.beyond(HOPELESS):
                warnings.append(_warning(measured, name, distance, correction))
    return warnings


def sign_warnings(spec: Spec, centre: Sequence[Trial]) -> list[str]:
    """Return a warning for each quantity that the stream at the prior's centre makes with the opposite sign.

    A wide prior hides a wrong sign from `data_warnings`: some of its streams come near any data. ``centre`` holds the
    trial at the prior's centre, or nothing. A sign that moves another quantity away from the stream is right.
    """
    warnings = []
    for measured in _measured(spec, centre):
        rows = measured.measurement.quantities()
        paths = {name: measured.path if len(rows) == 1 else f"{measured.path}.{name}" for name in rows}
        far = {name: _distance(measured.measurement, measured.predictions, rows[name]).errors for name in rows}
        for text, other in corrected(measured.measurement):
            if not text.startswith(OPPOSITE):
                continue
            with suppress(StreamkitError, KeyError), np.errstate(all="ignore"):
                made, turned = measured.predict(other, centre[0]), other.quantities()
                near = {name: _distance(other, [made] if made else [], turned[name]).errors for name in rows}
                if any(near[name] > max(far[name], NEAR_ERRORS) for name in rows):
                    continue
                warnings += [
                    f"{paths[name]}: the median datum is {far[name]:.0f} errors from the stream at the prior's centre, "
                    f"and {near[name]:.1f} with {text}. Is that the mistake?"
                    for name in rows
                    if far[name] > WRONG_SIGN and near[name] <= NEAR_ERRORS
                ]
    return warnings


def _measured(spec: Spec, trials: Sequence[Trial]) -> Iterator[_Measured]:
    """Yield every measurement of the streams, and every one of the host, that some trials have."""
    if not trials:
        return
    for stream, inputs in trials[0].bound.streams.items():
        having = [trial for trial in trials if stream not in trial.reasons]
        for name, observable in inputs.observables.items() if having else ():

            def measure(other: Observable, trial: Trial, stream: str = stream) -> Prediction | None:
                return measure_stream({UNNAMED: other}, trial.observation.streams[stream])

            parts = [parts_of(trial.observation.predictions[stream])[name] for trial in having]
            path = f"{spec.prefix(stream)}observable" + (f".{name}" if name != UNNAMED else "")
            yield _Measured(path, observable, having, parts, measure)
    for name, data in trials[0].bound.data.items():
        having = [trial for trial in trials if f"data.{name}" not in trial.reasons]
        parts = [trial.observation.predictions[f"data.{name}"] for trial in having]
        yield _Measured(
            f"data.{name}", data, having, parts,
            lambda other, trial: measure_host(other, Host(trial.bound.potentials, numbers=trial.bound.numbers)),
        )  # fmt: skip


def _distance(measurement: Measurement, predictions: Sequence[Prediction], rows: IntArray) -> _Distance:
    """Return the distance of some rows of the data from the nearest prediction."""
    values = np.asarray(measurement.data()[0], dtype=float)[rows]
    usable = [prediction for prediction in predictions if not prediction.why_not]
    there = np.isfinite(values)
    if not usable or not there.any():
        return NOWHERE
    mean, variance = (np.array([getattr(one, name)[rows[there]] for one in usable]) for name in ("mean", "variance"))
    away = np.abs(mean - values[there])
    errors = np.array([scatter_of([measurement], one)[rows[there]] for one in usable])
    scatter = np.hypot(errors, np.sqrt(variance))
    spread = mean.std(axis=0) if len(usable) >= FEW_TRIALS else np.zeros(there.sum())
    close = np.maximum(NEAR_ERRORS * scatter, spread)
    spreads = np.where(spread > 0, spread, np.inf)
    units = (scatter, spreads, close, np.where(spread > 0, spread, np.maximum(np.abs(mean), 1e-300)))
    return _Distance(*(float(np.median(away / unit, axis=1).min()) for unit in units))


def _warning(measured: _Measured, name: str, distance: _Distance, correction: str) -> str:
    trials = len(measured.trials)
    single = len(measured.measurement.quantities()) == 1
    path = measured.path if single else f"{measured.path}.{name}"
    streams = f"none of {trials} trial streams comes" if trials > 1 else "the trial stream does not come"
    text = f"{path}: {streams} near these data; the median datum is {distance.errors:.0f} errors away."
    if correction:
        return (
            f"{text} With {correction} the data lie among the streams. Is that the mistake, or are the data of another "
            "stream or frame?"
        )
    return f"{text} Check unit, sign, column names and frame of the data, and the priors."


def _correction(measured: _Measured, name: str) -> str:
    """Return the correction with the smallest distance of data and streams; an empty text if none makes them near.

    A correction that moves another quantity away from the streams is not returned.
    """
    rows = measured.measurement.quantities()
    before = {other: _distance(measured.measurement, measured.predictions, rows[other]) for other in rows}
    trials = measured.trials
    some = [trials[i] for i in np.unique(np.linspace(0, len(trials) - 1, MOST_TRIALS).astype(int))]
    best, least = "", np.inf
    for text, other in corrected(measured.measurement):
        try:
            with np.errstate(all="ignore"):
                each = (measured.predict(other, trial) for trial in some)
                made, rows = [one for one in each if one is not None], other.quantities()
                after = {quantity: _distance(other, made, rows[quantity]) for quantity in before}
        except (StreamkitError, KeyError):  # the measurement has no prediction with this change
            continue
        worse = any(after[quantity].nearness > max(1.0, distance.nearness) for quantity, distance in before.items())
        nearer = after[name].rank < min(least, 0.5 * before[name].rank)  # larger errors alone bring nothing nearer
        if after[name].nearness < 1 and nearer and not worse:
            best, least = text, after[name].rank
    return best
