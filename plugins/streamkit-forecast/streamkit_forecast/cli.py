"""The command `streamkit forecast`. Nothing heavy is imported before its use."""

from __future__ import annotations

from pathlib import Path

import click

from streamkit.cli import QUIET, RUN_FILE, SET, apart, directory, load_spec, read_settings


@click.command()
@click.version_option(package_name="streamkit-forecast", message="streamkit-forecast %(version)s")
@RUN_FILE
@SET
@click.option("--run", "run", type=click.Path(exists=True, file_okay=False, path_type=Path), metavar="DIR",
              help="Forecast at the medians of this run of the run file.")  # fmt: skip
@click.option("--add", "add", type=click.Path(exists=True, dir_okay=False, path_type=Path), metavar="SURVEYS.toml",
              help="Add data that do not exist yet: one section for each survey.")  # fmt: skip
@click.option("--radii", metavar="R,R,...", help="Radii in kpc of masses and flattenings; default: 10,20,50.")
@click.option("--target", metavar="NAME", help='The quantity of the picture; default: "M(<20 kpc)", or the first one.')
@click.option("--error", "errors", multiple=True, metavar="COLUMN=VALUE",
              help="Error of one more datum, as radial_velocity=2km/s; default: as the stream's data.")  # fmt: skip
@click.option("--seeds", default=8, show_default=True, type=click.IntRange(1), metavar="N",
              help="Sets of random numbers for the slopes.")  # fmt: skip
@click.option("--workers", default=1, show_default=True, type=click.IntRange(1), metavar="N",
              help="Processes that make the streams.")  # fmt: skip
@directory("-forecast")
@click.option("-f", "--force", is_flag=True, help="Replace the files of an earlier forecast in DIR.")
@QUIET
def forecast(
    run_file: Path, settings: tuple[str, ...], run: Path | None, add: Path | None, radii: str | None,
    target: str | None, errors: tuple[str, ...], seeds: int, workers: int, output: Path | None, force: bool,
    quiet: bool,
) -> None:  # fmt: skip
    """Forecast what data tell, or data that do not exist yet.

    Lower bounds (Cramer-Rao) of the standard deviations of the host's parameters, masses and flattenings: by each
    stream alone and by all together, progenitors marginalised, with the priors of the run file. --add SURVEYS.toml adds
    surveys. A table and a picture show what one more datum along each stream would give.

    The forecast is made where the priors have their centre. A number that --set gives to a free parameter moves it
    there, and the parameter stays free; --run takes the medians of a run.
    """
    from streamkit_forecast import command

    spec, values = apart(load_spec(run_file), read_settings(settings))
    command.run(
        spec, values, run=run, add=add, radii=radii, target=target, errors=errors, seeds=seeds, workers=workers,
        out=output or Path(f"{run_file.stem}-forecast"), force=force, quiet=quiet,
    )  # fmt: skip
