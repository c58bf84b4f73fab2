"""The predictions of a run for its data, from the predictions that it stored with its samples."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from streamkit.components import Measurement
from streamkit.fit.judge.predictive import Predictive
from streamkit.fit.samples.draws import Draws
from streamkit.model import Observation
from streamkit.observe import scatter_of
from streamkit.runfile import Spec
from streamkit.sample import Posterior
from streamkit.stream import Array, Data

MOST = 2000  # largest number of samples whose predictions are compared with the data
COMPARED = 5  # number of samples whose ln likelihood is compared with a Gaussian's


def stored_predictions(draws: Draws) -> NDArray[Any] | None:
    """(n,) What was predicted at some of the samples, mean and variance; None if the run kept no predictions."""
    if draws.predictions is None:
        return None
    kept = draws.predictions.ravel()
    return np.asarray(kept[np.linspace(0, len(kept) - 1, min(len(kept), MOST)).astype(int)])


def predictive(spec: Spec, draws: Draws, best: Observation | None) -> Predictive | None:
    """Return data and predictions of a run; None if the run kept no predictions.

    ``best`` are the streams of the best sample with their predictions; None if they cannot be measured.
    """
    kept = stored_predictions(draws)
    if kept is None:
        return None
    data = Posterior(spec).data
    used = np.isfinite(data.values)
    kept = kept[np.isfinite(kept["mean"][:, used]).all(axis=1) & np.isfinite(kept["variance"][:, used]).all(axis=1)]
    if not len(kept):
        return None
    some = kept[:COMPARED]
    expected = [data.gaussian(row["mean"], row["variance"]) for row in some]
    names, scatter = _at_best(spec, draws, best, data)
    return Predictive(
        tuple(name for name, there in zip(names, used, strict=True) if there),
        data.values[used],
        data.errors[used],
        kept["mean"][:, used],
        kept["variance"][:, used],
        data.add_noise,
        bool(np.allclose(some["ln_likelihood"], expected, rtol=1e-6)),
        scatter[used],
    )


def _at_best(
    spec: Spec, draws: Draws, best: Observation | None, data: Data
) -> tuple[tuple[str, ...], Array]:
    """(m,) The names of all data, and their standard deviations about the best sample's predictions."""
    if best is None or best.prediction is None:
        return tuple(f"datum {i + 1}" for i in range(len(data.values))), data.errors
    bound = spec.bind_all(dict(zip(spec.names, draws.best.tolist(), strict=True)))
    measured: dict[str, list[Measurement]] = {
        name: list(inputs.observables.values()) for name, inputs in bound.streams.items()
    }
    measured |= {f"data.{name}": [datum] for name, datum in bound.data.items()}
    scatter = [scatter_of(measured[name], prediction) for name, prediction in best.predictions.items()]
    return best.prediction.names, np.concatenate(scatter)


def predicted_intervals(draws: Draws, best: Observation, stream: str) -> dict[str, Array]:
    """Return the 95 % and 68 % intervals (2, m) of what the model predicts of one stream; none if it was not kept."""
    kept, predictions = stored_predictions(draws), best.predictions
    if kept is None or stream not in predictions:
        return {}
    start = sum(len(predictions[name].names) for name in list(predictions)[: list(predictions).index(stream)])
    mean = kept["mean"][:, start : start + len(predictions[stream].names)]
    finite = mean[np.isfinite(mean).all(axis=1)]
    if not len(finite):
        return {}
    return {name: np.percentile(finite, ends, axis=0) for name, ends in (("95 %", (2.5, 97.5)), ("68 %", (16, 84)))}
