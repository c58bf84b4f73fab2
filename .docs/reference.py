"""The pages of the reference: the run file and the commands by what they say themselves, Python by its docstrings."""

from __future__ import annotations

import ast
import inspect
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import command_pages

import streamkit
from streamkit import components, runfile
from streamkit.report.component_record import field_records

PLAIN: dict[str, Any] = {"sun": runfile.Sun, "likelihood": runfile.Likelihood, "engine": runfile.Engine}
KEYS = ("version", "seed", "plugins")

INDEX = """# Reference

- [The run file](runfile.md): every section and every component, with fields, units and defaults.
- [The commands](commands.md): a page of each, with options and examples.
- [Python](python.md): every public name, with examples.

:::{toctree}
:hidden:

runfile
commands
python
:::
"""


def pages(names: Path) -> dict[str, str]:
    """Return the text of each page of the reference by its file name."""
    registry = components.load_registry()
    made = {"index.md": INDEX, "runfile.md": run_file(registry), "python.md": python(names)}
    made |= command_pages.pages(names.parents[1])
    made |= {f"{role}.md": role_page(registry, role) for role in components.ROLES}
    return made


def cell(text: object) -> str:
    """Return text for one cell of a table."""
    return prose(text).replace("|", r"\|")


def prose(text: object) -> str:
    """Return a paragraph of a docstring as Markdown."""
    return str(text).replace("``", "`").replace("\n", " ")


def table(cls: Any, names: Any) -> str:
    """Return the fields of a class as a table."""
    rows = ["| field | unit | default | allowed | meaning |", "|---|---|---|---|---|"]
    for field in field_records(cls, names):
        default = "required" if field["required"] else f"`{field['default']}`"
        allowed = f"`{cell(field['allowed'])}`" if field["allowed"] != "-" else ""
        unit = "" if field["unit"] == "-" else f'<span class="unit">{cell(field["unit"])}</span>'
        rows.append(f"| `{field['name']}` | {unit} | {cell(default)} | {allowed} | {cell(field['description'])} |")
    return "\n".join(rows)


def run_file(registry: components.Registry) -> str:
    """Return the page of the sections of a run file."""
    fields = runfile.RunFile.model_fields
    parts = [
        "# The run file",
        "A physical number is a number in the field's unit, a quantity such as `\"8 kpc\"`, or a prior: "
        + ", ".join(f"`{runfile.usage(prior)}`" for prior in runfile.PRIORS.values())
        + ". The same text in a terminal: `streamkit reference`.",
        "## Keys",
        table(runfile.RunFile, KEYS),
    ]
    for name, field in fields.items():
        if name in KEYS:
            continue
        parts += [f"## `[{name}]`", prose(field.description or "")]
        if name in PLAIN:
            parts.append(table(PLAIN[name], PLAIN[name].model_fields))
        elif name in components.ROLES:
            default = runfile.DEFAULT_KIND.get(name)
            parts += [kinds(registry, name, f"{name}.md"), *([f"The default is `{default}`."] if default else [])]
            if shared := components.ROLES[name].model_fields:
                parts += ["Every kind has these fields:", table(components.ROLES[name], shared)]
        elif name in {"progenitor", "body"}:
            more = ["lookback", "friction", "reflex"] if name == "progenitor" else ["friction", "reflex"]
            ways = runfile.WAYS if name == "progenitor" else runfile.BODY_WAYS
            parts.append("`kind`: a [potential](potential.md) with a mass.")
            for way in ways:
                parts += [f"Place today: {way.title}.", table(way, way.fields())]
            parts += ["In every case:", table(ways[0], more)]
            if name == "body":
                text = inspect.getdoc(runfile.Encounter) or ""
                parts += ["Or `encounter`, in place of a place today, friction and reflex:"]
                parts += [*(prose(part) for part in text.split("\n\n"))]
                parts += [table(runfile.Encounter, runfile.Encounter.model_fields)]
    parts.append(":::{toctree}\n:hidden:\n\n" + "\n".join(components.ROLES) + "\n:::")
    return "\n\n".join(parts) + "\n"


