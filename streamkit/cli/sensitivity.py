"""The command `streamkit sensitivity`: each observable against each parameter, the others fixed, as files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

import streamkit as sk
from streamkit import report
from streamkit.cli.options import (
    FORCE,
    INTERRUPTED,
    INVALID,
    QUIET,
    RUN_FILE,
    SEEDS,
    SET,
    WORKERS,
    directory,
    load_spec,
    read_settings,
)
from streamkit.study import sensitivity as study


@click.command()
@RUN_FILE
@SET
@click.option("--points", default=15, show_default=True, type=click.IntRange(5), metavar="N",
              help="Points of each grid; the fixed one comes on top.")  # fmt: skip
@click.option("--fields", default="", metavar="PATH,PATH,...",
              help="Vary these parameters only, such as potential.v0,progenitor.mass.")  # fmt: skip
@SEEDS
@WORKERS
@directory("-sensitivity")
@FORCE
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
    names = [name.strip() for name in fields.split(",") if name.strip()]
    with report.locked(out):
        found = _run(spec, point, names, points, seeds, workers, quiet)
        study.write_products(found, out)
    if not quiet:
        click.echo(study.describe_sensitivity(found))
        click.echo(f"\ntables and picture: {out}")
    if found.stopped:
        click.echo(f"streamkit: {found.stopped}; the tables hold what was finished", err=True)
        click.get_current_context().exit(INTERRUPTED if found.stopped == "interrupted" else INVALID)


def apart(spec: sk.Spec, settings: Mapping[str, Any]) -> tuple[sk.Spec, dict[str, Any]]:
    """Apply the settings, but those that give a number to a free parameter: they say where it is fixed."""
    point = {path: value for path, value in settings.items() if path in spec.names and not isinstance(value, Mapping)}
    rest = {path: value for path, value in settings.items() if path not in point}
    return spec.with_values(rest) if rest else spec, point


def _run(
    spec: sk.Spec, point: dict[str, Any], fields: Sequence[str], points: int, seeds: int, workers: int, quiet: bool
) -> study.Sensitivity:
    from tqdm import tqdm

    total = seeds * (1 + points * len(study.chosen(spec, fields)))
    with tqdm(total=total, unit="stream", disable=True if quiet else None, leave=False) as bar:
        return study.run_sensitivity(
            spec, point, fields=fields, points=points, seeds=seeds, workers=workers, done=bar.update
        )
