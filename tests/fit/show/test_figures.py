"""The pictures of a run, whatever its parameters: nothing cut off, nothing printed over anything else."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from astropy.table import QTable
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from pictures import assert_readable
from runfiles import APOCENTRES
from synthetic import synthetic

import streamkit as sk
from streamkit.fit.judge.predictive import Predictive
from streamkit.fit.products import FLATTENING, products_of
from streamkit.fit.samples.predictions import stored_predictions
from streamkit.fit.samples.tables import predictions_table
from streamkit.fit.show import figures
from streamkit.fit.show.corner import corner
from streamkit.fit.show.figures import WIDE, mass_profile, parameters_of, priors, reach, rotation_curve, traces
from streamkit.fit.show.flattening import flattening, is_sphere
from streamkit.fit.show.predictive import LONGEST, draw_predictive, predictions
from streamkit.report import BOTH, COLUMN, NotebookFigure, labels


def freed(**priors):
    """Return APOCENTRES with other free parameters: section -> {field: prior or number}."""
    document = copy.deepcopy(APOCENTRES)
    document["sampler"]["walkers"] = 32
    for section, fields in priors.items():
        document[section].update(fields)
    return document


def one():
    return freed(potential={"alpha": 0.35})


def six():
    """The host, the satellite and the width of the stripping: what a mock leaves free."""
    return freed(
        potential={"rs": {"uniform": [1, 100]}},
        progenitor={"mass": {"uniform": [1e8, 1e9]}, "radius": {"uniform": [0.1, 1]}},
        stripping={"sigma": {"uniform": [0.5, 10]}},
    )


def eight():
    """Proper motions on the equatorial sky; two halos with the same fields, by names that a user chose."""
    document = freed()
    document["potential"] = {
        "halo": {"kind": "nfw_m200", "m200": {"log_uniform": [1e11, 1e13]}, "c200": {"uniform": [5, 30]}, "h0": 70},
        "halo_of_the_dwarf": {"kind": "nfw_m200", "m200": {"log_uniform": [1e9, 1e11]}, "c200": 15, "h0": 70},
    }
    for name in ("l", "b", "pm_l_cosb", "pm_b"):
        del document["progenitor"][name]
    document["progenitor"] |= {
        "ra": 283.83, "dec": {"normal": [-30.545, 0.01]}, "pm_ra_cosdec": {"normal": [-2.692, 0.05]},
        "pm_dec": {"normal": [-1.359, 0.05]}, "v_los": {"normal": [142, 2]}, "distance": {"normal": [26.5, 0.5]},
    }  # fmt: skip
    return document


def three():
    """Return two halos whose names are long, and need two lines of a label."""
    document = eight()
    document["progenitor"] |= {"dec": -30.545, "pm_ra_cosdec": -2.692, "pm_dec": -1.359, "v_los": 142, "distance": 26.5}
    return document


def eleven():
    """The fit of the paper, nearly."""
    document = six()
    document["progenitor"] |= {
        "distance": {"uniform": [22, 28.4]}, "pm_l_cosb": {"normal": [-2.44, 0.3]}, "pm_b": {"normal": [1.97, 0.3]},
        "v_los": {"normal": [153, 2]}, "lookback": {"uniform": [0, 10]},
    }  # fmt: skip
    return document


CASES = {1: one, 2: freed, 6: six, 8: eight, 11: eleven}


@pytest.mark.parametrize("draw", [corner, traces, priors])
@pytest.mark.parametrize(
    "number", [pytest.param(number, marks=pytest.mark.slow if number > 2 else ()) for number in CASES]
)
def test_every_text_of_a_picture_can_be_read(number, draw, monkeypatch):
    results = synthetic(CASES[number](), quick=True)  # the longest caveat
    assert len(results.names) == number
    texts = assert_readable(draw(results), monkeypatch)
    assert any("QUICK LOOK" in text for text in texts)
    for name in parameters_of(results)[2]:
        assert any(name.replace("\n", "") in text.replace("\n", "") for text in texts), name


@pytest.mark.parametrize("draw", [corner, traces])
@pytest.mark.parametrize("make", [three, pytest.param(eight, marks=pytest.mark.slow)])
def test_names_without_a_symbol_can_be_read_too(make, draw, monkeypatch):
    results = synthetic(make(), quick=True)
    results.spec.__dict__["symbols"] = results.names  # as if no field had one
    texts = assert_readable(draw(results), monkeypatch)
    assert any("halo_of_the_\ndwarf.m200" in text for text in texts)


def near():
    """A stream at 20 kpc, on an orbit between 12 and 21 kpc."""
    document = freed()
    document["progenitor"] = {
        "kind": "plummer", "mass": 1e5, "radius": 0.02,
        "x": 15, "y": 0, "z": 8, "vx": 40, "vy": 0, "vz": 180, "lookback": 3,
    }  # fmt: skip
    document["observable"] |= {"leading": [17, 1], "trailing": [21, 1]}
    document["stripping"]["sigma"] = 1
    return document


INSIDE = ("95 %", "68 %", "median", "extrapolated", "leading apocentre", "trailing apocentre")


@pytest.mark.parametrize("make", [pytest.param(freed, marks=pytest.mark.slow), near])
def test_profiles_are_drawn_where_the_stream_and_the_data_are(make, monkeypatch):
    results = synthetic(make())
    stream, _ = results.best_stream
    data = [results.spec.document["observable"][arm][0] for arm in ("leading", "trailing")]
    low, high = reach(results)
    assert low <= min(stream.orbit.r.min(), *map(_kpc, data))
    assert high == max(map(_kpc, data))  # however far the orbit goes
    for draw in (mass_profile, rotation_curve):
        figure = draw(results)
        assert figure.axes[0].get_xlim() == pytest.approx((0.5 * low, 1.5 * high))
        assert set(INSIDE) <= set(assert_readable(figure, monkeypatch, INSIDE))
    if make is near:
        assert high < 40


@pytest.mark.parametrize(
    ("draw", "wide"),
    [
        (mass_profile, COLUMN),
        (rotation_curve, WIDE),
        pytest.param(mass_profile, WIDE, marks=pytest.mark.slow),
        pytest.param(rotation_curve, COLUMN, marks=pytest.mark.slow),
    ],
)
def test_the_legend_does_not_cover_the_median_of_a_quick_look(draw, wide, monkeypatch):
    """Also in the width of a journal's column, where every text is still inside."""
    figure = draw(synthetic(freed(), quick=True), wide=wide)
    assert_readable(figure, monkeypatch, {*INSIDE, *(name.replace(" ", "\n") for name in INSIDE)})  # or folded
    assert figure.get_figwidth() == wide
    (axes,) = figure.axes
    (legend,) = figure.legends
    assert not legend.get_window_extent().overlaps(axes.get_window_extent())


