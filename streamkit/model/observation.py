"""Measurements with their data, and the predictions of a model for all of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from streamkit.components import Measurement
from streamkit.observe import parts_of
from streamkit.runfile import ONLY
from streamkit.stream import Data, Prediction, Stream, join_predictions


@dataclass(frozen=True, eq=False)
class Measured:
    """An observable of a stream, or data of the host, with the data that predictions are compared with."""

    measurement: Measurement
    data: Data
    name: str  # the name of the observable, or of the host's data
    stream: str = ""  # the name of the stream; empty for data of the host

    @property
    def source(self) -> str:
        """The name of the prediction in `Observation.predictions` that contains the prediction of this measurement."""
        return self.stream or f"data.{self.name}"


@dataclass(frozen=True)
class Observation:
    """The streams by name, and the predictions by name: of each stream with an observable, and of ``data.NAME``."""

    streams: dict[str, Stream]
    predictions: dict[str, Prediction]

    @cached_property
    def prediction(self) -> Prediction:
        """All predictions as one, their names after the stream's name if it has one; empty without an observable."""
        if not self.predictions:
            return Prediction((), np.empty(0), np.empty(0))
        if self.predictions.keys() == {ONLY}:
            return self.predictions[ONLY]
        return join_predictions(self.predictions, ONLY)

    def prediction_of(self, measured: Measured) -> Prediction:
        """Return the prediction of one measurement."""
        prediction = self.predictions[measured.source]
        return parts_of(prediction)[measured.name] if measured.stream else prediction
