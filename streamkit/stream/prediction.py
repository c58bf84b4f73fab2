"""The prediction: what an observable says of a stream."""

from __future__ import annotations

from dataclasses import dataclass, field

from streamkit.stream.arrays import Array


@dataclass(frozen=True)
class Prediction:
    """What an observable says of a stream.

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
        What a plot wants to show of the measurement (tracks, fits); free-form per observable.
    """

    names: tuple[str, ...]
    mean: Array
    variance: Array
    why_not: str = ""
    details: dict[str, Array] = field(default_factory=dict)
