"""The command line: reads arguments, calls the library, prints. Nothing heavy is imported before its use."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from streamkit.ablate import ablate
from streamkit.arguments import INTERRUPTED, INVALID, RUN_FILE, SET, load_spec, read_settings
from streamkit.errors import OutOfDomain, StreamkitError, nearest
from streamkit.sensitivity import sensitivity


class Commands(click.Group):
    """The group: an error that streamkit explains, or a wrong argument, is one paragraph and status 2."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Run a command and leave the process with its status."""
        if not standalone_mode:
            return super().main(args, prog_name, complete_var, standalone_mode=False, **extra)
        try:
            status = super().main(args, prog_name, complete_var, standalone_mode=False, **extra)
        except StreamkitError as error:
            _fail(str(error), getattr(error, "exit_status", INVALID))  # an interrupted run brings its own
        except click.ClickException as error:
            _fail(_explain(error), INVALID)
        except OSError as error:  # no permission, a full disk, a directory where a file should be
            where = f"{error.filename}: " if error.filename else ""
            _fail(f"{where}cannot be read or written: {error.strerror or error}", INVALID)
        except click.Abort:
            _fail("interrupted", INTERRUPTED)
        sys.exit(status if isinstance(status, int) else 0)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """Find a command; name the nearest one if there is none."""
        command = super().get_command(ctx, name)
        if command is None and not ctx.resilient_parsing:
            known = self.list_commands(ctx)
            raise click.UsageError(
                f"no command is called {name!r}.{nearest(name, known)} Known: {', '.join(known)}", ctx
            )
        return command


def _fail(message: str, status: int) -> None:
    click.echo(f"streamkit: {message}", err=True)
    sys.exit(status)


def _explain(error: click.ClickException) -> str:
    message = error.format_message()
    message = message[:1].lower() + message[1:]
    if isinstance(error, click.UsageError) and error.ctx is not None:
        message = f"{message.rstrip('.')}. See '{error.ctx.command_path} --help'."
    return message


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="streamkit", message="streamkit %(version)s")
def main() -> None:
    """Weigh a galaxy with a tidal stream."""


@main.command()
@RUN_FILE
@SET
@click.option("--draws", default=64, show_default=True, type=click.IntRange(0), metavar="N",
              help="Trial streams over the prior, with few particles; 0 for none.")  # fmt: skip
def check(run_file: Path, settings: tuple[str, ...], draws: int) -> None:
    """Validate a run file and look at its physics.

    Prints the components and who supplies them, the free parameters with their priors, the progenitor's
    orbit at the prior's centre, and what a call and the run will cost in CPU time. Warns of what makes a
    fit fail. Exit status 0: valid; 2: not.
    """
    from streamkit.describe import describe_preflight, describe_spec
    from streamkit.preflight import preflight

    spec = load_spec(run_file, settings)
    click.echo(describe_spec(spec))
    click.echo()
    click.echo(describe_preflight(spec, preflight(spec, draws=draws)))


@main.command()
@RUN_FILE
@SET
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE",
              help="Write the particles to FILE.ecsv, .hdf5 or .fits.")  # fmt: skip
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE",
              help="Draw the stream to FILE.png, .pdf or .svg.")  # fmt: skip
@click.option("-f", "--force", is_flag=True, help="Replace the files if they exist.")
def stream(
    run_file: Path, settings: tuple[str, ...], output: Path | None, plot: Path | None, force: bool
) -> None:
    """Make one stream, print it beside the data.

    Free parameters are at the prior's centre unless --set says otherwise.
    """
    from streamkit import export

    if output is not None:
        export.check_target(output, export.FORMATS, "--output", force)
    if plot is not None:
        export.check_target(plot, export.PICTURES, "--plot", force)
    spec = load_spec(run_file, settings)
    from streamkit.describe import describe_stream
    from streamkit.model import Model

    begin = time.process_time()
    setup = spec.bind()
    try:
        made, prediction = Model(spec).observe(setup)
    except OutOfDomain as error:
        raise StreamkitError(f"{run_file}: there is no stream at these parameters: {error}") from None
    spent = time.process_time() - begin
    click.echo(describe_stream(spec, setup, made, prediction, spent, read_settings(settings)))
    if output is not None:
        export.write(made, spec, output, force=force)
        click.echo(f"particles: {output}")
    if plot is not None:
        from streamkit import plots

        export.save(plot, lambda part: plots.save_stream(made, prediction, setup, part))
        click.echo(f"picture: {plot}")


main.add_command(ablate)
main.add_command(sensitivity)


@main.command()
@RUN_FILE
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="DIR",
              help="Directory of the products; default: the run file's name without .toml.")  # fmt: skip
@click.option("--workers", default=1, show_default=True, type=click.IntRange(1), metavar="N",
              help="Processes that evaluate the posterior.")  # fmt: skip
@click.option("--steps", type=click.IntRange(1), metavar="N",
              help="Longest chain in steps per walker, in place of the run file's.")  # fmt: skip
@click.option("--quick", is_flag=True, help="A coarse look within minutes; says so on every product.")
@click.option("--resume", is_flag=True, help="Continue the chain in DIR.")
@click.option("--force", is_flag=True, help="Replace the run in DIR.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar and no summary.")
def run(
    run_file: Path,
    output: Path | None,
    workers: int,
    steps: int | None,
    quick: bool,
    resume: bool,
    force: bool,
    quiet: bool,
) -> None:
    """Fit: write the chain, tables and pictures.

    Ctrl-C and kill lose no finished step: continue with --resume.
    """
    if resume and force:
        raise click.UsageError("--resume continues the run in DIR and --force replaces it: give one of them")
    from streamkit.runner import run as sample

    spec = load_spec(run_file)
    out = output if output is not None else Path(run_file.stem)
    results = sample(
        spec, out=out, workers=workers, steps=steps, quick=quick, resume=resume, force=force,
        progress=not quiet,
    )  # fmt: skip
    if not quiet:
        from streamkit.describe import describe_results

        click.echo(describe_results(results))


@main.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--truth", metavar="TRUE.toml", type=click.Path(path_type=Path),
              help="A run file whose [potential] is the true host of a mock: compare with it.")  # fmt: skip
def report(directory: Path, truth: Path | None) -> None:
    """Write a run's tables and pictures again.

    With --truth also the recovery of a mock: the mass profile and rotation curve over the true ones, with the relative
    difference, and recovered minus true in sigma by radius. The [potential] of TRUE.toml needs numbers, no priors;
    other sections are not looked at.
    """
    from streamkit.describe import describe_results
    from streamkit.report import report as write_report

    results = write_report(directory, truth)
    click.echo(describe_results(results))
    if truth is not None:
        from astropy.table import QTable

        from streamkit import output, recovery

        click.echo(f"\n{recovery.describe(QTable.read(directory / output.RECOVERY[0]))}")


@main.command()
@click.argument("kind", required=False)
@click.argument("name", required=False)
def plugins(kind: str | None, name: str | None) -> None:
    """List the installed components and who supplies them.

    With KIND (potential, stripping, integrator or observable), those of one kind; with NAME as well, one
    component in full: its parameters with units, defaults and bounds.
    """
    from streamkit import registry
    from streamkit.listing import listing

    click.echo(listing(registry.load(), kind, name))


@main.command()
def schema() -> None:
    """Print the JSON Schema of the run file.

    It covers the installed plugins; editors use it to complete and check run files.
    """
    import json

    from streamkit import registry
    from streamkit.schema import json_schema

    click.echo(json.dumps(json_schema(registry.load()), indent=2))
