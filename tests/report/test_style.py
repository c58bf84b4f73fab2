"""What all pictures share: ticks of angles, and letters that stay letters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from streamkit.report import across, angle_ticks, save_picture


@pytest.mark.parametrize(
    ("low", "high", "step"),
    [(-60, 60, 15), (-180, 180, 45), (-360, 360, 90), (-500, 480, 180), (-2000, 2500, 720), (-7200, 7200, 2880)],
)
def test_angles_have_even_ticks_that_do_not_merge(low: float, high: float, step: float) -> None:
    """At most eight steps, each an even part or a multiple of a turn; the axis may run either way."""
    axes = Figure().subplots()
    for limits in ((low, high), (high, low)):
        axes.set_xlim(*limits)
        angle_ticks(axes)
        ticks = axes.get_xticks()
        inside = ticks[(ticks >= low) & (ticks <= high)]
        assert np.diff(inside) == pytest.approx(step)
        assert 4 <= len(inside) <= 9


@pytest.mark.rendered
def test_a_picture_of_many_dots_is_small(tmp_path: Path) -> None:
    """A third of what matplotlib writes, and the colours are the same to the eye."""
    figure = Figure()
    x, y = np.random.default_rng(0).normal(size=(2, 8000))
    figure.subplots().scatter(x, y, s=1, alpha=0.6, color="#0072B2")
    figure.savefig(tmp_path / "plain.png", dpi=200)
    save_picture(tmp_path / "small.png", figure)
    plain, small = (tmp_path / "plain.png").stat().st_size, (tmp_path / "small.png").stat().st_size
    assert small < 0.5 * plain
    images = [np.asarray(Image.open(tmp_path / name).convert("RGB"), float) for name in ("plain.png", "small.png")]
    assert np.abs(images[0] - images[1]).mean() < 2


@pytest.mark.rendered
def test_a_pdf_has_no_type_3_fonts(tmp_path: Path) -> None:
    """Journals refuse them; Type 42 are TrueType."""
    figure = Figure()
    figure.subplots().set_xlabel(r"angle along the stream, $r$ [kpc]")
    save_picture(tmp_path / "a.pdf", figure)
    content = (tmp_path / "a.pdf").read_bytes()
    assert b"/Type3" not in content
    assert b"/CIDFontType2" in content
    save_picture(tmp_path / "a.svg", figure)
    assert "angle along the stream" in (tmp_path / "a.svg").read_text()


@pytest.mark.parametrize("points", [7.0, 10.0])
@pytest.mark.parametrize("names", [["68 %", "95 %", "median"], ["Correa Magnus & Vasiliev 2022"], ["iiii", "WWWWWWWW"]])
def test_a_legend_has_as_many_columns_as_fit(names: list[str], points: float) -> None:
    figure, inches = Figure((6.0, 4.0)), 5.7
    columns = across(names, inches, points)

    def width(columns: int) -> float:
        handles = figure.subplots().plot(np.zeros((1, 4 * columns)))
        legend = figure.legend(
            handles, [max(names, key=len)] * len(handles), ncols=columns, fontsize=points, borderpad=0, loc="center"
        )
        figure.draw_without_rendering()
        return float(legend.get_window_extent().width / figure.dpi)

    assert width(columns) < inches
    assert width(columns + 1) > 0.95 * inches
