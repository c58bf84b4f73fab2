"""Numbers along a stream that no single particle has: their common fields, picture and remark."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from streamkit import Angle, Array, Frame, Panel, PanelData, Prediction
from streamkit.builtin.observables.track.lines import ENOUGH, warning_of_gaps
from streamkit.builtin.observables.track.panels import column_panel, fine_grid

FRAME = (
    'Frame of {}: a name such as "GD1Koposov10", {{ pole = [ra, dec], origin = [ra, dec] }} in degrees, or the three '
    "rows of a matrix from ICRS."
)
Longitudes = Annotated[Frame, Field(description=FRAME.format("phi1"))]
Kernel = Annotated[
    Angle, Field(gt=0, le=45, description="Standard deviation of the kernel in phi1: half a bin of the data or less.")
]
Arm = Annotated[Literal["leading", "trailing", "both"], Field(description="Which debris is compared.")]

Data = tuple[Array, Array, Array]  # x, values and errors, (m,) each
Model = Callable[[Array], Array]  # the numbers at any x


def datum_panel(
    labels: tuple[str, str], particles: Array, data: Data, prediction: Prediction, model: Model,
    grid: Array | None = None, scatter: Array | None = None,
) -> Panel:  # fmt: skip
    """Return the panel of the numbers, with the label of x and theirs, and the places (n,) of the particles along x.

    The model is drawn on a grid of x (k,), a fine one of longitudes unless given, if there is a prediction. The pulls
    are in units of the scatter (m,), by default the errors.
    """
    x, value, error = data
    line, pull = None, np.full(len(x), np.nan)
    if not prediction.why_not:
        grid, scatter = fine_grid(x) if grid is None else grid, error if scatter is None else scatter
        line, pull = (grid, model(grid)), (value - prediction.mean) / scatter
    shown = PanelData(np.arange(len(x)), x, value, error, pull)
    return column_panel(*labels, (particles, np.full(len(particles), np.nan)), shown, line)


def gaps_along(
    subject: str, phi1: Array, prediction: Prediction, kernel: float, detail: str = "particles", least: float = ENOUGH
) -> tuple[str, ...]:
    """Return the remark on the longitudes where a detail of the prediction, (m,), says that there is no debris.

    ``subject`` has the two places "{}" for the number of these longitudes, and of all.
    """
    empty = phi1[:0] if prediction.why_not else phi1[prediction.details[detail] < least]
    return (warning_of_gaps(subject.format(len(empty), len(phi1)), empty, kernel),) if len(empty) else ()