def test_many_radii_of_data_are_drawn_as_ranges(monkeypatch):
    sources = {"orphan": {"a": 15.0, "b": 50.0}, "rotation_curve": {"first": 5.0, "last": 25.0}, "phoenix": {"a": 19.0}}
    monkeypatch.setattr(figures, "_data_radii", lambda _: sources)
    figure = mass_profile(synthetic(freed()))
    ranges = {tuple(line.get_xdata()) for line in figure.axes[0].lines if line.get_marker() == "|"}
    assert ranges == {(5.0, 25.0), (15.0, 50.0), (19.0, 19.0)}
    assert_readable(figure, monkeypatch, ("orphan", "rotation curve", "phoenix"))


@pytest.mark.parametrize("draw", [mass_profile, rotation_curve])
def test_the_ranges_of_thirty_streams_do_not_cross_the_median(draw, monkeypatch):
    sources = {str(k): {"a": 5.0 + k, "b": 8.0 + 1.5 * k} for k in range(30)}
    monkeypatch.setattr(figures, "_data_radii", lambda _: sources)
    (axes,) = draw(synthetic(freed())).axes
    ranges = [line for line in axes.lines if line.get_marker() == "|"]
    assert len(ranges) == 30
    for line in ranges:
        (height, _), radii = line.get_ydata(), line.get_xdata()
        above = [height > figures.height_of_median(axes, r) for r in np.linspace(*radii, 9)]
        assert all(above) or not any(above)


