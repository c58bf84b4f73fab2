"""Run the tutorials as their readers do, and keep what each cell prints and the pictures that the text shows."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

MARK = "\x1e"  # ends what a cell printed
LINES = 60  # of an output at most
PICTURE = re.compile(r"^!\[([^\]]*)\]\(([^)]+)\)$", re.MULTILINE)


def outputs(script: Path, cells: list[tuple[str, str]], pages: Path) -> list[str] | str:
    """Run the cells of a tutorial in a folder with its tables.

    Return the text of each code cell, or the name of a package that is not installed. The pictures of its text are
    copied to ``pages``, the folder of the tutorials on the site, into a folder with the name of the script.
    """
    code = [body for kind, body in cells if kind == "code"]
    program = "".join(f"{body}\nprint({MARK!r}, end='', flush=True)\n" for body in code)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for table in script.parent.glob("*.ecsv"):
            shutil.copy(table, folder)
        (folder / script.name).write_text(program, encoding="utf-8")
        here = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])  # the command streamkit
        settings = os.environ | {"PATH": here, "PYTHONUTF8": "1", "MPLBACKEND": "agg", "COLUMNS": "100"}
        done = subprocess.run(  # noqa: S603  it runs the tutorials of this repository
            [sys.executable, "-u", script.name],
            cwd=folder, env=settings, capture_output=True, text=True, encoding="utf-8", check=False,
        )  # fmt: skip
        if missing := re.search(r"^ModuleNotFoundError: No module named '(\w+)", done.stderr, re.MULTILINE):
            return missing[1]
        if done.returncode:
            raise RuntimeError(f"{script.name}: it ended with status {done.returncode}\n{done.stderr[-2000:]}")
        for picture in pictures(cells):
            target = pages / script.stem / picture
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(folder / picture, target)
    return [shortened(text) for text in done.stdout.split(MARK)[: len(code)]]


def pictures(cells: list[tuple[str, str]]) -> list[str]:
    """Return the pictures that the text of a tutorial shows: files that its code makes."""
    return [name for kind, body in cells if kind == "markdown" for _, name in PICTURE.findall(body)]


def shortened(text: str) -> str:
    """Return an output without blanks at the ends of lines, and without its middle if it is long."""
    lines = [line.rstrip() for line in text.strip("\n").splitlines()]
    if len(lines) > LINES:
        lines = [*lines[: LINES - 10], f"... {len(lines) - LINES + 1} more lines", *lines[-9:]]
    return "\n".join(lines)
