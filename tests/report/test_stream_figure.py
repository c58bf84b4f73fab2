"""The picture of a stream: everything in it is named, and its axes can be read however long the stream is."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from pictures import assert_readable
from runfiles import APOCENTRES

import streamkit as sk
from streamkit.report import NotebookFigure, draw_stream

PLANE = ["leading", "trailing", "bound", "orbit, last 1.5 Gyr", "progenitor", "Galactic centre"]
UNWRAPPED = ["progenitor", "smoothed track", "Gaussian fit", "fitted apocentre", "data"]


@pytest.fixture(scope="module")
def drawn():
    """Return a stream, what the observable says of it, and what it was made from."""
    spec = sk.load(APOCENTRES)
    inputs, stream = spec.bind(), sk.Model(spec).stream()
    return stream, inputs.observable.predict(stream), inputs


def names(axes):
    return [text.get_text() for text in axes.get_legend().texts]


def test_a_legend_names_everything_once(drawn, monkeypatch):
    figure = draw_stream(*drawn, note="QUICK LOOK")
    left, right = figure.axes
    assert names(left) == PLANE
    assert names(right) == UNWRAPPED
    assert_readable(figure, monkeypatch, {*PLANE, *UNWRAPPED})
    assert isinstance(figure, NotebookFigure)


def test_the_fitted_apocentre_is_seen_under_a_datum(drawn):
    axes = draw_stream(*drawn).axes[1]
    (circle, *_) = (line for line in axes.get_lines() if line.get_label() == "fitted apocentre")
    squares = [container.lines[0] for container in axes.containers]
    assert len(squares) == 2
    assert all(circle.get_markersize() > 1.5 * square.get_markersize() for square in squares)


def test_data_beyond_the_debris_are_in_the_picture(drawn):
    stream, prediction, inputs = drawn
    axes = draw_stream(replace(stream, winding=0.1 * stream.winding), prediction, inputs).axes[1]
    low, high = sorted(axes.get_xlim())
    places = np.concatenate([container.lines[0].get_xdata() for container in axes.containers])
    assert np.all((places > low) & (places < high))


@pytest.mark.parametrize("times", [1, 8, 60])
def test_the_angles_of_a_long_stream_can_be_read(drawn, times, monkeypatch):
    stream, _, _ = drawn
    figure = draw_stream(replace(stream, winding=times * stream.winding))
    assert_readable(figure, monkeypatch, {*PLANE, *UNWRAPPED})
    axes = figure.axes[1]
    FigureCanvasAgg(figure).draw()
    low, high = sorted(axes.get_xlim())
    shown = [tick for tick in axes.get_xticks() if low <= tick <= high]
    assert 3 <= len(shown) <= 9
    assert np.ptp(np.diff(shown)) == 0
