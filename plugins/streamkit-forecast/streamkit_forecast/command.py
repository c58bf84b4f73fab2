"""What `streamkit forecast` does with its options: the place, the surveys, and the products."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from pydantic import ValidationError

from streamkit import Spec, SpecError, StreamkitError, load_results
from streamkit.cli import read_radii
from streamkit.errors import brief, nearest
from streamkit.report import Progress, check_directory, locked
from streamkit.study.grid import draw_pictures, write_tables
from streamkit_forecast.quantities import Quantity
from streamkit_forecast.runner import RADII, Forecast, forecast
from streamkit_forecast.surveys import Errors, read_surveys
from streamkit_forecast.tables import PRODUCTS, forecast_products

USUAL = "M(<20 kpc)"


def run(
    spec: Spec, values: dict[str, Any], *, run: Path | None, add: Path | None, radii: str | None, target: str | None,
    errors: Sequence[str], seeds: int, workers: int, out: Path, force: bool, quiet: bool,
) -> None:  # fmt: skip
    """Make a forecast, write its files, and print its tables; ``values`` are those of --set."""
    check_directory(out, PRODUCTS, "a forecast", force)
    point = {} if run is None else medians(spec, run, quiet)
    surveys = {} if add is None else read_surveys(add)
    given = read_errors(errors)
    at = RADII if radii is None else read_radii(radii)
    with locked(out):
        with Progress(out.name, np.inf, "stream", shown=not quiet) as bar:
            found = forecast(
                spec, point | values, surveys=surveys, radii=at, errors=given, seeds=seeds, workers=workers,
                where=str(add), done=bar.update,
            )  # fmt: skip
        for sentence in found.warnings:
            click.echo(f"warning: {sentence}", err=True)
        products = forecast_products(found, target_of(found, target))
        write_tables(products, out)
        if not quiet:
            click.echo(f"{products.text}\n")
        failed = draw_pictures(products, out)
    if not quiet:
        click.echo(f"tables and picture: {out}")
    if failed:
        click.echo(f"streamkit: not drawn: {failed}; everything else is written", err=True)


def medians(spec: Spec, directory: Path, quiet: bool) -> dict[str, float]:
    """Return the medians of a run by name; SpecError if it has other parameters than the run file.

    Whether its numbers may be quoted is said, unless ``quiet``.
    """
    results = load_results(directory)
    if not quiet:
        click.echo(f"{directory}: {results.note()}")
    if other := sorted(set(results.names) ^ set(spec.names)):
        raise SpecError(
            f"{spec.source}: {directory} is a run with other free parameters: {', '.join(other[:3])} is free in one "
            "of them alone"
        )
    return dict(zip(results.names, np.median(results.samples, axis=0).tolist(), strict=True))


def read_errors(settings: Sequence[str]) -> dict[str, float]:
    """Read errors of one more datum by column."""
    values: dict[str, str] = {}
    for setting in settings:
        name, equals, text = (part.strip() for part in setting.partition("="))
        if not (equals and text):
            raise click.UsageError(f"--error {setting!r}: expected COLUMN=VALUE, such as radial_velocity=2km/s")
        if name not in Errors.model_fields:
            known = f"{nearest(name, Errors.model_fields)} Columns: {', '.join(Errors.model_fields)}."
            raise click.UsageError(f"--error {setting!r}: no column is called {name!r}.{known}")
        values[name] = text
    try:
        return Errors.model_validate(values).by_column()
    except ValidationError as error:
        raise click.UsageError(f"--error {brief(error)}") from None


def target_of(found: Forecast, name: str | None) -> Quantity:
    """Return the quantity of the picture; StreamkitError for a name of none."""
    by_name = {each.name: each for each in found.quantities}
    if name is None:
        masses = [each for each in by_name if each.startswith("M(<")]
        return by_name[USUAL if USUAL in by_name else (masses or list(by_name))[0]]
    if name not in by_name:
        raise StreamkitError(
            f"--target {name!r}: nothing is called so.{nearest(name, by_name)} Known: {', '.join(by_name)}"
        )
    return by_name[name]
