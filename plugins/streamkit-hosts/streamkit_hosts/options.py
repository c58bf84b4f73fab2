"""Options that the commands of this package share."""

from __future__ import annotations

from pathlib import Path

import click

OUTPUT = click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE", default="host.ecsv",
                      show_default=True, help="Table to write (ECSV).")  # fmt: skip
FORCE = click.option("-f", "--force", is_flag=True, help="Replace FILE.")
