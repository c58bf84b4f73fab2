"""Shell completion of components, sections, and the paths of a run file's fields.

Nothing here raises: without a valid run file there are fewer completions.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

import streamkit as sk
from streamkit import components, runfile
from streamkit.errors import StreamkitError

PLACED = {"progenitor": "potential", "body": "potential"}  # sections whose kinds are those of potentials
Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def roles(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Complete the role of a component: potential, stripping ..."""
    return _beginning(typed, components.ROLES)


def sections(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Complete the sections of a run file."""
    return _beginning(typed, runfile.RunFile.model_fields)


def kinds_of(argument: str) -> Complete:
    """Return the completion of the kinds of the role, or section, that another argument names."""

    def complete(context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
        section = context.params.get(argument) or ""
        kinds = components.load_registry().entries.get(PLACED.get(section, section), {})
        return [
            CompletionItem(kind, help=(entry.cls.__doc__ or "").strip().partition("\n")[0])
            for kind, entry in sorted(kinds.items())
            if kind.startswith(typed)
        ]

    return complete


def settings(context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Complete ``PATH=`` with the fields of the run file that was named before."""
    if "=" in typed:
        return []
    return _beginning(typed, (f"{path}=" for path in _paths(context)))


def free_parameters(context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Complete the last of several paths of free parameters, separated by commas."""
    before, comma, last = typed.rpartition(",")
    loaded = _loaded(context)
    names = loaded.names if loaded is not None else ()
    given = before.split(",")
    return [CompletionItem(f"{before}{comma}{name}") for name in names if name.startswith(last) and name not in given]


def _beginning(typed: str, names: Iterable[str]) -> list[CompletionItem]:
    return [CompletionItem(name) for name in names if name.startswith(typed)]


def _run_file(context: click.Context) -> Path | None:
    """Return the run file that was named; an option that still waits for its value leaves all before it in `args`."""
    named = context.params.get("run_file") or next(iter(context.args), None)
    return None if named is None else Path(named)


def _loaded(context: click.Context) -> sk.Spec | None:
    file = _run_file(context)
    try:
        return None if file is None else sk.load(file)
    except StreamkitError:
        return None


def _paths(context: click.Context) -> list[str]:
    """Return the fields of the run file with every default; of one that is not valid, those that it gives."""
    loaded = _loaded(context)
    if loaded is not None:
        return list(_fields(loaded.document))
    file = _run_file(context)
    try:
        return [] if file is None else list(_fields(tomllib.loads(file.read_text(encoding="utf-8"))))
    except (OSError, ValueError):
        return []


def _fields(table: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    for name, value in table.items():
        inside = isinstance(value, Mapping) and not set(value) & set(runfile.PRIORS)
        if inside and value:
            yield from _fields(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}"