@pytest.mark.parametrize("draw", [mass_profile, rotation_curve])
def test_the_names_of_data_do_not_cross_the_median(draw, monkeypatch):
    sources = {"apocentres": {"leading": 12.0, "trailing": 60.0}, "rotation curve": {"last": 25.0}}
    monkeypatch.setattr(figures, "_data_radii", lambda _: sources)
    figure = draw(synthetic(freed()))
    figure.draw_without_rendering()
    (axes,) = figure.axes
    median = next(line for line in axes.lines if line.get_label() == "median")
    x = np.linspace(*axes.get_xlim(), 2000)
    curve = axes.transData.transform(np.transpose([x, np.interp(x, *median.get_data())]))
    names = [text for text in axes.texts if ": " in text.get_text()]
    assert len(names) == 3
    for text in names:
        assert not text.get_window_extent().count_contains(curve)


def test_a_curve_that_bends_at_small_radii_is_drawn_smoothly(monkeypatch):
    """The circular velocity of a Plummer bulge of 2 kpc, on the radii of a stream that goes out to 60 kpc."""
    monkeypatch.setattr(figures, "reach", lambda _: (5.0, 57.0))
    r = figures.radii(None)
    assert r[[0, -1]] == pytest.approx([2.5, 85.5])
    speed = lambda x: x / (x**2 + 4.0) ** 0.75  # noqa: E731
    x = np.linspace(2.5, 85.5, 5000)
    assert np.abs(np.interp(x, r, speed(r)) - speed(x)).max() < 0.002 * speed(x).max()


@pytest.mark.parametrize("most", [20, 0])
def test_a_corner_plot_is_as_wide_as_one_column_of_a_journal_or_as_both(most, monkeypatch):
    monkeypatch.setattr("streamkit.fit.show.corner.FEW_PARAMETERS", most)
    figure = corner(synthetic(freed()), column=True)
    assert figure.get_figwidth() == pytest.approx(COLUMN if most else BOTH)
    assert_readable(figure, monkeypatch)


@pytest.mark.parametrize(("draw", "quantity", "value"), [(mass_profile, "M", 9e12), (rotation_curve, "v_c", 700.0)])
def test_published_values_are_inside_the_axes(draw, quantity, value):
    """Far beyond the stream, and far above the curve."""
    rows = [("M", 400.0, 9e12, 1e12, 1e12, np.nan, "A"), ("v_c", 1.0, 700.0, 50.0, 50.0, np.nan, "B")]
    names = ("quantity", "radius", "value", "error_minus", "error_plus", "z", "reference")
    table = QTable(rows=rows, names=names)
    (axes,) = draw(synthetic(freed()), literature=table).axes
    factor = 1e-11 if quantity == "M" else 1.0
    place = table["radius"][table["quantity"] == quantity][0]
    error = table["error_plus"][table["quantity"] == quantity][0]
    assert axes.get_xlim()[0] < place < axes.get_xlim()[1]
    assert axes.get_ylim()[1] > (value + error) * factor


def _kpc(value):
    return float(str(value).split()[0])


