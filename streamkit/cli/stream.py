"""The command ``streamkit stream``."""

from __future__ import annotations

import time
from pathlib import Path

import click

import streamkit as sk
from streamkit import observe, report
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

    Of a run file with several, make each: its files have its name, FILE-gd1.ecsv. Free parameters are at the prior's
    centre unless --set says otherwise.
    """
    spec = load_spec(run_file, settings)
    particles, pictures = ({name: _file(path, name, spec) for name in spec.streams} for path in (output, plot))
    for files, suffixes, option in ((particles, report.FORMATS, "--output"), (pictures, report.PICTURES, "--plot")):
        for path in filter(None, files.values()):
            report.check_target(path, suffixes, option, force)
    model, said = sk.Model(spec), []
    for name in spec.streams:
        begin = time.process_time()
        setup = spec.bind(stream=name)
        try:
            made, prediction = model.observe(setup)
        except OutOfDomain as error:
            which = "no stream" if len(spec.streams) == 1 else f"no stream {name!r}"
            raise StreamkitError(f"{run_file}: there is {which} at these parameters: {error}") from None
        spent = time.process_time() - begin
        said.append(report.describe_stream(spec, setup, made, prediction, spent, read_settings(settings)))
        click.echo(said[-1] if len(said) == 1 else f"\n{said[-1]}")
        if file := particles[name]:
            report.write_stream(made, spec, file, frame=observe.frame_of(setup.observables), force=force)
            click.echo(f"particles: {file}")
        if file := pictures[name]:
            report.save_picture(file, report.draw_stream(made, prediction, setup))
            click.echo(f"picture: {file}")


def _file(path: Path | None, name: str, spec: sk.Spec) -> Path | None:
    """Return the file of one stream: with its name, where there are several."""
    return path if path is None or len(spec.streams) == 1 else path.with_stem(f"{path.stem}-{name}")
