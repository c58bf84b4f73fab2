"""The command `streamkit simulate`. Nothing heavy is imported before its use."""

from __future__ import annotations

from pathlib import Path

import click

from streamkit.cli import QUIET, RUN_FILE, SET, load_spec


@click.command()
@click.version_option(package_name="streamkit-simulate", message="streamkit-simulate %(version)s")
@RUN_FILE
@SET
@click.option("--draws", default=1000, show_default=True, type=click.IntRange(1), metavar="N",
              help="Number of draws from the priors, those of an earlier call included.")  # fmt: skip
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE",
              help="File to write (HDF5); default: the run file's name with -sims.h5.")  # fmt: skip
@click.option("--noise/--no-noise", default=True, show_default=True,
              help="Add the noise of the data to what is measured.")  # fmt: skip
@click.option("--particles", is_flag=True, help="Store the particles of each stream too: 28 bytes each.")
@click.option("--workers", type=click.IntRange(1), metavar="N",
              help="Processes that make the draws; default: engine.workers of the run file, 1.")  # fmt: skip
@click.option("--engine", "kind", type=click.Choice(["processes", "serial", "mpi", "dask"]),
              help="Where they run; default: engine.kind of the run file.")  # fmt: skip
@click.option("--scheduler", metavar="ADDRESS", help="Running Dask scheduler.")
@click.option("--resume", is_flag=True, help="Continue FILE, or add draws to it.")
@click.option("-f", "--force", is_flag=True, help="Replace FILE.")
@QUIET
def simulate(
    run_file: Path, settings: tuple[str, ...], draws: int, output: Path | None, noise: bool, particles: bool,
    workers: int | None, kind: str | None, scheduler: str | None, resume: bool, force: bool, quiet: bool,
) -> None:  # fmt: skip
    """Make a training set for inference by simulations.

    Each draw takes parameters from the priors of the run file, makes its streams with random numbers of their own,
    measures them as the run file says, and adds the noise of the data. FILE has the parameters (theta) and the data
    (x) of all draws, and reads into numpy as it is. A draw without a measurable stream has NaN and the reason.

    A draw depends on the seed and on its number alone: FILE is the same, bit for bit, for any number of workers, and
    after any interruption.
    """
    if resume and force:
        raise click.UsageError("--resume continues FILE and --force replaces it: give one of them")
    from streamkit_simulate import runner, summary

    spec = load_spec(run_file, settings)
    given = {"kind": kind, "workers": workers, "scheduler": scheduler}
    engine = spec.engine.model_copy(update={name: value for name, value in given.items() if value is not None})
    done = runner.simulate(
        spec, output or Path(f"{run_file.stem}-sims.h5"), draws, noise=noise, particles=particles, workers=engine,
        resume=resume, force=force, progress=not quiet, tell=None if quiet else click.echo,
    )  # fmt: skip
    if not quiet:
        click.echo(summary.describe(done))
