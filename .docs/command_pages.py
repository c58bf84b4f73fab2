"""The pages of the commands: each with what it says itself, its options, and the examples that the documents show."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import click

from streamkit.cli.main import main

SHOWN = 8  # examples of a command at most
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
EXAMPLES = ("README.md", "examples/*/README.md", "plugins/README.md", "plugins/*/README.md", "examples/*/RESULTS.md")


def pages(root: Path) -> dict[str, str]:
    """Return the page of each command by its file, ``commands/NAME.md``, and ``commands.md``, which lists them."""
    context = main.make_context("streamkit", [], resilient_parsing=True)
    shown = lines(root)
    made, rows = {}, []
    for name in main.list_commands(context):
        command = main.get_command(context, name)
        if command is None:
            raise ValueError(f"command {name}: it is listed, but cannot be found")
        inside = command.make_context(name, [], parent=context, resilient_parsing=True)
        made[f"commands/{name}.md"] = page(inside, chosen([each for each in shown if is_of(name, each[0])]))
        rows.append(f"| [`{name}`](commands/{name}.md) | {escaped(paragraphs(inside.command)[0])} |")
    made["commands.md"] = "\n\n".join((
        "# The commands",
        "Each has a page with its options and examples. In a terminal: `streamkit --help`, and `--help` of each.",
        "\n".join(["| command | what it does |", "|---|---|", *rows]),
        "The exit status is 0; 2 after bad input, which is one paragraph on stderr; 130 where Ctrl-C stopped it.",
        ":::{toctree}\n:hidden:\n\n" + "\n".join(name.removesuffix(".md") for name in made) + "\n:::\n",
    ))  # fmt: skip
    return made


def page(inside: click.Context, examples: list[tuple[str, Path]]) -> str:
    """Return the page of one command."""
    usage = " ".join(inside.command.get_usage(inside).split()).removeprefix("Usage: ")
    parts = [f"# {inside.command_path}", f"```text\n{usage}\n```"]
    for text in paragraphs(inside.command):
        parts.append(f"```text\n{text[2:]}\n```" if text.startswith("\b\n") else escaped(text))
    rows = []
    for option in inside.command.get_params(inside):
        record = option.get_help_record(inside)
        if record and record[1]:  # the usage names the arguments
            rows.append(f"| `{record[0].replace('|', chr(92) + '|')}` | {escaped(record[1])} |")
    parts += ["## Options", "\n".join(["| option | meaning |", "|---|---|", *rows])]
    if examples:
        parts += ["## Examples", "Commands of the documents; the paths begin in a clone."]
    for document in dict.fromkeys(doc for _, doc in examples):
        some = "\n".join(f"$ {line}" for line, doc in examples if doc == document)
        title = document.as_posix()
        parts.append(f"[{title}](../../{title}):\n\n```console\n{some}\n```")
    return "\n\n".join(parts) + "\n"


def chosen(examples: list[tuple[str, Path]]) -> list[tuple[str, Path]]:
    """Return the examples that show an option, or no option, for the first time: ``SHOWN`` at most."""
    seen: set[str] = set()
    kept = []
    for line, document in examples:
        options = set(re.findall(r"(?<!\S)--?[a-z][\w-]*", line)) or {""}
        if not options <= seen:
            kept.append((line, document))
        seen |= options
    return kept[:SHOWN]


def paragraphs(command: click.Command) -> list[str]:
    """Return the paragraphs of a command's help, without the line breaks of those that click wraps."""
    text = inspect.cleandoc(command.help or "").split("\f")[0].strip()
    return [part if part.startswith("\b\n") else " ".join(part.split()) for part in text.split("\n\n")]


def escaped(text: str) -> str:
    """Return the text of a help as Markdown; backticks are code in both."""
    return re.sub(r"([\\*_\[\]<>#|~$])", r"\\\1", text)


def lines(root: Path) -> list[tuple[str, Path]]:
    """Return the command lines that the documents show, without prompts, and where; each line once."""
    found: dict[str, Path] = {}
    for pattern in EXAMPLES:
        for path in sorted(root.glob(pattern)):
            for language, block in FENCE.findall(path.read_text(encoding="utf-8")):
                if language in ("sh", "console", ""):
                    for line in block.replace("\\\n", " ").splitlines():
                        found.setdefault(" ".join(line.removeprefix("$ ").split()), path.relative_to(root))
    return list(found.items())


def is_of(name: str, line: str) -> bool:
    """Say whether a command line calls a command of streamkit."""
    return re.search(rf"(^|&& )(\S*/)?streamkit {re.escape(name)}(?![\w-])", line) is not None
