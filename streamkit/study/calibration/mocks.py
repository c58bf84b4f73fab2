"""Mock data of a draw of the prior: for our own fit, and as files for the fits of other methods."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from streamkit.components import Measurement
from streamkit.errors import OutOfDomain, SpecError, StreamkitError
from streamkit.model import Model, Observation
from streamkit.observe import parts_of
from streamkit.report import DamagedError, origin, save, save_table
from streamkit.runfile import Spec
from streamkit.sample import Posterior
from streamkit.stream import Array, Prediction
from streamkit.study.calibration.compared import check_truth
from streamkit.study.grid import ended_before, run_jobs

TRIES = 1000  # largest number of draws for a truth with a measurable stream
TRUTHS = "truths.ecsv"  # the parameters of every draw: the other method may not read it


@dataclass(frozen=True)
class Mock:
    """Mock data of one draw, without its truth: what another method is given.

    Attributes
    ----------
    index
        The number of the draw.
    spec
        The run file with the mock data in place of its own.
    names
        (m,) names of the data, in the order of ``x_names`` in a file of `streamkit simulate`.
    values, errors
        (m,) the data, without those that the run file lacks, and their standard errors, in the observables' units.
    covariance
        (m, m) of the errors; None where they are independent.
    """

    index: int
    spec: Spec
    names: tuple[str, ...]
    values: Array
    errors: Array
    covariance: Array | None = None


def draw_mock(spec: Spec, truth: Spec, index: int) -> tuple[Array, Mock]:
    """Return the truth's parameters of a draw, in its units, and mock data of its streams and of its host for the fit.

    Raises StreamkitError if none of a thousand truths has a stream, the truth lacks data that the fit has, a
    measurement makes no mock data, or the noise makes data that a run file may not have.
    """
    check_truth(spec, truth)
    rng = np.random.default_rng([spec.seed, 7, index])
    model = Model(truth.with_values({"seed": int(rng.integers(1 << 31))}))
    for _ in range(TRIES):
        theta = np.array([float(prior.sample(rng, 1)[0]) for prior in truth.priors])
        try:
            observation = model.observe_all(model.spec.bind_all(theta))
        except OutOfDomain:
            continue
        if any(prediction.why_not for prediction in observation.predictions.values()):
            continue
        fields = _fields(spec, truth, theta, observation, rng)
        try:
            mocked = spec.with_values(fields)
        except SpecError as error:
            raise StreamkitError(f"draw {index}: its mock data are none that a run file may have: {error}") from None
        return theta, _measured(mocked, index, observation.prediction.names)
    raise StreamkitError(f"draw {index}: none of {TRIES} points of the prior has a stream that can be measured")


def _fields(
    spec: Spec, truth: Spec, theta: Array, observation: Observation, rng: np.random.Generator
) -> dict[str, Any]:
    """Return mock data of all measurements of the fit at a truth, by the paths of their fields in the run file."""
    bound = truth.bind_all(theta)
    fields: dict[str, Any] = {}
    for stream, fitted in spec.sections.streams.items():
        parts = parts_of(observation.predictions[stream])
        for name, section in fitted.observables.items():
            fields |= _mock(bound.streams[stream].observables[name], section.path, parts[name], rng)
    for name in spec.sections.data:
        of_host = bound.data[name]
        path = truth.sections.data[name].path
        try:
            fields |= _mock(of_host, path, observation.predictions[f"data.{name}"], rng)
        except StreamkitError as error:
            message = f"{error}. Or calibrate without these data: leave [{path}] out of the run file"
            raise StreamkitError(message) from None
    return fields


def _mock(one: Measurement, path: str, prediction: Prediction, rng: np.random.Generator) -> dict[str, Any]:
    try:
        drawn = one.mock(prediction, rng)
    except StreamkitError as error:
        raise StreamkitError(f"{path}: {error}") from None
    return {f"{path}.{field}": value for field, value in drawn.items()}


def _measured(mocked: Spec, index: int, names: tuple[str, ...]) -> Mock:
    """Return the data of a run file with mock data, without missing ones."""
    data = Posterior(mocked).data
    used = np.isfinite(data.values)
    covariance = None if data.covariance is None else data.covariance[np.ix_(used, used)]
    kept = tuple(name for name, one in zip(names, used, strict=True) if one)
    return Mock(index, mocked, kept, data.values[used], data.errors[used], covariance)


def write_mocks(
    spec: Spec,
    out: Path,
    draws: int,
    workers: int = 1,
    done: Callable[[], object] = lambda: None,
    truth: Spec | None = None,
) -> str:
    """Write the mock data of every draw, and their truths in a file apart; ``done`` is called after each.

    Of each draw there is a run file ``mock_000.toml``, and a table ``mock_000.csv`` with the columns name, value and
    error; ``mock_000_covariance.csv`` too where errors are correlated. Return why draws are missing; empty without any.

    Raises StreamkitError as `draw_mock`.
    """
    out.mkdir(parents=True, exist_ok=True)
    jobs = {index: (spec, truth or spec, index, out) for index in range(draws)}
    thetas, stopped = run_jobs(_write, jobs, workers, done)
    if not thetas:
        raise ended_before(spec.source, stopped, "the first draw was finished")
    table = QTable({"draw": sorted(thetas)}, meta={**origin(spec), "digest": _digest(spec, truth)})
    drawn = truth or spec
    columns = np.array([thetas[index] for index in sorted(thetas)]).reshape(len(thetas), -1).T
    for name, unit, column in zip(drawn.names, drawn.units, columns, strict=True):
        table[name] = column * u.Unit(unit)
    save_table(out / TRUTHS, table)
    return stopped


def mock_name(index: int, what: str = "mock") -> str:
    """Return the name of a file of a draw, without its suffix."""
    return f"{what}_{index:03d}"


def _write(job: tuple[Spec, Spec, int, Path]) -> Array:
    spec, truth, index, out = job
    theta, mock = draw_mock(spec, truth, index)
    text, file = mock.spec.toml(), out / f"{mock_name(index)}.toml"
    save(file, lambda part: part.write_text(text, encoding="utf-8"))
    data = QTable({"name": list(mock.names), "value": mock.values, "error": mock.errors})
    save_table(file.with_suffix(".csv"), data, "ascii.csv")
    if (covariance := mock.covariance) is not None:
        save(out / f"{mock_name(index)}_covariance.csv", lambda part: np.savetxt(part, covariance, delimiter=","))
    return theta


def read_truths(directory: Path, spec: Spec, truth: Spec | None = None) -> dict[int, Array]:
    """Return the truth's parameters of each draw whose mock data `write_mocks` wrote, by its number.

    Raises StreamkitError if the directory has no mock data, or those of another run file.
    """
    file = directory / TRUTHS
    if not file.exists():
        raise StreamkitError(f"{directory}: holds no mock data; `streamkit calibrate --write-mocks {directory}` first")
    try:
        table = QTable.read(file, format="ascii.ecsv")
        digest = table.meta["digest"]
        names = (truth or spec).names
        columns = [table["draw"], *(table[name] for name in names)] if digest == _digest(spec, truth) else []
    except Exception as error:  # whatever astropy meets first in a damaged file
        raise DamagedError(f"{file}: is damaged: {error}") from None
    if not columns:
        raise StreamkitError(f"{file}: these mock data belong to another run file, or to other settings of it")
    numbers = [np.asarray(getattr(column, "value", column)) for column in columns]
    return dict(zip(numbers[0].tolist(), np.array(numbers[1:], dtype=float).T, strict=True))


def _digest(spec: Spec, truth: Spec | None) -> str:
    """Return what mock data depend on: the run files of the fit and of the truth, without their samplers."""
    return " ".join(each.digest(sampler=False) for each in (spec, truth) if each is not None)
