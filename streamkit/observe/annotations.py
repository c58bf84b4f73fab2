"""Annotations of observables: marks and panels for figures, warnings, and the radii of the data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from streamkit.components import Measurement, Observable
from streamkit.observe.measure import UNNAMED, parts_of
from streamkit.stream import Frame, Mark, Panel, Prediction, Stream


def marks_of(observables: Mapping[str, Observable], prediction: Prediction) -> tuple[Mark, ...]:
    """Return the marks of all measurements for a picture of the unwrapped stream."""
    parts = parts_of(prediction)
    return tuple(mark for name, each in observables.items() for mark in each.marks(parts[name]))


def panels_of(observables: Mapping[str, Observable], stream: Stream, prediction: Prediction) -> tuple[Panel, ...]:
    """Return the pictures on the sky of all observables; the rows of their data are those of the whole prediction."""
    parts, panels, start = parts_of(prediction), [], 0
    for name, each in observables.items():
        for panel in each.panels(stream, parts[name]):
            data = panel.data
            panels.append(panel if data is None else replace(panel, data=replace(data, rows=data.rows + start)))
        start += len(parts[name].names)
    return tuple(panels)


def frame_of(observables: Mapping[str, Observable]) -> Frame:
    """Return the frame on the sky of the first observable that has one; None without any."""
    return next((frame for each in observables.values() if (frame := each.sky_frame()) is not None), None)


def remarks_of(observables: Mapping[str, Observable], prediction: Prediction) -> tuple[str, ...]:
    """Return the warnings of all observables, each with the name of its observable if it has one."""
    parts = parts_of(prediction)
    return tuple(f"{_before(name)}{text}" for name, each in observables.items() for text in each.remarks(parts[name]))


def radii_of(observables: Mapping[str, Measurement]) -> dict[str, float]:
    """Return the Galactocentric radii in kpc of the data, by name."""
    return {
        f"{_before(name)}{label}": radius
        for name, each in observables.items()
        for label, radius in each.radii().items()
    }


def _before(name: str) -> str:
    return "" if name == UNNAMED else f"{name}: "
