"""The command ``streamkit check``."""

from __future__ import annotations

from pathlib import Path

import click

from streamkit import report
from streamkit.cli.options import JSON, RUN_FILE, SET, STREAM, load_spec
from streamkit.errors import OutOfDomain, StreamkitError
from streamkit.study import preflight


@click.command()
@RUN_FILE
@SET
@click.option("--draws", default=64, show_default=True, type=click.IntRange(0), metavar="N",
              help="Trial streams over the prior, with few particles, at most; 0 for none.")  # fmt: skip
@STREAM
@JSON
@click.option("-q", "--quiet", is_flag=True, help="No progress; print the warnings only.")
def check(
    run_file: Path, settings: tuple[str, ...], draws: int, stream: str | None, as_json: bool, quiet: bool
) -> None:
    """Validate a run file and check its physics.

    Printed are the components with their suppliers, the free parameters with their priors, the progenitor's orbit at
    the prior's centre, the CPU time of a call and of the run, and warnings about causes of failing fits. Of many
    streams each has one line. The exit status is 0 for a valid run file and 2 for another.
    """
    spec = load_spec(run_file, settings, stream=stream)
    if not (as_json or quiet):
        click.echo(f"{preflight.describe_spec(spec)}\n")
    try:
        result = preflight.run_preflight(spec, draws=draws, progress=not quiet)
    except OutOfDomain as error:  # an orbit that cannot be followed at all
        where = "the prior's centre" if spec.names else "the given parameters"
        raise StreamkitError(f"{run_file}: there is no stream at {where}: {error}") from None
    if as_json:
        click.echo(report.as_json(preflight.preflight_record(spec, result)))
    elif not quiet:
        click.echo(preflight.describe_preflight(spec, result))
    elif result.warnings:
        click.echo(report.warning_list(result.warnings))
