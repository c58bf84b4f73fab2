"""The command ``streamkit init``."""

from __future__ import annotations

import re
import shutil
from functools import partial
from importlib.resources import files
from pathlib import Path

import click

from streamkit import report
from streamkit.cli.options import FORCE_FILE
from streamkit.errors import StreamkitError, nearest


def examples() -> dict[str, Path]:
    """Return the run files that streamkit brings, by name: in the package, or in the repository it runs from."""
    package = Path(str(files("streamkit")))
    packed, repository = package / "examples", package.parent / "examples"
    found = (packed if packed.is_dir() else repository).glob("*/*.toml")
    return {path.stem: path for path in sorted(found) if not path.stem.startswith("truth")}


def tables_of(example: Path) -> list[Path]:
    """Return the files beside an example that it reads."""
    names = re.findall(r'"([\w-]+\.ecsv)"', example.read_text(encoding="utf-8"))
    return [example.with_name(name) for name in dict.fromkeys(names)]


@click.command()
@click.argument("example", required=False, shell_complete=lambda _context, _parameter, typed: [
    name for name in examples() if name.startswith(typed)
])  # fmt: skip
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE",
              help="Where to; default: the example's name with .toml, in this directory.")  # fmt: skip
@FORCE_FILE
def init(example: str | None, output: Path | None, force: bool) -> None:
    """Write a run file to begin with.

    Without EXAMPLE, list those there are. The file has comments, and runs as it is: change it to your stream. Tables
    that it reads are written beside it.
    """
    known = examples()
    if example is None:
        rows = [(name, _title(path)) for name, path in known.items()]
        click.echo(f"examples\n{report.columns(rows)}\n\nstreamkit init NAME writes one to NAME.toml")
        return
    if example not in known:
        near = nearest(example, known)
        raise StreamkitError(f"init: no example is called {example!r}.{near} Known: {', '.join(known)}.")
    target = Path(f"{example}.toml") if output is None else output
    report.check_target(target, (".toml",), "init", force)
    copies = {known[example]: target} | {table: target.with_name(table.name) for table in tables_of(known[example])}
    for source, copy in copies.items():
        report.check_target(copy, (source.suffix,), "init", force)
    for source, copy in copies.items():
        report.save(copy, partial(shutil.copyfile, source))
    click.echo(f"{', '.join(map(str, copies.values()))}: next, 'streamkit check {target}'")


def _title(path: Path) -> str:
    """Return the first paragraph of a run file's comment."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.strip("# "):
            break
        lines.append(line.strip("# "))
    return " ".join(lines)
