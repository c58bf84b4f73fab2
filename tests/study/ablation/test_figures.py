"""The paper's figures of streams beside each other: what is drawn is what the streams hold."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.figure import Figure
from snapshots import nbody_stream, run_file

from streamkit import Model
from streamkit.report import fit_to_journal
from streamkit.study.ablation.figures import (
    _released,
    along,
    bow_tie,
    crossings,
    epochs,
    phase_space,
    some,
    unwrapped,
)
from streamkit.study.ablation.measures import Portrait, portrait_of

ALL = (bow_tie, phase_space, crossings, unwrapped, epochs, along)


@pytest.fixture(scope="module")
def portraits() -> dict[str, Portrait]:
    """N-body, and mLCS with and without gravity, of mock 1."""
    spec = run_file("B", 2000).with_values({"observable.kind": "apocentres"})
    inputs = spec.bind()
    made = {"N-body": portrait_of(nbody_stream("B"), inputs, title="N-body")}
    for on in (True, False):
        variant = spec.with_values({"stripping.progenitor_gravity": on})
        stream, prediction = Model(variant).observe(variant.bind())
        made[f"gravity {on}"] = Portrait(stream, variant.bind(), prediction)
    return made


def panels(figure: Figure) -> list[Any]:
    """The visible panels with data, without the colour bar."""
    return [axes for axes in figure.axes if axes.get_visible() and axes.get_label() != "<colorbar>"]


@pytest.mark.parametrize("draw", ALL, ids=lambda draw: draw.__name__)
@pytest.mark.parametrize("count", [1, pytest.param(3, marks=pytest.mark.slow), pytest.param(5, marks=pytest.mark.slow)])
def test_each_is_drawn_for_any_number_of_streams(draw: Any, count: int, portraits: dict[str, Portrait]) -> None:
    many = dict(list({f"{title} {i}": p for i in range(2) for title, p in portraits.items()}.items())[:5])
    shown = {1: dict(list(portraits.items())[1:2]), 3: portraits, 5: many}[count]
    figure = draw(shown)
    if count != 3:  # the layout costs most, and is looked at once
        figure.set_layout_engine("none")
    figure.draw_without_rendering()
    expected = {"phase_space": 2 * len(shown), "along": 2}
    snapshots = sum(title.startswith("N-body") for title in shown)
    expected["crossings"] = 3 * (len(shown) - snapshots)  # a snapshot holds no crossings
    assert len(panels(figure)) == expected.get(draw.__name__, len(shown))


@pytest.mark.parametrize(
    "draw",
    [
        pytest.param(bow_tie, id="bow_tie", marks=pytest.mark.slow),
        pytest.param(phase_space, id="phase_space", marks=pytest.mark.slow),
        pytest.param(along, id="along"),
    ],
)
def test_a_picture_for_a_journal_is_readable(draw: Any, portraits: dict[str, Portrait]) -> None:
    """As wide as both columns, no text below 6.5 points, and long titles of panels keep apart."""
    shown = [portraits["gravity True"], portraits["gravity False"]] * 2
    figure = draw({f"streakline {i}, without progenitor gravity": each for i, each in enumerate(shown)})
    fit_to_journal(figure)
    figure.draw_without_rendering()
    assert figure.get_size_inches()[0] == pytest.approx(7.1)
    titles = [axes.title for axes in panels(figure) if axes.get_title()]
    assert all(title.get_fontsize() >= 6.5 for title in titles)
    boxes = [title.get_window_extent() for title in titles]
    assert not any(one.overlaps(other) for i, one in enumerate(boxes) for other in boxes[:i])


def test_the_profiles_fill_their_axes(portraits: dict[str, Portrait]) -> None:
    top, bottom = along({title: portraits[title] for title in ("gravity True", "gravity False")}).axes
    left, right = top.get_xlim()
    ends = [portraits[title].ends for title in ("gravity True", "gravity False")]
    assert left - right < 1.3 * np.ptp(ends)
    away = np.concatenate([line.get_ydata() for line in bottom.lines])
    assert bottom.get_ylim()[1] < 2 * np.nanmax(np.abs(away))


def test_the_bow_tie_has_the_phase_in_every_cell(portraits: dict[str, Portrait]) -> None:
    """Without overlap of epochs, energy sorts the stream: leading debris below the progenitor, trailing above."""
    figure = bow_tie({"mlcs": portraits["gravity True"]})
    (cells,) = [c for c in panels(figure)[0].collections if isinstance(c, PolyCollection)]
    energy, phase = cells.get_offsets()[:, 1], np.asarray(cells.get_array())
    assert (phase[energy < -0.2] > 0).mean() > 0.95
    assert (phase[energy > 0.2] < 0).mean() > 0.95


def test_every_epoch_is_drawn_and_no_particle_is_lost(portraits: dict[str, Portrait]) -> None:
    portrait = portraits["gravity True"]
    (axes,) = panels(epochs({"mlcs": portrait}))
    dots = [c for c in axes.collections if isinstance(c, PathCollection)]
    assert sum(len(c.get_offsets()) for c in dots) == (~portrait.stream.bound).sum()
    assert len(dots) == 3  # the orbit of mock 1 starts at an apocentre and has passed two more: 2.5 radial periods


def test_phase_space_is_drawn_in_the_orbital_plane(portraits: dict[str, Portrait]) -> None:
    """The progenitor is on the positive x' axis, at its distance, moving at its speed."""
    orbit = portraits["N-body"].stream.orbit
    above, below = panels(phase_space({"N-body": portraits["N-body"]}))
    x, y = above.lines[0].get_xydata()[0]
    assert (x, y) == (pytest.approx(orbit.r[-1]), pytest.approx(0, abs=1e-9))
    assert np.hypot(*below.lines[0].get_xydata()[0]) == pytest.approx(np.sqrt((orbit.v[:, -1] ** 2).sum()))


