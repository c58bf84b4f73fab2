"""The command ``streamkit init``."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Iterable, Sequence
from functools import partial
from importlib.resources import files
from itertools import takewhile
from pathlib import Path

import click

from streamkit import report
from streamkit.cli.library import write_streams
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
@click.argument("names", nargs=-1, metavar="[EXAMPLE]", shell_complete=lambda _context, _parameter, typed: [
    name for name in examples() if name.startswith(typed)
])  # fmt: skip
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE",
              help="File to write; default: the example's name with .toml, in this directory.")  # fmt: skip
@click.option("--own", is_flag=True, help="Write a template for a stream of your own, to own.toml or to FILE.")
@click.option("--stream", "streams", multiple=True, metavar="NAME [NAME ...]",
              help="Write a run file for known streams, such as GD-1, from an installed library "
              "(streamkit-galstreams).")  # fmt: skip
@FORCE_FILE
def init(names: tuple[str, ...], output: Path | None, own: bool, streams: tuple[str, ...], force: bool) -> None:
    """Write an example run file to start from.

    Without EXAMPLE, list the examples. The file has comments and runs as it is: change it to your stream. Tables that
    it reads are written to the same directory. --own writes a short template in place of an example: every line that
    depends on the stream is marked. --stream writes a run file and tables for streams that others have found; check
    the errors of the data in it.
    """
    if own and (names or streams):
        found = f"the stream {streams[0]!r}" if streams else f"the example {names[0]!r}"
        raise click.UsageError(f"--own writes a template; found {found} too")
    if output is not None and not (own or names or streams):
        raise click.UsageError("-o FILE: which example? 'streamkit init' lists them, and --own is a template")
    if streams:
        _write_known((*streams, *names), output, force)
    elif own:
        _write_template(output or Path("own.toml"), force)
    elif not names:
        rows = [(name, _title(path)) for name, path in examples().items()]
        click.echo(f"examples\n{report.columns(rows)}\n\nstreamkit init NAME writes one to NAME.toml; "
                   "streamkit init --own writes a template for a stream of your own")
    elif len(names) > 1:
        raise click.UsageError(f"one example at a time; found {' '.join(names)}. Known streams are written by --stream")
    else:
        _write_example(names[0], output, force)


def _write_known(streams: Sequence[str], output: Path | None, force: bool) -> None:
    written = write_streams(streams)
    target = output or Path(written.name)
    texts = {target: written.text} | {target.with_name(name): text for name, text in written.tables.items()}
    _check(texts, target, force)
    for file, text in texts.items():
        report.save(file, partial(_write_text, text=text))
    click.echo(f"{', '.join(map(str, texts))}: check the errors of the data; {_next(target)}")


def _write_template(target: Path, force: bool) -> None:
    report.check_target(target, (".toml",), "init", force)
    text = (files("streamkit.cli") / "templates" / "own.toml.txt").read_text(encoding="utf-8")
    report.save(target, partial(_write_text, text=text))
    click.echo(f"{target}: change the lines with <-; {_next(target)}")


def _write_example(example: str, output: Path | None, force: bool) -> None:
    run_files = examples()
    if example not in run_files:
        hint = nearest(example, run_files)
        raise StreamkitError(f"init: no example is called {example!r}.{hint} Known: {', '.join(run_files)}.")
    target = Path(f"{example}.toml") if output is None else output
    text, tables = run_files[example].read_text(encoding="utf-8"), tables_of(run_files[example])
    for name in tables:
        text = text.replace(f'"{name}"', f'"{new_name(name)}"')
    copies = {table: target.with_name(new_name(name)) for name, table in tables.items()}
    _check([target, *copies.values()], target, force)
    report.save(target, partial(_write_text, text=text))
    for table, copy in copies.items():
        report.save(copy, partial(shutil.copyfile, table))
    click.echo(f"{', '.join(map(str, (target, *copies.values())))}; {_next(target)}")


def _check(targets: Iterable[Path], run_file: Path, force: bool) -> None:
    for file in targets:
        report.check_target(file, (file.suffix if file != run_file else ".toml",), "init", force)


def _next(target: Path) -> str:
    return f"next: streamkit check {shlex.quote(str(target))}"


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _title(path: Path) -> str:
    """Return the first paragraph of the comment that a run file begins with."""
    comment = takewhile(lambda line: re.match("# *[^# ]", line), path.read_text(encoding="utf-8").splitlines())
    return " ".join(line.strip("# ") for line in comment)
