"""The command `streamkit nbody`. Nothing heavy is imported before its use."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from streamkit.cli import QUIET, RUN_FILE, SET, Commands, directory, load_spec
from streamkit.errors import OutOfDomain, StreamkitError


@click.command()
@click.version_option(package_name="streamkit-nbody", message="streamkit-nbody %(version)s")
@RUN_FILE
@SET
@directory("-nbody")
@click.option("--particles", default=20000, show_default=True, type=click.IntRange(100), metavar="N",
              help="Number of particles of the satellite.")  # fmt: skip
@click.option("--softening", type=click.FloatRange(0, min_open=True), metavar="KPC",
              help="Softening length; default: the mean distance between particles at the centre.")  # fmt: skip
@click.option("--theta", default=0.7, show_default=True, type=click.FloatRange(0.1, 1.5), metavar="ANGLE",
              help="Opening angle of the tree.")  # fmt: skip
@click.option("--step", type=click.FloatRange(0, min_open=True), metavar="MYR",
              help="Longest step; default: from the softening and the host.")  # fmt: skip
@click.option("--snapshots", default=1, show_default=True, type=click.IntRange(1), metavar="N",
              help="Number of snapshots at equal intervals; the last one is today's.")  # fmt: skip
@click.option("--workers", default=1, show_default=True, type=click.IntRange(1), metavar="N",
              help="Threads of the tree; the result is the same for any number.")  # fmt: skip
@click.option("--resume", is_flag=True, help="Continue from the checkpoint in DIR.")
@click.option("--force", is_flag=True, help="Replace the run in DIR.")
@QUIET
def nbody(
    run_file: Path, settings: tuple[str, ...], output: Path | None, particles: int, softening: float | None,
    theta: float, step: float | None, snapshots: int, workers: int, resume: bool, force: bool, quiet: bool,
) -> None:  # fmt: skip
    """Disrupt a live satellite.

    The progenitor of the run file, integrated back by the look-back time, becomes a sphere of particles in
    equilibrium, and is followed to today in the run file's host. Free parameters are at the prior's centre unless
    --set says otherwise. Ctrl-C and kill lose at most a minute: continue with --resume.
    """
    if resume and force:
        raise click.UsageError("--resume continues the run in DIR and --force replaces it: give one of them")
    from streamkit_nbody import runner, summary
    from streamkit_nbody.plan import Options
    from streamkit_nbody.simulation import Simulation

    options = Options(particles, softening, theta, None if step is None else 1e-3 * step)
    out = output if output is not None else Path(f"{run_file.stem}-nbody")
    try:
        simulation = Simulation.of(load_spec(run_file, settings), options, workers)
    except OutOfDomain as error:
        raise StreamkitError(f"{run_file}: there is no such simulation: {error}") from None
    if not quiet:
        click.echo(summary.describe_plan(simulation))
    state = runner.run(simulation, out, snapshots=snapshots, resume=resume, force=force, progress=not quiet)
    if not quiet:
        click.echo(summary.describe(simulation, state))
        click.echo(f"snapshot of today: {out / runner.SNAPSHOT.format(snapshots)}")


def main() -> None:
    """Run the script `streamkit-nbody`: another name of `streamkit nbody`."""
    Commands(commands={"nbody": nbody}).main(["nbody", *sys.argv[1:]], prog_name="streamkit")
