"""The command ``streamkit stream``."""

from __future__ import annotations

import time
from pathlib import Path

import click

import streamkit as sk
from streamkit import report
from streamkit.cli.options import FORCE_FILE, RUN_FILE, SET, load_spec, read_settings
from streamkit.errors import OutOfDomain, StreamkitError


@click.command()
@RUN_FILE
@SET
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE",
              help="Write the particles to FILE.ecsv, .hdf5 or .fits.")  # fmt: skip
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE",
              help="Draw the stream to FILE.png, .pdf or .svg.")  # fmt: skip
@FORCE_FILE
def stream(run_file: Path, settings: tuple[str, ...], output: Path | None, plot: Path | None, force: bool) -> None:
    """Make one stream, print it beside the data.

    Free parameters are at the prior's centre unless --set says otherwise.
    """
    if output is not None:
        report.check_target(output, report.FORMATS, "--output", force)
    if plot is not None:
        report.check_target(plot, report.PICTURES, "--plot", force)
    spec = load_spec(run_file, settings)
    begin = time.process_time()
    setup = spec.bind()
    try:
        made, prediction = sk.Model(spec).observe(setup)
    except OutOfDomain as error:
        raise StreamkitError(f"{run_file}: there is no stream at these parameters: {error}") from None
    spent = time.process_time() - begin
    click.echo(report.describe_stream(spec, setup, made, prediction, spent, read_settings(settings)))
    if output is not None:
        report.write_stream(made, spec, output, force=force)
        click.echo(f"particles: {output}")
    if plot is not None:
        report.save_picture(plot, report.draw_stream(made, prediction, setup))
        click.echo(f"picture: {plot}")
