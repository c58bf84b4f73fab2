"""Arguments that several commands share: the run file, and fields set on the command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from streamkit.spec import Spec

RUN_FILE = click.argument("run_file", metavar="RUN.toml", type=click.Path(path_type=Path))
SET = click.option(
    "--set", "settings", multiple=True, metavar="PATH=VALUE",
    help="Replace a field, such as progenitor.mass=6.4e8 or 'potential.v0=220 km/s'. Repeatable.",
)  # fmt: skip


def load_spec(run_file: Path, settings: Sequence[str] = ()) -> Spec:
    """Read the run file and apply the settings."""
    from streamkit.spec import load

    spec = load(run_file)
    return spec.with_values(read_settings(settings)) if settings else spec


def read_settings(settings: Sequence[str]) -> dict[str, Any]:
    """Turn ``PATH=VALUE`` arguments into fields and values, the values read as a run file reads them."""
    from streamkit.toml import literal

    values: dict[str, Any] = {}
    for setting in settings:
        path, equals, text = setting.partition("=")
        path, text = path.strip(), text.strip()
        if not (equals and path and text):
            raise click.UsageError(f"--set {setting!r}: expected PATH=VALUE, such as progenitor.mass=6.4e8")
        if path in values:
            raise click.UsageError(f"--set {path}: given twice, {values[path]!r} and {text!r}")
        values[path] = literal(text)
    return values
