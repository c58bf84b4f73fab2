"""Arguments and options that several commands have, how their values are read, and the exit statuses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

import streamkit as sk
from streamkit import runfile
from streamkit.cli.compiling import announce_compilation
from streamkit.cli.completion import settings

INVALID, INTERRUPTED = 2, 130  # exit statuses of the commands: bad input, and stopped by Ctrl-C
LARGEST = 1e6  # kpc of a radius

RUN_FILE = click.argument("run_file", metavar="RUN.toml", type=click.Path(path_type=Path))
SET = click.option(
    "--set", "settings", multiple=True, metavar="PATH=VALUE", shell_complete=settings,
    help="Replace a field, such as progenitor.mass=6.4e8 or 'potential.v0=220 km/s'; of all streams by "
    "'stream.*.stripping.particles=500'. Repeatable.",
)  # fmt: skip
STREAM = click.option("--stream", metavar="NAME", help="Take one of several streams alone.")

SAMPLER = click.option(
    "--sampler", metavar="KIND",
    help="Another sampler, with its default settings, in place of the run file's: emcee, emulator, or a plugin's.",
)  # fmt: skip
SEEDS = click.option("--seeds", default=1, show_default=True, type=click.IntRange(1), metavar="N",
                     help="Number of seeds, from the run file's on; each makes every stream again.")  # fmt: skip
WORKERS = click.option("--workers", default=1, show_default=True, type=click.IntRange(1), metavar="N",
                       help="Processes that make the streams.")  # fmt: skip
FORCE = click.option("-f", "--force", is_flag=True, help="Replace the products in DIR.")
FORCE_FILE = click.option("-f", "--force", is_flag=True, help="Replace the files if they exist.")
TRUST = click.option("--trust", is_flag=True, help="Run the plugin files in DIR, which are Python code.")
JSON = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
PDF = click.option("--pdf", is_flag=True, help="Write each picture as PDF too.")
COLUMN = click.option(
    "--column", is_flag=True, help="Draw the pictures for a journal: as wide as one column, or as two."
)
LITERATURE = click.option(
    "--literature", metavar="FILE", type=click.Path(path_type=Path),
    help="A table of published masses, circular velocities or flattenings to compare with the run's, or milky_way: "
    "masses of the Milky Way that come with streamkit.",
)  # fmt: skip
QUIET = click.option("-q", "--quiet", is_flag=True, help="No progress and no tables printed.")


def directory(suffix: str) -> Callable[[Any], Any]:
    """Return the option that names the directory of the products: by default the run file's name and the suffix."""
    return click.option(
        "-o", "--output", type=click.Path(path_type=Path), metavar="DIR",
        help=f"Directory of the products; default: the run file's name with {suffix}.",
    )  # fmt: skip


def load_spec(
    run_file: Path, settings: Sequence[str] = (), sampler: str | None = None, stream: str | None = None
) -> sk.Spec:
    """Read the run file, apply sampler and settings, and take one ``stream`` of it.

    A command that is not quiet will announce compilation.
    """
    if not click.get_current_context().params.get("quiet"):
        announce_compilation()
    spec = sk.load(run_file)
    spec = spec if sampler is None else spec.with_sampler(sampler)
    spec = with_settings(spec, read_settings(settings)) if settings else spec
    return spec if stream is None else spec.only(stream)


def with_settings(spec: sk.Spec, values: Mapping[str, Any]) -> sk.Spec:
    """Replace fields of the run file; a line on stderr names those that a new kind does not have."""
    new = spec.with_values(values)
    if dropped := spec.dropped_by(values):
        click.echo(f"{spec.source}: dropped {', '.join(dropped)}: the new kind has no such field", err=True)
    return new


def apart(spec: sk.Spec, settings: Mapping[str, Any]) -> tuple[sk.Spec, dict[str, Any]]:
    """Split the settings: numbers for free parameters make the fixed point, the others are applied to the run file."""
    settings = spec.by_path(settings)
    point = {path: value for path, value in settings.items() if path in spec.names and not isinstance(value, Mapping)}
    rest = {path: value for path, value in settings.items() if path not in point}
    return with_settings(spec, rest) if rest else spec, point


def read_settings(settings: Sequence[str], option: str = "--set") -> dict[str, Any]:
    """Turn ``PATH=VALUE`` arguments into fields and values, the values read as a run file reads them."""
    values: dict[str, Any] = {}
    for setting in settings:
        path, equals, text = setting.partition("=")
        path, text = path.strip(), text.strip()
        if not (equals and path and text):
            raise click.UsageError(f"{option} {setting!r}: expected PATH=VALUE, such as progenitor.mass=6.4e8")
        if path in values:
            raise click.UsageError(f"{option} {path}: given twice, {values[path]!r} and {text!r}")
        values[path] = runfile.literal(text)
    return values


def read_radii(text: str) -> tuple[float, ...]:
    """Read radii in kpc that are separated by commas."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if not values or not all(0 < value <= LARGEST for value in values):
        raise click.UsageError(f"--radii {text!r}: expected numbers above 0 and up to {LARGEST:g} kpc, such as 8,20,50")
    return values
