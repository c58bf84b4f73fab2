"""The command ``streamkit stream``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

import streamkit as sk
from streamkit import observe, report
from streamkit.cli.options import FORCE_FILE, JSON, RUN_FILE, SET, STREAM, load_spec, read_settings
from streamkit.errors import OutOfDomain, StreamkitError


@click.command()
@RUN_FILE
@SET
@STREAM
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE",
              help="Write the particles to FILE.ecsv, .hdf5 or .fits.")  # fmt: skip
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE",
              help="Draw the stream to FILE.png, .pdf or .svg.")  # fmt: skip
@click.option("--track", type=click.Path(path_type=Path), metavar="FILE",
              help="Write the mean track on the sky to FILE.ecsv, or draw it to .png, .pdf or .svg.")  # fmt: skip
@click.option("--stars", type=click.Path(path_type=Path), metavar="FILE",
              help="Write mock stars to FILE.csv or .ecsv, for simulators of surveys such as streamobs.")  # fmt: skip
@click.option("--isochrone", type=click.Path(path_type=Path), metavar="FILE",
              help="Their magnitudes: a table of mass (initial, Msun) and the absolute one in each band.")  # fmt: skip
@click.option("--frame", metavar="NAME",
              help="Frame of --track and --stars by its name; left out: that of the observable.")  # fmt: skip
@click.option("--threads", default=1, show_default=True, type=click.IntRange(1), metavar="N",
              help="Threads for one stream, for 100 000 particles and more; the result is the same.")  # fmt: skip
@FORCE_FILE
@JSON
@click.option("-q", "--quiet", is_flag=True, help="Print nothing.")
def stream(
    run_file: Path,
    settings: tuple[str, ...],
    stream: str | None,
    output: Path | None,
    plot: Path | None,
    track: Path | None,
    stars: Path | None,
    isochrone: Path | None,
    frame: str | None,
    threads: int,
    force: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Make one stream and compare it with the data.

    If the run file has several streams, each is made, and its files have its name: FILE-gd1.ecsv. Data that are no
    stream are compared with the host. Free parameters are at the prior's centre unless --set gives them a value.
    """
    spec = load_spec(run_file, settings, stream=stream)
    if not spec.streams and (output or plot or track or stars):
        spec.stream_name()  # says that there is none
    particles, pictures, tracks, mocks = (
        {name: _file(path, name, spec) for name in spec.streams} for path in (output, plot, track, stars)
    )
    for files, suffixes, option in (
        (particles, report.FORMATS, "--output"),
        (pictures, report.PICTURES, "--plot"),
        (tracks, (".ecsv", *report.PICTURES), "--track"),
        (mocks, report.STARS, "--stars"),
    ):
        for path in filter(None, files.values()):
            report.check_target(path, suffixes, option, force)
    if isochrone is not None and stars is None:
        raise click.UsageError("--isochrone gives magnitudes to mock stars, and --stars FILE is missing")
    magnitudes = None if isochrone is None else report.read_isochrone(isochrone)
    if frame is not None:
        try:
            sk.sky_matrix(frame)
        except ValueError as error:
            raise click.BadParameter(str(error), param_hint="'--frame'") from None
    model = sk.Model(spec, threads)
    records: list[dict[str, Any]] = []
    show = (lambda _: None) if as_json or quiet else click.echo
    for name in spec.streams:
        begin = time.process_time()
        inputs = spec.bind(stream=name)
        try:
            made, prediction = model.observe(inputs)
        except OutOfDomain as error:
            which = "no stream" if len(spec.streams) == 1 else f"no stream {name!r}"
            raise StreamkitError(f"{run_file}: there is {which} at these parameters: {error}") from None
        spent = time.process_time() - begin
        record = report.stream_record(spec, inputs, made, prediction, spent)
        text = report.describe_stream(spec, inputs, record, prediction, read_settings(settings))
        show(f"\n{text}" if records else text)
        records.append(record)
        if file := particles[name]:
            report.write_stream(made, spec, file, frame=observe.frame_of(inputs.observables), force=force)
            show(f"particles: {file}")
        if file := pictures[name]:
            report.save_picture(file, report.draw_stream(made, prediction, inputs))
            show(f"picture: {file}")
        if file := tracks[name]:
            _write_track(made, frame or observe.frame_of(inputs.observables), file)
            show(f"track: {file}")
        if file := mocks[name]:
            seen_in = frame or observe.frame_of(inputs.observables)
            report.write_stars(report.star_table(made, seen_in, magnitudes, inputs.seed), file)
            show(f"mock stars: {file}")
    bound = spec.bind_all()
    for name, measured in model.observe_host(bound).items():
        show("\n" + report.describe_measured(f"data {name}", [bound.data[name]], measured))
        records.append({"data": name, "observables": report.prediction_record([bound.data[name]], measured)})
    if as_json:
        click.echo(report.as_json(records))


def _write_track(made: sk.Stream, frame: sk.Frame, file: Path) -> None:
    track = made.track(frame)
    if file.suffix in report.PICTURES:
        report.save_picture(file, report.draw_track(track, made, frame))
    else:
        report.save_table(file, track.table())


def _file(path: Path | None, name: str, spec: sk.Spec) -> Path | None:
    """Return the file of one stream: with its name, where there are several."""
    return path if path is None or len(spec.streams) == 1 else path.with_stem(f"{path.stem}-{name}")
