"""The files of an ablation: tables and pictures."""

from __future__ import annotations

from functools import partial
from typing import Any

from streamkit.study.ablation import figures
from streamkit.study.ablation.paper import small_csv, small_latex
from streamkit.study.ablation.runner import Ablation
from streamkit.study.ablation.sky_figure import has_panels, tracks_on_sky
from streamkit.study.ablation.tables import describe_ablation, measures_table, tracks_table
from streamkit.study.grid import Products

PICTURES = {
    f"{draw.__name__}.png": draw
    for draw in (
        figures.bow_tie, figures.phase_space, figures.crossings, figures.unwrapped, figures.epochs, figures.along
    )
}  # fmt: skip
SKY = "sky.png"  # only with an observable that is drawn on the sky
TABLE, TRACKS, RUN = "ablation.ecsv", "tracks.ecsv", "ablation.toml"
CSV, LATEX = "ablation.csv", "ablation.tex"  # the small table
PRODUCTS = (TABLE, CSV, LATEX, TRACKS, RUN, *PICTURES, SKY)


def ablation_products(ablation: Ablation, options: dict[str, Any]) -> Products:
    """Return the measures and mean tracks, their header with what was varied, and the pictures of all streams."""
    vary: dict[str, list[Any]] = {}
    for outcome in ablation.outcomes:
        for path, value in outcome.variant.values.items():
            vary.setdefault(path, []).extend([] if value in vary.get(path, []) else [value])
    shown = {ablation.reference.title: ablation.reference} if ablation.reference.title else {}
    shown |= {o.variant.label: o.first for o in ablation.outcomes if o.first is not None}
    portraits = {title: portrait for title, portrait in shown.items() if not portrait.stream.bound.all()}
    pictures = PICTURES | ({SKY: tracks_on_sky} if any(map(has_panels, portraits.values())) else {})
    return Products(
        ablation.spec,
        RUN,
        describe_ablation(ablation),
        {TABLE: measures_table(ablation), TRACKS: tracks_table(ablation)},
        {name: partial(draw, portraits) for name, draw in pictures.items()},
        {"vary": vary, **options},
        ablation.stopped,
        {CSV: small_csv(ablation), LATEX: small_latex(ablation)},
    )