def test_the_legend_has_the_colours_of_the_bands():
    figure = rotation_curve(synthetic(freed()))
    axes = figure.axes[0]
    FigureCanvasAgg(figure).draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3]
    (legend,) = figure.legends
    shown = {text.get_text(): patch for text, patch in zip(legend.texts, legend.legend_handles, strict=True)}
    middle = axes.get_xlim()[0] + 0.4 * np.ptp(axes.get_xlim())
    for name, band in zip(("95 %", "68 %"), axes.collections, strict=True):
        path = band.get_paths()[0].vertices
        edge = path[np.argsort(np.abs(path[:, 0] - middle))[:2]]  # the band's lower and upper edge there
        y = edge[:, 1].min() + 0.06 * np.ptp(edge[:, 1])
        column, row = axes.transData.transform((edge[0, 0], y)).astype(int)
        box = shown[name].get_window_extent()
        found = pixels[int(pixels.shape[0] - 0.5 * (box.y0 + box.y1)), int(0.5 * (box.x0 + box.x1))]
        assert np.abs(pixels[pixels.shape[0] - 1 - row, column].astype(int) - found).max() <= 2, name


@pytest.mark.rendered
def test_figures_show_themselves_in_a_notebook():
    results = synthetic(freed())
    for draw in (corner, traces, mass_profile, rotation_curve):
        figure = draw(results)
        assert isinstance(figure, NotebookFigure)
    assert figure._repr_png_().startswith(b"\x89PNG\r\n")


def test_parameters_are_called_by_their_symbol_or_the_shortest_clear_end_of_their_path():
    names = ("potential.halo.a_long_name", "potential.x.a_long_name", "progenitor.nodes", "stripping.sigma")
    symbols = (*names[:3], r"$\sigma$")
    assert labels(names, symbols) == ["halo.a_long_\nname", "x.a_long_\nname", "nodes", r"$\sigma$"]


def test_the_density_of_the_prior_is_drawn_in_the_units_of_the_parameter():
    results = synthetic(six(), steps=60)
    figure = priors(results)
    scales = parameters_of(results)[1].tolist()
    for axes, prior, values, scale in zip(figure.axes, results.spec.priors, results.samples.T, scales, strict=False):
        (line,) = axes.lines
        x, density = line.get_data()
        low, high = axes.get_xlim()
        assert density == pytest.approx([np.exp(prior.lnpdf(one * scale)) * scale for one in x])
        assert low * scale <= np.percentile(values, 0.1)
        assert high * scale >= np.percentile(values, 99.9)
        area = sum(patch.get_width() * patch.get_height() for patch in axes.patches[:-1])
        assert area == pytest.approx(1)


def predicted(m, gaussian=True):
    """Data 1, 2 ... with errors of a half, and a model two errors above the k-th with a scatter of k / 10 errors."""
    data = np.arange(1.0, m + 1)
    mean = data + 1 + 0.05 * data * np.random.default_rng(5).standard_normal((4000, m))
    errors = np.full(m, 0.5)
    return Predictive(tuple(f"datum {k + 1}" for k in range(m)), data, errors, mean, 0 * mean, gaussian=gaussian)


