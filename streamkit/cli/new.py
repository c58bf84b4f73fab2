"""The command ``streamkit new``: the package of a new component, which passes its tests as it is written."""

from __future__ import annotations

import builtins
import keyword
import re
import shutil
from pathlib import Path
from string import Template

import click

import streamkit
from streamkit import components
from streamkit.distribution import NAME
from streamkit.errors import StreamkitError

TEMPLATES = Path(__file__).parent / "templates"
# A role has a template of a module, ROLE.py.txt: a new file there is a new role of this command.
ROLES = sorted(file.name.removesuffix(".py.txt") for file in TEMPLATES.glob("*.py.txt"))
ALLOWED = "lower-case letters, digits and underscores, a letter first"


@click.command()
@click.argument("role", type=click.Choice(ROLES), metavar="ROLE")
@click.argument("name")
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="DIR",
              help="Directory of the package, which must not exist; default: streamkit-NAME.")  # fmt: skip
def new(role: str, name: str, output: Path | None) -> None:
    """Write the package of a new component: module, test, pyproject.toml and README.

    ROLE is the component's role: data, integrator, observable, potential, sampler or stripping. NAME is its kind in run
    files. The package can be installed and passes its test as it is: change one line at a time.
    """
    texts = package_files(role, name)
    directory = Path(f"streamkit-{name.replace('_', '-')}") if output is None else output
    if directory.exists():
        raise StreamkitError(f"{directory}: exists already; nothing was changed. Choose another name, or -o DIR.")
    directory.mkdir(parents=True)
    try:
        for file, text in texts.items():
            (directory / file).write_text(text, encoding="utf-8")
    except OSError as error:  # a full disk; a part of a package would stand in the way of the next try
        shutil.rmtree(directory, ignore_errors=True)
        raise StreamkitError(f"{directory}: cannot be written ({error.strerror}); nothing is left of it") from None
    module = next(file for file in texts if file.startswith("streamkit_"))
    click.echo(f"{directory}: {', '.join(texts)}\n")
    click.echo(f"Your code goes into {module}. From here:\n")
    click.echo(f"  pip install -e {directory} pytest\n  pytest {directory}\n  streamkit plugins {role} {name}\n")
    click.echo(f'In a run file: [{section_of(role, name)}] with kind = "{name}" and its fields.')


def section_of(role: str, name: str) -> str:
    """Return the section of a run file for a component: the user chooses the names of data."""
    return f"data.{name}" if role == "data" else role


def package_files(role: str, name: str) -> dict[str, str]:
    """Return file name -> text of the package of a component; a StreamkitError says why a name cannot be taken."""
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or name.endswith("_") or "__" in name:
        likely = re.sub(r"[^a-z0-9]+", "_", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()).strip("_0123456789")
        hint = f" Perhaps {likely!r}?" if re.fullmatch(r"[a-z][a-z0-9_]*", likely) else ""
        raise StreamkitError(f"{name!r} cannot be the name of a component: allowed are {ALLOWED}.{hint}")
    called = "".join(part.capitalize() for part in name.split("_"))
    if called in dir(streamkit) or called == "Field" or keyword.iskeyword(called) or called in vars(builtins):
        raise StreamkitError(f"{name!r}: the class would be called {called}, which is a name in Python or streamkit")
    registry = components.load_registry()
    if name in registry.entries[role]:
        supplier = registry.entries[role][name].supplier
        raise StreamkitError(f"{name!r}: {supplier} has a {role} of this name. Choose another name.")
    package = f"streamkit-{name.replace('_', '-')}"
    words = {"role": role, "kind": name, "name": called, "package": package, "module": package.replace("-", "_")}
    words["section"] = section_of(role, name)
    words["distribution"] = NAME
    files = {
        "pyproject.toml": "pyproject.toml.txt",
        f"{words['module']}.py": f"{role}.py.txt",
        f"test_{name}.py": "test.txt",
        "README.md": "README.md.txt",
    }
    templates = {file: Template((TEMPLATES / text).read_text(encoding="utf-8")) for file, text in files.items()}
    return {file: template.substitute(words) for file, template in templates.items()}