def kinds(registry: components.Registry, role: str, page: str = "") -> str:
    """Return the kinds of a role as a table, each with the first sentence of its description and a link to a page."""
    rows = [
        f"| [`{kind}`]({page}#{anchor(kind)}) | {cell(sentence(inspect.getdoc(entry.cls) or ''))} |"
        for kind, entry in sorted(registry.entries[role].items())
    ]
    return "\n".join(["| kind | what it is |", "|---|---|", *rows])


def sentence(text: str) -> str:
    """Return the first sentence of a docstring; the dot of "et al." or of a number ends none."""
    first = text.split("\n\n")[0].replace("\n", " ")
    return re.split(r"(?<=[^.]{2}[a-z0-9)`])(?<!et al)\. (?=[A-Z`])", first)[0].rstrip(".") + "."


def anchor(kind: str) -> str:
    """Return the name of the heading of a component, as Markdown makes it."""
    return re.sub(r"[^\w\- ]", "", kind.lower())


def role_page(registry: components.Registry, role: str) -> str:
    """Return the page of the components of one role."""
    shared = components.ROLES[role].model_fields
    parts = [f"# `[{role}]`", f"The installed kinds. In a terminal: `streamkit reference {role}`."]
    if role == "potential":
        parts.append("Published galaxies: `preset = NAME` in `[potential]` stands for several named potentials.")
        rows = [f"| `{preset.name}` | {cell(', '.join(preset.sections))} | {cell(preset.reference)} |"
                for preset in registry.presets.values()]  # fmt: skip
        parts.append("\n".join(["| preset | potentials | reference |", "|---|---|---|", *rows]))
    parts.append(kinds(registry, role))
    for kind, entry in sorted(registry.entries[role].items()):
        text = inspect.getdoc(entry.cls) or ""
        package = entry.supplier.split(" ")[0]
        parts += [f"## {kind}", *(prose(part) for part in text.split("\n\n"))]
        if entry.cls.reference:
            parts.append(f"Reference: {prose(entry.cls.reference)}.")
        if package != "streamkit":
            parts.append(f"From the package [{package}](../plugins/{package}/README.md).")
        names = [name for name in entry.cls.model_fields if name not in shared]
        parts.append(table(entry.cls, names) if names else "No fields of its own.")
    return "\n\n".join(parts) + "\n"


NAMES = re.compile(r"^<!-- (\S+): (.*?) -->$", re.MULTILINE | re.DOTALL)


def python(names: Path) -> str:
    """Return the page of the public names: after each list of names their descriptions."""
    return NAMES.sub(lambda found: describe(found[1], found[2].replace(",", " ").split()), names.read_text("utf-8"))


def describe(module: str, names: list[str]) -> str:
    """Return a table of some public names of a module, and the descriptions of its classes and functions."""
    door = import_module(module)
    parts, rows = [], []
    for name in names:
        value = getattr(door, name)
        if inspect.isclass(value) or inspect.isfunction(value):
            kind = "class" if inspect.isclass(value) else "function"
            options = "\n   :members:" if kind == "class" and not issubclass(value, Exception) else ""
            parts.append(f"```{{eval-rst}}\n.. auto{kind}:: {module}.{name}{options}\n```")
            rows.append(f"| [`{name}`](#{module}.{name}) | {cell(sentence(inspect.getdoc(value) or ''))} |")
        else:
            rows.append(f"| `{name}` | {cell(comment(module, name))} |")
    head = ["| name | meaning |\n|---|---|\n" + "\n".join(rows)] if rows else []
    return "\n\n".join(head + parts)


def comment(module: str, name: str) -> str:
    """Return the comment behind or above the assignment of a public name, which a docstring cannot describe."""
    package = Path(import_module(module).__file__ or "").parent
    for path in sorted(package.rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        lines = source.splitlines()
        above = ""
        for node in ast.parse(source).body:
            if not isinstance(node, ast.Assign):
                continue
            first, last = lines[node.lineno - 2], lines[(node.end_lineno or node.lineno) - 1]
            if first.startswith("# "):
                above = first[2:]
            targets = {item.id for target in node.targets for item in ast.walk(target) if isinstance(item, ast.Name)}
            if name in targets:
                return last.partition("  # ")[2] or above
    value = getattr(streamkit if module == "streamkit" else import_module(module), name)
    return (inspect.getdoc(value) or "").split("\n\n")[0]
