"""All streams of a run on the sky: the best sample's debris with the data, in Galactic coordinates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial.distance import cdist

from streamkit.components import Observable
from streamkit.errors import ChainError, OutOfDomain
from streamkit.fit.samples.results import Results
from streamkit.fit.show.figures import remark
from streamkit.observe import parts_of
from streamkit.report import VERMILION, NotebookFigure
from streamkit.runfile import StreamInputs
from streamkit.stream import Array, Prediction, SkyFrame, Stream, sky_matrix

SIZE = (11.0, 6.0)  # inches
SHOWN = 1000  # most particles of a stream
COMPARED = 100  # some of them, to find a colour that no stream nearby has
COLOURS = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#B58900", "#56B4E9", "#6A3D9A"
NAME = 9.0  # points of a stream's name
LETTER, LINE = 0.6, 1.3  # width of a letter and height of a name, in points of its size
HALO = [patheffects.withStroke(linewidth=2.0, foreground="white")]
LATITUDE = "phi2"  # the quantity whose data are latitudes in the observable's frame


def sky(results: Results) -> Figure:
    """Draw the debris of all streams of the best sample, and the data on the sky where an observable has latitudes."""
    try:
        best = results.best_observation
    except OutOfDomain as error:
        raise ChainError(f"the streams of the best sample could not be made again: {error.reason}") from None
    bound = results.spec.bind_all(results.best())
    figure = NotebookFigure(figsize=SIZE, layout="constrained")
    axes = figure.add_subplot(projection="mollweide")
    axes.grid(color="#DDDDDD", lw=0.6)
    taken: list[tuple[float, float, float, float]] = []
    drawn: list[list[Array]] = [[] for _ in COLOURS]
    for name, stream in best.streams.items():
        debris = np.flatnonzero(~stream.bound)[:: max(int((~stream.bound).sum()) // SHOWN, 1)]
        seen = stream.seen("galactic")
        x, y = _place(seen.lon[debris], seen.lat[debris])
        colour = _colour(np.stack([x, y], axis=1)[:: max(len(x) // COMPARED, 1)], drawn)
        axes.plot(x, y, ".", color=colour, ms=1.2, alpha=0.5, mew=0, rasterized=True)
        places = list(_data(bound.streams[name], stream, best.predictions.get(name)))
        along = [np.concatenate(each) for each in zip(*places, strict=True)] if places else [x, y]
        if places:
            axes.plot(*along, "o", ms=3, mfc=colour, mec="black", mew=0.5, ls="none")
        _name(axes, name.replace("_", " "), colour, along[0], along[1], taken)
    degrees = np.arange(-150, 151, 60)
    axes.set_xticks(np.radians(degrees), [f"{-degree % 360}°" for degree in degrees.tolist()])
    axes.tick_params(labelsize=9, labelcolor="#666666")
    axes.set_xlabel("Galactic longitude and latitude; dots: debris of the best sample, circles: data", fontsize=11)
    if text := remark(results):
        axes.set_title(text, color=VERMILION, fontsize=12)
    return figure


def _colour(places: Array, drawn: list[list[Array]]) -> str:
    """Return the colour of a stream at places (n, 2): the first that is free, or that whose streams are farthest away.

    The places are added to those drawn in each colour.
    """
    apart = [min((cdist(places, each).min(initial=np.inf) for each in streams), default=np.inf) for streams in drawn]
    chosen = int(np.argmax(apart))
    drawn[chosen].append(places)
    return COLOURS[chosen]


def _place(lon: Array, lat: Array) -> tuple[Array, Array]:
    """(n,) Places in the picture of Galactic longitudes and latitudes in degrees: l = 0 in its middle, l grows left."""
    return -np.radians((lon + 180.0) % 360.0 - 180.0), np.radians(lat)


def _data(inputs: StreamInputs, stream: Stream, prediction: Prediction | None) -> Iterator[tuple[Array, Array]]:
    """Yield the places in the picture of each observable's data with latitudes."""
    if prediction is None or prediction.why_not:
        return
    parts = parts_of(prediction)
    for name, observable in inputs.observables.items():
        if (places := _latitudes(observable, stream, parts[name])) is not None:
            ra, dec, *_ = SkyFrame(sky_matrix(observable.sky_frame())).to_icrs(*places)
            lon, lat, *_ = SkyFrame(sky_matrix("galactic")).from_icrs(ra, dec)
            yield _place(lon, lat)


def _latitudes(observable: Observable, stream: Stream, prediction: Prediction) -> tuple[Array, Array] | None:
    """(k,) Longitudes and latitudes of the data in the frame of their observable; None without any."""
    rows = observable.quantities().get(LATITUDE)
    if rows is None or observable.sky_frame() is None:
        return None
    for panel in observable.panels(stream, prediction):
        if panel.data is not None and np.array_equal(panel.data.rows, rows):
            return panel.data.x, panel.data.y
    return None


def _name(
    axes: Axes, name: str, colour: str, x: Array, y: Array, taken: list[tuple[float, float, float, float]]
) -> None:
    """Write the name of a stream beside its ends or its middle, where the fewest other names are."""
    high = LINE * NAME
    wide = LETTER * NAME * len(name)
    best: tuple[float, tuple[float, float], tuple[float, float], tuple[float, float, float, float]] | None = None
    for at in (0, len(x) - 1, len(x) // 2):
        px, py = axes.transData.transform((x[at], y[at])) * 72 / axes.figure.dpi
        for dx, dy in ((0, 9), (0, -9), (0.5 * wide + 6, 0), (-0.5 * wide - 6, 0)):
            box = px + dx - 0.5 * wide, py + dy - 0.5 * high, px + dx + 0.5 * wide, py + dy + 0.5 * high
            covered = sum(_shared(box, other) for other in taken)
            if best is None or covered < best[0]:
                best = covered, (float(x[at]), float(y[at])), (dx, dy), box
    if best is not None:
        _, place, offset, box = best
        taken.append(box)
        axes.annotate(
            name, place, offset, textcoords="offset points", fontsize=NAME, color=colour, ha="center", va="center",
            path_effects=HALO, zorder=5,
        )  # fmt: skip


def _shared(one: tuple[float, float, float, float], other: tuple[float, float, float, float]) -> float:
    """Return the area that two boxes share; the boxes are (left, bottom, right, top)."""
    wide = min(one[2], other[2]) - max(one[0], other[0])
    high = min(one[3], other[3]) - max(one[1], other[1])
    return max(wide, 0.0) * max(high, 0.0)
