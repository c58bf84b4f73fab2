"""The command `streamkit sensitivity`: each observable against each parameter, the others fixed, as files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from streamkit.arguments import (
    FORCE,
    INTERRUPTED,
    INVALID,
    QUIET,
    RUN_FILE,
    SEEDS,
    SET,
    WORKERS,
    directory,
    load_spec,
    read_settings,
)

if TYPE_CHECKING:
    from streamkit.response import Response
    from streamkit.spec import Spec

TABLE, SLOPES, PICTURE, RUN = "sensitivity.ecsv", "slopes.ecsv", "sensitivity.png", "sensitivity.toml"
PRODUCTS = (TABLE, SLOPES, PICTURE, RUN)


@click.command()
@RUN_FILE
@SET
@click.option("--points", default=15, show_default=True, type=click.IntRange(5), metavar="N",
              help="Points of each grid; the fixed one comes on top.")  # fmt: skip
@click.option("--fields", default="", metavar="PATH,PATH,...",
              help="Vary these parameters only, such as potential.v0,progenitor.mass.")  # fmt: skip
@SEEDS
@WORKERS
@directory("-sensitivity")
@FORCE
@QUIET
def sensitivity(
    run_file: Path,
    settings: tuple[str, ...],
    points: int,
    fields: str,
    seeds: int,
    workers: int,
    output: Path | None,
    force: bool,
    quiet: bool,
) -> None:
    """Show how each observable depends on each parameter.

    Every free parameter is varied with the others fixed: over the central 95 % of its prior, in even steps (in ln x if
    the prior is log-uniform). The fixed point is the prior's centre; a number that --set gives to a free parameter
    moves it there, and the parameter stays free. All streams have the same random numbers.

    Printed and written to DIR: the observables at every point, their slopes at the fixed one in units of the data
    errors, and a picture. Points without a stream are gaps, with the reason. Ctrl-C keeps the parameters that are
    finished.
    """
    from streamkit import export
    from streamkit import output as files
    from streamkit.responsetable import describe

    out = output if output is not None else Path(f"{run_file.stem}-sensitivity")
    export.check_directory(out, PRODUCTS, "a sensitivity", force)
    spec, point = apart(load_spec(run_file), read_settings(settings))
    names = [name.strip() for name in fields.split(",") if name.strip()]
    with files.locked(out):
        found = _run(spec, point, names, points, seeds, workers, quiet)
        _write(found, out)
    if not quiet:
        click.echo(describe(found))
        click.echo(f"\ntables and picture: {out}")
    if found.stopped:
        click.echo(f"streamkit: {found.stopped}; the tables hold what was finished", err=True)
        click.get_current_context().exit(INTERRUPTED if found.stopped == "interrupted" else INVALID)


def apart(spec: Spec, settings: Mapping[str, Any]) -> tuple[Spec, dict[str, Any]]:
    """Apply the settings, but those that give a number to a free parameter: they say where it is fixed."""
    point = {path: value for path, value in settings.items() if path in spec.names and not isinstance(value, Mapping)}
    rest = {path: value for path, value in settings.items() if path not in point}
    return spec.with_values(rest) if rest else spec, point


def _run(
    spec: Spec, point: dict[str, Any], fields: Sequence[str], points: int, seeds: int, workers: int, quiet: bool
) -> Response:
    from tqdm import tqdm

    from streamkit.response import chosen, respond

    total = seeds * (1 + points * len(chosen(spec, fields)))
    with tqdm(total=total, unit="stream", disable=True if quiet else None, leave=False) as bar:
        return respond(
            spec, point, fields=fields, points=points, seeds=seeds, workers=workers, done=bar.update
        )


def _write(found: Response, out: Path) -> None:
    from streamkit import export
    from streamkit.curves import CENTRAL
    from streamkit.responseplot import sensitivity as draw
    from streamkit.responsetable import points, slopes

    data = zip(found.data.values.tolist(), found.data.errors.tolist(), strict=True)
    header = {
        **export.origin(found.spec),
        "seeds": found.seeds,
        "central": CENTRAL,
        "fixed": found.point,
        "data": dict(zip(found.names, map(list, data), strict=True)),
    }
    for name, table in ((TABLE, points(found)), (SLOPES, slopes(found))):
        table.meta = header
        export.save_table(out / name, table)
    text = found.spec.toml()
    export.save(out / RUN, lambda part: part.write_text(text))
    export.save_picture(out / PICTURE, draw(found))
