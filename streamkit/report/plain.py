"""Results as plain values and as JSON, for programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic_core import to_json

from streamkit.components import Measurement
from streamkit.stream import Prediction
from streamkit.units import spelled

if TYPE_CHECKING:
    from astropy.table import QTable


def as_json(value: Any) -> str:
    """Return JSON text of mappings, sequences, arrays and numbers; what is no finite number is null."""
    return to_json(value, indent=2, inf_nan_mode="null", fallback=lambda each: each.tolist()).decode()


def table_record(table: QTable) -> dict[str, Any]:
    """Return the rows of a table as mappings of plain numbers, and the units of its columns."""
    units = {name: spelled(table[name].unit) for name in table.colnames if table[name].unit is not None}
    columns = [getattr(table[name], "value", table[name]) for name in table.colnames]
    rows = [dict(zip(table.colnames, row, strict=True)) for row in zip(*columns, strict=True)]
    return {"units": units, "rows": rows}


def prediction_record(measured: Sequence[Measurement], prediction: Prediction | None) -> dict[str, Any]:
    """Return what is predicted of each datum beside it: model, own noise, data, error; or why there is no value."""
    if prediction is None or not measured:
        return {}
    if prediction.why_not:
        return {"why_not": prediction.why_not}
    data, errors = np.concatenate([each.data() for each in measured], axis=1)
    rows = zip(prediction.names, prediction.mean, np.sqrt(prediction.variance), data, errors, strict=True)
    keys = "model", "own_noise", "data", "error"
    return {name: dict(zip(keys, numbers, strict=True)) for name, *numbers in rows}
