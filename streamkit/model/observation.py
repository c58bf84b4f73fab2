"""The result of one call of the model: streams and predictions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from streamkit.runfile import ONLY
from streamkit.stream import Prediction, Stream, join_predictions


@dataclass(frozen=True)
class Observation:
    """The streams by name, and the predictions: of each stream with an observable, and of ``data.NAME``."""

    streams: dict[str, Stream]
    predictions: dict[str, Prediction]

    @cached_property
    def prediction(self) -> Prediction | None:
        """All predictions as one, their names after that of the stream if it has one; None without an observable."""
        if self.predictions.keys() <= {ONLY}:
            return self.predictions.get(ONLY)
        return join_predictions(self.predictions, ONLY)
