"""The command ``streamkit run``."""

from __future__ import annotations

from pathlib import Path

import click

from streamkit import fit, report
from streamkit.cli.options import LITERATURE, PDF, RUN_FILE, SAMPLER, SET, load_spec


@click.command()
@RUN_FILE
@SET
@SAMPLER
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="DIR",
              help="Directory of the products; default: the run file's name without .toml.")  # fmt: skip
@click.option("--workers", type=click.IntRange(1), metavar="N",
              help="Processes that evaluate the posterior; default: engine.workers of the run file, 1.")  # fmt: skip
@click.option("--engine", type=click.Choice(["processes", "serial", "mpi", "dask"]),
              help="Where the posterior is evaluated; default: engine.kind of the run file. The samples do not "
              "depend on it.")  # fmt: skip
@click.option("--scheduler", metavar="ADDRESS",
              help="Running Dask scheduler; without it --engine dask starts N workers here.")  # fmt: skip
@click.option("--steps", type=click.IntRange(1), metavar="N",
              help="Longest chain in steps per walker, in place of the run file's.")  # fmt: skip
@click.option("--quick", is_flag=True, help="A coarse look within minutes; every product is marked as such.")
@click.option("--resume", is_flag=True, help="Continue the run in DIR.")
@click.option("--reuse", type=click.Path(exists=True, file_okay=False, path_type=Path), metavar="DIR",
              help="An earlier run by the emulator: its calls of the same streams serve.")  # fmt: skip
@click.option("-f", "--force", is_flag=True, help="Replace the run in DIR.")
@LITERATURE
@PDF
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
@click.option("-q", "--quiet", is_flag=True, help="No progress and no summary.")
def run(
    run_file: Path,
    settings: tuple[str, ...],
    sampler: str | None,
    output: Path | None,
    workers: int | None,
    engine: str | None,
    scheduler: str | None,
    steps: int | None,
    quick: bool,
    resume: bool,
    reuse: Path | None,
    force: bool,
    literature: Path | None,
    pdf: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Fit the data: write the samples, tables, pictures and a page.

    Ctrl-C and kill lose no finished step: --resume continues the run.
    """
    if resume and force:
        raise click.UsageError("--resume continues the run in DIR and --force replaces it: give one of them")
    spec = load_spec(run_file, settings, sampler)
    out = output if output is not None else Path(run_file.stem)
    results = fit.run(
        spec, out=out, workers=workers, steps=steps, quick=quick, resume=resume, force=force, progress=not quiet,
        literature=literature, pdf=pdf, engine=engine, scheduler=scheduler, reuse=reuse,
    )  # fmt: skip
    if as_json:
        click.echo(report.as_json(fit.results_record(results)))
    elif not quiet:
        click.echo(fit.describe_results(results))