@pytest.mark.parametrize("m", [1, 3, 59, 130])
def test_every_datum_has_a_row_that_can_be_read(m, monkeypatch):
    figure = draw_predictive(predicted(m), "QUICK LOOK, not for science")
    assert len(figure.axes) == -(-m // LONGEST)
    names = [label.get_text() for axes in figure.axes for label in axes.get_yticklabels()]
    assert names == [f"datum {k + 1}" for k in range(m)]
    if m < 100:
        assert_readable(figure, monkeypatch)


@pytest.mark.parametrize("m", [3, 40])
def test_predictions_fit_into_a_journals_column(m, monkeypatch):
    figure = draw_predictive(predicted(m), "not converged", narrow=True)
    assert figure.get_figwidth() == pytest.approx(COLUMN)
    assert_readable(figure, monkeypatch)


def test_long_names_of_data_are_not_cut(monkeypatch):
    seen = replace(predicted(3), names=tuple(f"orphan.velocities.pm_phi1_cosphi2 at -10{k}.25" for k in range(3)))
    assert_readable(draw_predictive(seen), monkeypatch)


def test_a_row_has_the_model_and_new_data_in_errors_of_the_datum():
    (axes,) = draw_predictive(predicted(3)).axes
    (medians,) = (line for line in axes.lines if line.get_label() == "median")
    assert medians.get_xdata() == pytest.approx([-2, -2, -2], abs=0.02)
    (narrow,) = (part for part in axes.collections if part.get_label() == "model, 68 %")
    ends = np.array([segment[:, 0] for segment in narrow.get_segments()])
    assert np.ptp(ends, axis=1) == pytest.approx(2 * 0.1 * np.arange(1, 4), rel=0.06)
    (bars,) = (part for part in axes.containers if part.get_label() == "new data, 68 %")
    assert [bar.get_width() for bar in bars] == pytest.approx(2 * np.hypot(1, 0.1 * np.arange(1, 4)), rel=0.06)
    (axes,) = draw_predictive(predicted(3, gaussian=False)).axes
    assert not axes.containers  # another likelihood would make other data


def test_the_table_of_predictions_has_the_numbers_of_the_picture():
    table = predictions_table(predicted(3))
    assert list(table["datum"]) == ["datum 1", "datum 2", "datum 3"]
    assert np.asarray(table["median"]) == pytest.approx([2, 3, 4], abs=0.02)
    assert np.asarray(table["hi68"] - table["lo68"]) == pytest.approx(0.1 * np.arange(1, 4), rel=0.06)
    assert np.asarray(table["deviation"]) == pytest.approx([-2, -2, -2], abs=0.02)
    assert len(predictions_table(None)) == 0


def test_without_predictions_there_is_no_picture_of_them():
    results = synthetic(freed())
    with pytest.raises(sk.StreamkitError, match="no predictions"):
        predictions(results)
    assert stored_predictions(results.draws) is None


def flattened():
    """A host with a free flattening, whose prior has its centre at the sphere."""
    document = freed()
    halo = {"kind": "logarithmic_halo", "v0": {"uniform": [190, 250]}, "q": {"uniform": [0.6, 1.4]}}
    return document | {"potential": halo}


def test_the_flattening_of_a_logarithmic_potential_is_that_of_its_samples():
    results = synthetic(flattened(), steps=8)
    (axes,) = flattening(results).axes
    q = np.percentile(results["potential.q"], [2.5, 16, 50, 84, 97.5])
    for line in axes.lines[:3]:  # the same in every direction
        if len(line.get_ydata()) > 10:
            assert line.get_ydata() == pytest.approx(np.full(len(line.get_ydata()), q[2]), abs=0.005)
    for band, ends in zip(axes.collections[:2], (q[[0, 4]], q[[1, 3]]), strict=True):
        edge = band.get_paths()[0].vertices[:, 1]
        assert [edge.min(), edge.max()] == pytest.approx(ends, abs=0.005)


def test_a_sphere_has_no_picture_of_its_flattening():
    for make, there in ((freed, False), (flattened, True)):
        spec = sk.load(make())
        assert is_sphere(spec) != there
        assert (FLATTENING in products_of(spec)) == there


@pytest.mark.parametrize("height", [0.3, 0.5, 0.8])
def test_a_long_name_is_folded_into_the_room_beside_the_median(height):
    figure = Figure(figsize=(6, 4))
    canvas, axes = FigureCanvasAgg(figure), figure.add_subplot()
    name = "a rotation curve of a survey: innermost datum"
    lines = figures.folded(axes, name, height)
    text = axes.annotate(lines, (0.5, 0.0), xycoords="axes fraction", rotation=90, fontsize=8)
    shown = text.get_window_extent(canvas.get_renderer())
    assert shown.height < height * axes.get_window_extent().height
    assert text.get_text().split() == name.split()
