"""The command ``streamkit export``."""

from __future__ import annotations

from pathlib import Path

import click

from streamkit import fit, report
from streamkit.cli.options import FORCE_FILE, TRUST


@click.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE|DIR",
              help="File to write: FILE.nc, .csv, .ecsv, .tex or .txt. With --host-likelihood the directory for its "
              "files, by default DIR.")  # fmt: skip
@click.option(
    "--host-likelihood",
    is_flag=True,
    help="Write the likelihood of each stream as a function of the host, in place of samples.",
)
@click.option("--workers", default=1, show_default=True, type=click.IntRange(1), metavar="N",
              help="Processes that write the files of --host-likelihood, one file each at a time.")  # fmt: skip
@TRUST
@FORCE_FILE
def export(directory: Path, output: Path | None, host_likelihood: bool, workers: int, trust: bool, force: bool) -> None:
    """Write a run's samples, without burn-in, in the format of another program.

    The suffix of FILE selects the format:

    \b
    .nc          netCDF for ArviZ (arviz.from_netcdf), each walker a chain, with predictions and data
    .txt         GetDist (getdist.loadMCSamples), with .paramnames and .ranges in the same directory
    .csv, .ecsv  one row per sample; ECSV has units
    .tex         a LaTeX table of parameters and masses

    With --host-likelihood a run by the sampler emulator becomes one small file for each stream: ln L as a function of
    the host, the stream's own parameters integrated out. [data.NAME] kind = "host_likelihood" takes it into other fits.
    """  # noqa: D301  click reads the backspace: a paragraph that is not wrapped
    if host_likelihood:
        _host_likelihoods(directory, output or directory, workers, trust, force)
        return
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output'.")
    report.check_target(output, fit.EXPORTS, "--output", force)
    if output.suffix == ".txt":
        for suffix in (".paramnames", ".ranges"):
            report.check_target(output.with_suffix(suffix), (suffix,), "--output", force)
    results = fit.load_results(directory, trust=trust)
    for path in fit.write_samples(results, output):
        click.echo(f"samples: {path}")
    click.echo(results.note())


def _host_likelihoods(directory: Path, out: Path, workers: int, trust: bool, force: bool) -> None:
    """Write the files of all streams, with a line about each."""
    from streamkit.sample import SAMPLES  # it imports h5py, which `--help` does not need

    names = fit.host_likelihood_files(directory, trust)
    report.check_directory(out, names, "a likelihood of the host", force)
    out.mkdir(exist_ok=True)
    note = "The run has no samples: it was not tested."
    if (directory / SAMPLES).exists():
        note = fit.load_results(directory, trust=trust).note()
    for path, line in fit.write_host_likelihoods(directory, out, trust, workers, note):
        click.echo(f"{path}\n{report.paragraph(line, '  ')}")
    click.echo(note)
