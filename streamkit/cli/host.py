"""The command ``streamkit host``."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

import streamkit as sk
from streamkit import fit, model, report
from streamkit.cli.options import FORCE_FILE, JSON, SET, TRUST, load_spec, read_radii
from streamkit.errors import OutOfDomain, StreamkitError

TABLES = (".ecsv",)


@click.command()
@click.argument("source", metavar="RUN.toml|DIR", type=click.Path(path_type=Path))
@SET
@click.option("--radii", metavar="R1,R2,...", help="Radii of the table in kpc.")
@click.option("--draws", default=0, type=click.IntRange(0), metavar="N",
              help="Show medians and intervals of N draws of a run file's priors.")  # fmt: skip
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE", help="Write the profile to FILE.ecsv.")
@click.option("--orbits", type=click.Path(path_type=Path), metavar="FILE",
              help="Write the orbits of the progenitors and bodies to FILE.ecsv.")  # fmt: skip
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE",
              help="Draw the host to FILE.png, .pdf or .svg.")  # fmt: skip
@FORCE_FILE
@TRUST
@JSON
@click.option("-q", "--quiet", is_flag=True, help="Print nothing.")
def host(
    source: Path,
    settings: tuple[str, ...],
    radii: str | None,
    draws: int,
    output: Path | None,
    orbits: Path | None,
    plot: Path | None,
    force: bool,
    trust: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Show the host of a run file, or of a run's posterior.

    A table of mass, circular velocity, flattening, escape speed and density against radius; and of the progenitors and
    bodies with their tidal radii and orbits. Free parameters of a run file are at the prior's centre unless --set gives
    them a value; --draws shows what the priors allow. A directory gives medians and 68 % intervals; its orbits are
    those of the best sample.
    """
    targets = (output, TABLES, "--output"), (orbits, TABLES, "--orbits"), (plot, report.PICTURES, "--plot")
    for path, suffixes, option in targets:
        if path is not None:
            report.check_target(path, suffixes, option, force)
    at = fit.HOST_RADII if radii is None else read_radii(radii)
    fine = np.geomspace(min(at) if len(at) > 1 else 1.0, max(at), 61)
    whole: sk.Spec | sk.Results
    if source.is_dir():
        if settings:
            raise click.UsageError("--set changes a run file; a directory has its parameters from its samples")
        results = fit.load_results(source, trust=trust)
        if draws:
            raise click.UsageError("--draws shows the priors of a run file; a directory has samples of the posterior")
        spec, best, whole, note = results.spec, results.best(), results, results.note()
        caveat = fit.remark(results)
    else:
        spec = load_spec(source, settings)
        if draws and not spec.names:
            raise click.UsageError("--draws: the run file has no free parameter")
        best, whole, caveat = None, spec, ""
        note = f"Medians and 68 % intervals of {draws} draws of the priors." if draws else ""
    try:
        objects = model.moving_objects(spec, best)
    except OutOfDomain as error:
        raise StreamkitError(f"{source}: there is no orbit at these parameters: {error}") from None
    try:
        profile = fit.host_table(whole, at, draws)
        lines = fit.prior_profiles(spec, fine, draws) if draws and plot else None
    except OutOfDomain as error:
        raise StreamkitError(f"{source}: no draw of the priors has a host: {error}") from None
    if output:
        report.save_table(output, profile)
    if orbits:
        report.save_table(orbits, fit.orbits_table(objects))
    if plot:
        report.save_picture(plot, fit.draw_host(fit.host_table(whole, fine, draws), objects, caveat, lines))
    if as_json:
        tables = {"profile": profile, "objects": fit.objects_table(objects)}
        click.echo(report.as_json({name: report.table_record(table) for name, table in tables.items()}))
    elif not quiet:
        click.echo(fit.describe_host(profile, objects, note))
        for path in filter(None, (output, orbits, plot)):
            click.echo(f"written: {path}")
