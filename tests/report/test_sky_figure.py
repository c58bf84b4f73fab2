"""The picture of a stream on the sky: data, smooth track, residuals and intervals are what they should be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from pictures import assert_readable

import streamkit as sk
from streamkit.report import draw_stream
from streamkit.stream import join_predictions
from streamkit.testing.streams import example_stream

FRAME = {"pole": [192.86, 27.13], "origin": [266.4, -28.94]}
DISTANCE = {"phi1": [-30.0, -10.0, 0.0, 20.0], "distance": [20.0, 21.0, 22.0, 19.0], "error": [1.0, 0.5, 2.0, 1.0]}
VELOCITY = {"phi1": [5.0, -10.0, 5.0], "radial_velocity": [10.0, 20.0, 30.0], "error": [2.0, 3.0, 4.0]}
RUN: dict[str, Any] = {
    "version": 1,
    "potential": {"kind": "nfw", "mass": 1e12, "rs": 20},
    "progenitor": {
        "kind": "plummer", "mass": 1e7, "radius": 0.1, "x": 20, "y": 0, "z": 10, "vx": 0, "vy": 120, "vz": 0,
        "lookback": 2,
    },
    "stripping": {"kind": "mlcs", "particles": 300},
    "observable": {
        "sky": {
            "kind": "track", "frame": FRAME, "kernel": 5, "distance": DISTANCE, "radial_velocity": VELOCITY,
            "stars": ["radial_velocity"], "radial_velocity_dispersion": 5,
        },
        "turn": {"kind": "apocentres", "leading": [30, 1]},
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def drawn() -> tuple[sk.Stream, sk.Prediction, Any]:
    spec = sk.load(RUN)
    inputs = spec.bind()
    stream = example_stream()
    parts = {name: each.predict(stream) for name, each in inputs.observables.items()}
    return stream, join_predictions(parts), inputs


def pairs(axes: list[Axes]) -> list[tuple[Axes, Axes]]:
    """The panels of the columns, each with its residuals."""
    return list(zip(axes[0:4:2], axes[1:4:2], strict=True))


def test_residuals_are_those_of_the_likelihood(drawn: Any) -> None:
    """Means have the errors of the data; stars also the spread of the debris and the extra dispersion."""
    figure = draw_stream(*drawn)
    prediction = drawn[1].parts["sky"]
    (_, first), (_, second) = pairs(figure.axes)
    expected = (np.array(DISTANCE["distance"]) - prediction.mean[:4]) / DISTANCE["error"]
    assert first.lines[-1].get_xydata() == pytest.approx(np.array([DISTANCE["phi1"], expected]).T)
    sigma = np.sqrt(np.square(VELOCITY["error"]) + 25 + prediction.details["spread"][4:] ** 2)
    expected = (np.array(VELOCITY["radial_velocity"]) - prediction.mean[4:]) / sigma
    assert second.lines[-1].get_xydata() == pytest.approx(np.array([VELOCITY["phi1"], expected]).T)
    for axes, line in ((first, first.lines[-1]), (second, second.lines[-1])):
        assert np.abs(axes.get_ylim()).min() > np.abs(line.get_ydata()).max()


@pytest.mark.parametrize("observable", ["sky", "turn"])
def test_the_picture_for_one_column_of_a_journal_can_be_read(
    drawn: Any, observable: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the sky, and unwrapped: 3.4 inches wide, with the residuals of the wide picture."""
    stream, prediction, _ = drawn
    one = sk.load(RUN | {"observable": RUN["observable"][observable]}).bind()
    figure = draw_stream(stream, prediction.parts[observable], one, "not converged", column=True)
    assert figure.get_figwidth() == pytest.approx(3.4)
    if observable == "turn":
        assert len(figure.axes) == 2
        return
    assert_readable(figure, monkeypatch)
    wide = draw_stream(*drawn)
    for narrow, usual in zip(pairs(figure.axes), pairs(wide.axes), strict=True):
        residuals = [axes.lines[-1].get_xydata() for axes in (narrow[1], usual[1])]
        np.testing.assert_allclose(residuals[0], residuals[1])


def test_the_track_is_drawn_on_a_fine_grid_through_the_predictions(drawn: Any) -> None:
    prediction = drawn[1].parts["sky"]
    start = 0
    for (axes, _), table in zip(pairs(draw_stream(*drawn).axes), (DISTANCE, VELOCITY), strict=True):
        (track,) = (line for line in axes.lines if line.get_label() == "fitted track")
        x, y = track.get_data()
        assert len(x) > 150
        stop = start + len(table["phi1"])
        for at, mean in zip(table["phi1"], prediction.mean[start:stop], strict=True):
            here = y[x == at]
            assert np.isnan(here).all() or here == pytest.approx(mean, rel=1e-3)
        start = stop


@pytest.mark.slow
def test_all_panels_share_their_longitudes_and_everything_can_be_read(drawn: Any, monkeypatch: Any) -> None:
    figure = draw_stream(*drawn, note="QUICK LOOK")
    columns = [axes for pair in pairs(figure.axes) for axes in pair]
    assert len({axes.get_xlim() for axes in columns}) == 1
    low, high = columns[0].get_xlim()
    assert low < -30
    assert high > 20
    assert [axes.get_ylabel().split("\n")[0] for axes in columns[::2]] == ["distance", "$v_r$"]
    assert [bool(axes.get_xlabel()) for axes in columns] == [False, False, False, True]
    unwrapped = figure.axes[5]
    inside = {text.get_text() for text in unwrapped.get_legend().texts}
    texts = assert_readable(figure, monkeypatch, inside)
    assert {"data", "fitted track", "leading", "trailing", "Galactic centre", "QUICK LOOK"} <= set(texts)


def test_intervals_are_about_the_track_at_the_data(drawn: Any) -> None:
    stream, prediction, inputs = drawn
    width = np.arange(1.0, len(prediction.mean) + 1)
    figure = draw_stream(stream, prediction, inputs, "", {"95 %": prediction.mean + np.array([[-1], [2.0]]) * width})
    axes = figure.axes[0]
    (band,) = (part for part in axes.collections if isinstance(part, PolyCollection))
    edge = np.concatenate([path.vertices for path in band.get_paths()])
    k = 1  # the second distance: the interval is from 2 below to 4 above
    here = edge[np.isclose(edge[:, 0], DISTANCE["phi1"][k]), 1]
    assert [here.min(), here.max()] == pytest.approx(prediction.mean[k] + np.array([-2, 4]), abs=0.02)
    assert edge[:, 0].min() >= -30
    assert edge[:, 0].max() <= 20


def test_a_stream_without_lines_shows_the_data(drawn: Any) -> None:
    stream, _, inputs = drawn
    inputs = replace(inputs, observables={"observable": inputs.observables["sky"]})
    bound = replace(stream, bound=np.ones(len(stream.bound), dtype=bool))
    figure = draw_stream(bound, inputs.observables["observable"].predict(bound), inputs)
    for axes, below in pairs(figure.axes):
        assert axes.containers
        assert "fitted track" not in axes.get_legend_handles_labels()[1]
        assert len(below.lines) == 1  # the zero alone
