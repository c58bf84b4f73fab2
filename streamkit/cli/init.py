"""The command ``streamkit init``."""

from __future__ import annotations

import re
import shutil
from functools import partial
from importlib.resources import files
from itertools import takewhile
from pathlib import Path

import click

from streamkit import report
from streamkit.cli.options import FORCE_FILE
from streamkit.errors import StreamkitError, nearest


def examples() -> dict[str, Path]:
    """Return the run files that streamkit brings, by name: in the package, or in the repository it runs from."""
    package = Path(str(files("streamkit")))
    packed, repository = package / "examples", package.parent / "examples"
    paths = (packed if packed.is_dir() else repository).glob("*/*.toml")
    return {path.stem: path for path in sorted(paths) if not path.stem.startswith("truth")}


def tables_of(example: Path) -> dict[str, Path]:
    """Return the files that an example reads, by their names in the example: in its folder, or in another example's."""
    names = re.findall(r'"((?:\.\./\w+/)?[\w-]+\.ecsv)"', example.read_text(encoding="utf-8"))
    return {name: example.parent.parent / name[3:] if "/" in name else example.with_name(name) for name in names}


def new_name(name: str) -> str:
    """Return the name of the copy of a table; for a table of another example it begins with that example's name."""
    return name.removeprefix("../").replace("/", "_")


@click.command()
@click.argument("example", required=False, shell_complete=lambda _context, _parameter, typed: [
    name for name in examples() if name.startswith(typed)
])  # fmt: skip
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE",
              help="File to write; default: the example's name with .toml, in this directory.")  # fmt: skip
@click.option("--own", is_flag=True, help="Write a template for a stream of your own, to own.toml or to FILE.")
@FORCE_FILE
def init(example: str | None, output: Path | None, own: bool, force: bool) -> None:
    """Write an example run file to start from.

    Without EXAMPLE, list the examples. The file has comments and runs as it is: change it to your stream. Tables that
    it reads are written to the same directory. --own writes a short template in place of an example: every line that
    depends on the stream is marked.
    """
    if own:
        if example is not None:
            raise click.UsageError(f"--own writes a template; found the example {example!r} too")
        target = output or Path("own.toml")
        report.check_target(target, (".toml",), "init", force)
        text = (files("streamkit.cli") / "templates" / "own.toml.txt").read_text(encoding="utf-8")
        report.save(target, lambda path: path.write_text(text, encoding="utf-8"))
        click.echo(f"{target}: change the lines with <-; next, 'streamkit check {target}'")
        return
    run_files = examples()
    if example is None:
        rows = [(name, _title(path)) for name, path in run_files.items()]
        click.echo(f"examples\n{report.columns(rows)}\n\nstreamkit init NAME writes one to NAME.toml; "
                   "streamkit init --own writes a template for a stream of your own")
        return
    if example not in run_files:
        hint = nearest(example, run_files)
        raise StreamkitError(f"init: no example is called {example!r}.{hint} Known: {', '.join(run_files)}.")
    target = Path(f"{example}.toml") if output is None else output
    text, tables = run_files[example].read_text(encoding="utf-8"), tables_of(run_files[example])
    for name in tables:
        text = text.replace(f'"{name}"', f'"{new_name(name)}"')
    copies = {table: target.with_name(new_name(name)) for name, table in tables.items()}
    for file in (target, *copies.values()):
        report.check_target(file, (file.suffix if file != target else ".toml",), "init", force)
    report.save(target, lambda path: path.write_text(text, encoding="utf-8"))
    for table, copy in copies.items():
        report.save(copy, partial(shutil.copyfile, table))
    click.echo(f"{', '.join(map(str, (target, *copies.values())))}: next, 'streamkit check {target}'")


def _title(path: Path) -> str:
    """Return the first paragraph of the comment that a run file begins with."""
    comment = takewhile(lambda line: re.match("# *[^# ]", line), path.read_text(encoding="utf-8").splitlines())
    return " ".join(line.strip("# ") for line in comment)
