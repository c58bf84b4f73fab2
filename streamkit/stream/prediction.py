"""The prediction of an observable, and the elements of its figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Literal

import numpy as np

from streamkit.stream.arrays import Array, IntArray


@dataclass(frozen=True)
class Mark:
    """A line or a point of a measurement in a picture of the unwrapped stream.

    Attributes
    ----------
    look
        "track" (a dotted line), "fit" (a full line), "peak" (a white circle), or "datum" (with error bars).
    x, y
        (k,) angles along the stream in degrees, leading positive, and Galactocentric radii in kpc.
    label
        Its text in a legend.
    x_error, y_error
        Standard errors of a datum, 0 for none.
    """

    look: Literal["track", "fit", "peak", "datum"]
    x: Array
    y: Array
    label: str
    x_error: float = 0.0
    y_error: float = 0.0


@dataclass(frozen=True)
class PanelData:
    """The data in a panel, and their residuals.

    Attributes
    ----------
    rows
        (k,) indices of the data among the observable's numbers.
    x, y, error
        (k,) longitudes, values and standard errors, in the units of the panel.
    pull
        (k,) data minus model, in the standard deviations that the likelihood compares with; NaN without a value.
    """

    rows: IntArray
    x: Array
    y: Array
    error: Array
    pull: Array


@dataclass(frozen=True)
class Panel:
    """A picture of particles and data on the sky.

    Attributes
    ----------
    x_label, y_label
        With units. Panels with the same label below each other share their axis.
    x, y
        (n,) every particle of the stream; NaN for none.
    marks
        Lines over the particles, in the same units; a "fit" is the model, and NaN where it has no debris.
    data
        The data; a panel of residuals is drawn below.
    """

    x_label: str
    y_label: str
    x: Array
    y: Array
    marks: tuple[Mark, ...] = ()
    data: PanelData | None = None


@dataclass(frozen=True, repr=False)
class Prediction:
    """The prediction of an observable for a stream.

    Attributes
    ----------
    names
        m names.
    mean
        (m,) predicted values, in the units of the data.
    variance
        (m,) variance of the estimate itself, from the finite number of particles.
    why_not
        Empty, or the reason (a short constant sentence) why there is no value; mean is then NaN.
    details
        Further results of the measurement, such as tracks and fits, in the observable's own form.
    parts
        The predictions that were joined, by the name of the observable; empty for one observable.
    """

    names: tuple[str, ...]
    mean: Array
    variance: Array
    why_not: str = ""
    details: dict[str, Array] = field(default_factory=dict)
    parts: dict[str, Prediction] = field(default_factory=dict)

    def __repr__(self) -> str:
        if self.why_not:
            return f"<Prediction: no value, {self.why_not}>"
        values = (
            f"{name} {mean:.5g} +- {variance**0.5:.2g}"
            for name, mean, variance in zip(self.names, self.mean, self.variance, strict=True)
        )
        return f"<Prediction: {', '.join(values)}>"

    def _repr_html_(self) -> str:
        if self.why_not:
            return f"<p>no value: {escape(self.why_not)}</p>"
        rows = zip(self.names, self.mean.tolist(), np.sqrt(self.variance).tolist(), strict=True)
        cells = (
            f"<tr><td>{escape(name)}</td><td>{mean:.5g}</td><td>{noise:.2g}</td></tr>" for name, mean, noise in rows
        )
        return f"<table><tr><th></th><th>value</th><th>own noise</th></tr>{''.join(cells)}</table>"


def join_predictions(parts: Mapping[str, Prediction], unnamed: str = "") -> Prediction:
    """Join predictions. Names become ``part.name``, except for the part called ``unnamed``.

    ``why_not`` is the reason of the first part without a value.
    """
    mean, variance = (np.concatenate([getattr(p, name) for p in parts.values()]) for name in ("mean", "variance"))
    names = tuple(each if name == unnamed else f"{name}.{each}" for name, part in parts.items() for each in part.names)
    reasons = (part.why_not if n == unnamed else f"{n}: {part.why_not}" for n, part in parts.items() if part.why_not)
    why_not = next(reasons, "")
    return Prediction(names, mean, variance, why_not, parts=dict(parts))