def test_the_crossings_are_set_against_the_gaussian_they_were_drawn_from(portraits: dict[str, Portrait]) -> None:
    """mLCS draws N(0, sigma) on each axis, and sigma is 10 km/s in the run file."""
    drawn = _released(portraits["gravity True"])
    assert drawn.shape == (3, 2000)
    assert drawn.mean(axis=1) == pytest.approx([0, 0, 0], abs=0.3)
    assert drawn.std(axis=1) == pytest.approx([10, 10, 10], rel=0.03)


@pytest.mark.parametrize("size", [500, 2000])
def test_a_snapshot_has_crossings_but_no_release(portraits: dict[str, Portrait], size: int) -> None:
    """Whatever its number of particles: fewer than the scheme's, or as many by chance."""
    nbody = portraits["N-body"]
    kept = np.arange(size)
    kick = np.random.default_rng(2).normal(0, 10, (3, size))
    columns = {name: getattr(nbody.stream, name)[kept] for name in
               ("t_release", "t_strip", "tail", "winding", "chi", "bound", "weight")}  # fmt: skip
    stream = replace(
        nbody.stream, q=nbody.stream.q[:, kept], v=nbody.stream.v[:, kept], dq_galactocentric=kick / 10,
        dv_galactocentric=kick, **columns,
    )  # fmt: skip
    figure = crossings({"N-body": replace(nbody, stream=stream), "mlcs": portraits["gravity True"]})
    rows = np.reshape(panels(figure), (2, 3))
    for axes in rows[0]:
        assert axes.get_legend_handles_labels()[1] == ["at the last crossing"]
    for axes in rows[1]:
        assert sorted(axes.get_legend_handles_labels()[1]) == ["as released", "at the last crossing"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["at the last crossing", "as released"]


@pytest.mark.parametrize(
    ("draw", "names"),
    [
        (bow_tie, ["progenitor", "95 % of N-body"]),
        (phase_space, ["leading", "trailing", "progenitor", "Galactic centre, at rest"]),
    ],
)
def test_every_mark_is_named(draw: Any, names: list[str], portraits: dict[str, Portrait]) -> None:
    assert [text.get_text() for text in draw(portraits).legends[0].get_texts()] == names


def test_the_progenitor_is_named_beside_the_epochs(portraits: dict[str, Portrait]) -> None:
    named = [text.get_text() for text in epochs(portraits).axes[0].get_legend().get_texts()]
    assert named[-1] == "progenitor"
    assert all(text.endswith("Gyr") for text in named[:-1])


@pytest.mark.parametrize("draw", [unwrapped, epochs, along], ids=lambda draw: draw.__name__)
def test_ticks_along_a_stream_of_many_turns_do_not_merge(draw: Any, portraits: dict[str, Portrait]) -> None:
    portrait = portraits["gravity True"]
    long = replace(portrait, stream=replace(portrait.stream, winding=12 * portrait.stream.winding), prediction=None)
    axes = panels(draw({"long": long}))[-1]
    low, high = sorted(axes.get_xlim())
    assert high - low > 2000
    ticks = axes.get_xticks()
    assert 3 <= ((ticks >= low) & (ticks <= high)).sum() <= 15


@pytest.mark.parametrize("draw", [unwrapped, epochs], ids=lambda draw: draw.__name__)
@pytest.mark.parametrize(("out", "from_zero"), [(0.0, True), (100.0, False)])
def test_radii_begin_at_zero_unless_the_debris_is_far_out(
    draw: Any, out: float, from_zero: bool, portraits: dict[str, Portrait]
) -> None:
    portrait = portraits["gravity True"]
    stream = portrait.stream
    moved = replace(portrait, stream=replace(stream, q=stream.q * (1 + out / stream.r)), prediction=None)
    bottom, top = panels(draw({"moved": moved}))[-1].get_ylim()
    inner, outer = np.percentile(stream.r[~stream.bound] + out, [2, 98])
    assert (bottom == 0) == from_zero
    assert bottom < inner
    assert outer < top < 1.5 * outer


def test_what_cannot_be_drawn_is_left_out(portraits: dict[str, Portrait]) -> None:
    assert len(panels(crossings({"N-body": portraits["N-body"], "mlcs": portraits["gravity True"]}))) == 3
    for draw in ALL:
        draw({}).draw_without_rendering()


def test_particles_are_drawn_as_often_as_they_weigh(portraits: dict[str, Portrait]) -> None:
    stream = portraits["gravity True"].stream
    heavy = np.arange(len(stream)) % 2 == 0
    weighted = replace(stream, weight=np.where(heavy, 1.6, 0.4))
    drawn = some(weighted, ~stream.bound)
    assert heavy[drawn].mean() == pytest.approx(0.8, abs=0.03)
    assert len(some(stream, ~stream.bound)) == (~stream.bound).sum()
