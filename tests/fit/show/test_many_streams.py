"""A run of many streams: a row for each, pictures of what they share, all streams on one sky, and a page."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from html_page import Page
from pictures import assert_readable, drawn_texts
from runfiles import several
from synthetic import synthetic

import streamkit as sk
from streamkit.fit.judge.goodness import Sampled, goodness
from streamkit.fit.judge.predictive import Predictive
from streamkit.fit.samples.tables import stream_table
from streamkit.fit.show.corner import corner
from streamkit.fit.show.figures import parameters_of, priors, traces
from streamkit.fit.show.predictive import FARTHEST, draw_predictive
from streamkit.fit.show.sky import COLOURS, _colour, sky
from streamkit.fit.show.text import describe_results
from streamkit.runfile import DATA

MANY = tuple("abcdefghijkl")
SPEED = {"kind": "circular_velocity", "radius": 10, "v_c": [220, 5]}


def many(names: tuple[str, ...] = MANY, **host: Any) -> dict[str, Any]:
    """Streams with latitudes, whose sampler has enough walkers."""
    document = several(*names, **host)
    document["sampler"] = {"walkers": 32}
    for table in document["stream"].values():
        table["observable"]["phi2"] = {"phi1": [-5, 5], "phi2": [0, 0], "error": [1, 1]}
    return document


@pytest.mark.parametrize("draw", [corner, traces, priors])
def test_pictures_of_many_parameters_show_those_that_streams_share(draw: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    results = synthetic(many())
    assert len(results.names) == 14
    shown, _, names, _ = parameters_of(results)
    assert [results.names[k] for k in shown] == ["potential.v0", "potential.alpha"]
    figure = draw(results)
    assert len(figure.axes) == {corner: 4, traces: 3, priors: 2}[draw]
    texts = assert_readable(figure, monkeypatch)
    assert all(any(name in text for text in texts) for name in names)


def test_pictures_of_few_parameters_show_all() -> None:
    results = synthetic(many(("a", "b")))
    assert parameters_of(results)[0].tolist() == [0, 1, 2, 3]


def test_the_fit_of_each_stream_is_that_of_its_data() -> None:
    """chi^2 by hand: the sum over the stream's data of (datum - model)^2 over the variance; normal scores round."""
    spec = sk.load(many(("a", "b"), data={"speed": SPEED}))
    theta = dict(zip(spec.names, spec.centre().tolist(), strict=True))
    observation = sk.Posterior(spec).observe(spec.centre())
    fit = goodness(Sampled(spec, theta, observation.predictions, spec.centre()[None], None))
    assert fit is not None
    assert [each.name for each in fit.streams] == ["a", "b", DATA]
    for each in fit.streams[:2]:
        observable, made = spec.bind(stream=each.name).observable, observation.predictions[each.name]
        values, errors = observable.data()
        assert each.best == pytest.approx((((values - made.mean) / errors) ** 2).sum(), rel=1e-3)
        assert len(each.data) == 6
    assert sum(each.best for each in fit.streams) == pytest.approx(fit.whole.best)
    table = stream_table(fit, {"stream b": "500 calls", "data of the host": "exact"})
    assert list(table["sampler"]) == ["", "500 calls", "exact"]


def test_one_stream_has_no_table_of_streams() -> None:
    assert len(synthetic(many(("a", "b"))).spec.only("a").streams) == 1
    assert len(stream_table(None, {})) == 0


def test_the_data_are_where_astropy_has_them_on_the_sky(monkeypatch: pytest.MonkeyPatch) -> None:
    results = synthetic(many(("a", "b")))
    figure = sky(results)
    assert {"a", "b"} <= {text for text, _ in drawn_texts(figure, monkeypatch)}
    (axes,) = figure.axes
    circles = [line for line in axes.lines if line.get_marker() == "o"]
    assert len(circles) == 2
    frame = sk.sky_frame(many()["stream"]["a"]["observable"]["frame"])
    ra, dec, *_ = frame.to_icrs(np.array([-5.0, 5.0]), np.zeros(2))
    galactic = SkyCoord(ra, dec, unit="deg").galactic
    x, y = circles[0].get_data()
    np.testing.assert_allclose(-x, galactic.l.wrap_at(180 * u.deg).radian, atol=1e-6)
    np.testing.assert_allclose(y, galactic.b.radian, atol=1e-6)


def test_a_stream_has_no_colour_of_a_stream_beside_it() -> None:
    """The first of three more streams than colours lies on the second one, and so on: each gets another colour."""
    places, drawn = [np.array([[float(i), 0.0]]) for i in range(len(COLOURS))], [[] for _ in COLOURS]
    assert [_colour(each, drawn) for each in places] == list(COLOURS)
    assert [_colour(places[i] + 0.1, drawn) for i in (0, 1, 6)] == [COLOURS[6], COLOURS[5], COLOURS[0]]
    assert _colour(np.empty((0, 2)), drawn) in COLOURS  # no debris at all


def test_of_many_data_the_farthest_are_drawn() -> None:
    rng = np.random.default_rng(0)
    m = 300
    data = np.zeros(m)
    data[[7, 250]] = 50, -60
    names = tuple(f"datum {i}" for i in range(m))
    seen = Predictive(names, data, np.ones(m), rng.normal(0, 1, (40, m)), np.ones((40, m)))
    far = seen.farthest(2)
    assert far.names == ("datum 7", "datum 250")
    assert far.data.tolist() == [50, -60]
    figure = draw_predictive(seen.farthest(FARTHEST))
    assert sum(len(axes.get_yticks()) for axes in figure.axes) == FARTHEST


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> sk.Results:
    document = copy.deepcopy(many(tuple("abcdefg")))
    document["sampler"] = {"walkers": 20, "steps": 2}
    for table in document["stream"].values():  # data that say little: a start is found at once
        for name in ("distance", "radial_velocity", "phi2"):
            table["observable"][name]["error"] = [200, 200]
    return sk.run(document, out=tmp_path_factory.mktemp("many") / "run", progress=False)


def test_a_run_writes_a_table_and_a_sky_of_its_streams(run: sk.Results) -> None:
    directory = run.directory
    assert isinstance(directory, Path)
    assert list(QTable.read(directory / "streams.ecsv")["stream"]) == list("abcdefg")
    assert (directory / "sky.png").exists()
    assert len(QTable.read(directory / "left_out.ecsv")) == 0  # of 40 samples
    assert not run.failed


def test_page_and_text_have_a_row_for_each_stream(run: sk.Results) -> None:
    assert run.directory is not None
    page = Page((run.directory / "report.html").read_text(encoding="utf-8"))
    assert "Pictures of the 7 streams" in page.text
    assert "Each of 21 quantities" in page.text
    assert sum(tag == "img" for tag, _ in page.tags) >= 7 + 6
    text = describe_results(run)
    (block,) = [part for part in text.split("\n\n") if part.startswith("streams\n")]
    assert [line.split()[0] for line in block.splitlines()[2:] if line[2] != " "] == list("abcdefg")
