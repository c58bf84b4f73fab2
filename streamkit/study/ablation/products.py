"""The files of an ablation: tables and pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from streamkit.report import origin, save, save_picture, save_table
from streamkit.study.ablation import figures, tail_figures
from streamkit.study.ablation.runner import Ablation
from streamkit.study.ablation.tables import measures_table, tracks_table

TABLE, TRACKS, RUN = "ablation.ecsv", "tracks.ecsv", "ablation.toml"
PICTURES = {
    "bow_tie": figures.bow_tie,
    "phase_space": figures.phase_space,
    "crossings": figures.crossings,
    "unwrapped": tail_figures.unwrapped,
    "epochs": tail_figures.epochs,
    "along": tail_figures.along,
}
PRODUCTS = (TABLE, TRACKS, RUN, *(f"{name}.png" for name in PICTURES))


def write_tables(found: Ablation, out: Path, options: dict[str, Any]) -> None:
    """Write the table of measures, the mean tracks and the resolved run file."""
    spec = found.spec
    vary: dict[str, list[Any]] = {}
    for outcome in found.outcomes:
        for path, value in outcome.variant.values.items():
            vary.setdefault(path, []).extend([] if value in vary.get(path, []) else [value])
    header = {**origin(spec), "vary": vary, **options}
    for name, made in ((TABLE, measures_table(found)), (TRACKS, tracks_table(found))):
        made.meta = header
        save_table(out / name, made)
    text = spec.toml()
    save(out / RUN, lambda part: part.write_text(text))


def draw_pictures(found: Ablation, out: Path) -> None:
    """Draw the paper's figures of all variants that have a stream."""
    shown = {outcome.variant.label: outcome.first for outcome in found.outcomes}
    if found.external:
        shown = {"N-body": found.reference} | shown
    portraits = {title: p for title, p in shown.items() if p is not None and not p.stream.bound.all()}
    for name, draw in PICTURES.items():
        save_picture(out / f"{name}.png", draw(portraits))
