"""The command `streamkit sensitivity`: each observable against each parameter, the others fixed, as files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from streamkit import report
from streamkit.cli.completion import free_parameters
from streamkit.cli.options import SEEDS, SET, apart, load_spec, read_settings
from streamkit.cli.study import StudyOptions, conduct, study_options
from streamkit.study import grid
from streamkit.study import sensitivity as study


@click.command()
@SET
@click.option("--points", default=15, show_default=True, type=click.IntRange(5), metavar="N",
              help="Points of each grid; the fixed point is added to them.")  # fmt: skip
@click.option("--fields", default="", metavar="PATH,PATH,...", shell_complete=free_parameters,
              help="Vary these parameters only, such as potential.v0,progenitor.mass.")  # fmt: skip
@SEEDS
@study_options("-sensitivity")
def sensitivity(
    run_file: Path, settings: tuple[str, ...], points: int, fields: str, seeds: int, options: StudyOptions
) -> None:
    """Show how each observable depends on each parameter.

    Every free parameter is varied in turn while the others are fixed: over the central 95 % of its prior, in even
    steps (in ln x if the prior is log-uniform). The fixed point is the prior's centre. A number that --set gives to a
    free parameter moves the fixed point there, and the parameter stays free. All streams have the same random numbers.

    The tables, printed and written to DIR, hold the observables at every point and their slopes at the fixed point in
    units of the data errors. A picture is written too. Points without a stream are gaps, listed with the reason.
    Ctrl-C ends the command; the finished parameters are written.
    """
    report.check_directory(options.out, study.PRODUCTS, "a sensitivity", options.force)
    spec, point = apart(load_spec(run_file), read_settings(settings))
    names = study.chosen(spec, [name.strip() for name in fields.split(",") if name.strip()])

    def run(done: Callable[[], object]) -> grid.Products:
        response = study.run_sensitivity(
            spec, point, fields=names, points=points, seeds=seeds, workers=options.workers, done=done
        )
        return study.sensitivity_products(response)

    conduct(options, seeds * (1 + points * len(names)), run)
