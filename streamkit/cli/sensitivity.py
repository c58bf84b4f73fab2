"""The command `streamkit sensitivity`: each observable against each parameter, the others fixed, as files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

import streamkit as sk
from streamkit import report
from streamkit.cli.completion import free_parameters
from streamkit.cli.options import (
    FORCE,
    JSON,
    PDF,
    QUIET,
    RUN_FILE,
    SEEDS,
    SET,
    WORKERS,
    directory,
    load_spec,
    read_settings,
)
from streamkit.cli.study import conduct
from streamkit.study import grid
from streamkit.study import sensitivity as study


@click.command()
@RUN_FILE
@SET
@click.option("--points", default=15, show_default=True, type=click.IntRange(5), metavar="N",
              help="Points of each grid; the fixed one comes on top.")  # fmt: skip
@click.option("--fields", default="", metavar="PATH,PATH,...", shell_complete=free_parameters,
              help="Vary these parameters only, such as potential.v0,progenitor.mass.")  # fmt: skip
@SEEDS
@WORKERS
@directory("-sensitivity")
@FORCE
@PDF
@JSON
@QUIET
def sensitivity(
    run_file: Path,
    settings: tuple[str, ...],
    points: int,
    fields: str,
    seeds: int,
    workers: int,
    output: Path | None,
    force: bool,
    pdf: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Show how each observable depends on each parameter.

    Every free parameter is varied with the others fixed: over the central 95 % of its prior, in even steps (in ln x if
    the prior is log-uniform). The fixed point is the prior's centre; a number that --set gives to a free parameter
    moves it there, and the parameter stays free. All streams have the same random numbers.

    Printed and written to DIR: the observables at every point, their slopes at the fixed one in units of the data
    errors, and a picture. Points without a stream are gaps, with the reason. Ctrl-C keeps the parameters that are
    finished.
    """
    out = output if output is not None else Path(f"{run_file.stem}-sensitivity")
    report.check_directory(out, study.PRODUCTS, "a sensitivity", force)
    spec, point = apart(load_spec(run_file), read_settings(settings))
    names = study.chosen(spec, [name.strip() for name in fields.split(",") if name.strip()])

    def run(done: Callable[[], object]) -> grid.Products:
        found = study.run_sensitivity(spec, point, fields=names, points=points, seeds=seeds, workers=workers, done=done)
        return study.sensitivity_products(found)

    conduct(out, seeds * (1 + points * len(names)), run, quiet=quiet, as_json=as_json, pdf=pdf)


def apart(spec: sk.Spec, settings: Mapping[str, Any]) -> tuple[sk.Spec, dict[str, Any]]:
    """Apply the settings, but those that give a number to a free parameter: they say where it is fixed."""
    point = {path: value for path, value in settings.items() if path in spec.names and not isinstance(value, Mapping)}
    rest = {path: value for path, value in settings.items() if path not in point}
    return spec.with_values(rest) if rest else spec, point
