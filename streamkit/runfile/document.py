"""Read a run file; write a resolved one as TOML (the standard library only reads it); read single values."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import Item, Table

from streamkit.errors import SpecError, expect_file

# A number and a unit without quotes, after an equals sign, a bracket or a comma.
NUMBER, UNIT = r"([-+]?\d[\d_.]*(?:[eE][-+]?\d+)?)", r"([A-Za-z](?:[A-Za-z0-9 /*^.-]*[A-Za-z0-9])?)"
QUANTITY = rf"[=\[,]\s*{NUMBER}\s*{UNIT}\s*(?:[,\]}}#]|$)"
TOO_DEEP = "too many tables or lists lie inside each other"


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file; SpecError if it cannot be read, is not text, or is not TOML."""
    try:
        expect_file(path)
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))  # editors of Windows write a mark first
    except OSError as error:
        raise SpecError(f"{path}: cannot read the run file: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise SpecError(f"{path}: not a text file in UTF-8: {error.reason} at byte {error.start}") from None
    except tomllib.TOMLDecodeError as error:
        raise SpecError(f"{path}: not valid TOML: {error}{_unquoted(path, str(error))}") from None
    except RecursionError:
        raise SpecError(f"{path}: {TOO_DEEP}") from None
    except ValueError as error:  # an integer of thousands of digits, a date that does not exist
        raise SpecError(f"{path}: not a value that can be read: {error}") from None


def _unquoted(path: Path, error: str) -> str:
    """Return a hint where the faulty line has a quantity without quotes, such as ``lookback = 3 Gyr``."""
    place = re.search(r"at line (\d+)", error)
    lines = path.read_text(encoding="utf-8").splitlines()
    line = lines[int(place[1]) - 1] if place and int(place[1]) <= len(lines) else ""
    fault = re.search(QUANTITY, line)
    return f'. A quantity needs quotes: "{fault[1]} {fault[2].strip()}"' if fault else ""


def to_toml(document: Mapping[str, Any], header: str = "") -> str:
    """Return a document as TOML, in its order, below a comment with the header.

    Sections are tables of fields, or hold sections with a ``kind``. Nested values of fields are inline.
    """
    toml = tomlkit.document()
    for line in header.splitlines():
        toml.add(tomlkit.comment(line))
    for key, value in sorted(document.items(), key=lambda item: isinstance(item[1], Mapping)):
        toml.add(key, _table(value) if isinstance(value, Mapping) else _inline(value))
    return tomlkit.dumps(toml)


def _table(fields: Mapping[str, Any]) -> Table:
    inner = [value for key, value in fields.items() if key != "preset"]
    several = bool(inner) and all(map(_is_section, inner))
    table = tomlkit.table(is_super_table=several and len(inner) == len(fields))
    for key, value in fields.items():
        table.add(key, _table(value) if several and key != "preset" else _inline(value))
    return table


def _is_section(value: Any) -> bool:
    """Return whether a value is a table of fields with a ``kind``, or holds nothing but such tables."""
    return isinstance(value, Mapping) and ("kind" in value or (bool(value) and all(map(_is_section, value.values()))))


def _inline(value: Any) -> Item:
    if value is None:
        raise TypeError("TOML has no form for None")
    if isinstance(value, Mapping):
        table = tomlkit.inline_table()
        for key, inner in value.items():
            table.add(key, _inline(inner))
        return table
    if isinstance(value, list | tuple):
        array = tomlkit.array()
        array.extend(map(_inline, value))
        return array
    item: Item = tomlkit.item(value)
    return item


def literal(text: str) -> Any:
    """Read a command-line value as TOML does: ``6.4e8``, ``true``, ``{ normal = [1, 2] }``; else a string."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text


def as_written(value: Any) -> str:
    """Write a value as a run file writes it; None, which TOML lacks, as 'none'."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    return f"{value:g}" if isinstance(value, float) else str(value)


def differences(old: Any, new: Any, path: str = "") -> list[str]:
    """List where two documents differ, as ``path: old -> new``."""
    if isinstance(old, dict) and isinstance(new, dict):
        lines: list[str] = []
        for key in [*old, *(key for key in new if key not in old)]:
            where = f"{path}.{key}" if path else str(key)
            lines += differences(old.get(key), new.get(key), where)
        return lines
    return [] if old == new else [f"{path}: {_shown(old)} -> {_shown(new)}"]


def _shown(value: Any) -> str:
    return "nothing" if value is None else json.dumps(value, default=str)


def moved(value: Any, places: Mapping[str, str]) -> Any:
    """Copy a value of a document; text that is the name of a data file becomes its new place."""
    if isinstance(value, Mapping):
        return {key: moved(inner, places) for key, inner in value.items()}
    if isinstance(value, list):
        return [moved(inner, places) for inner in value]
    return places.get(value, value) if isinstance(value, str) else value


def paths_in(table: Mapping[str, Any] | list[Any], prefix: str = "") -> list[str]:
    """Return the path of every entry, nested ones too, in order; entries of lists by their number."""
    paths = []
    for key, value in table.items() if isinstance(table, Mapping) else enumerate(table):
        paths += [f"{prefix}{key}", *(paths_in(value, f"{prefix}{key}.") if isinstance(value, Mapping | list) else [])]
    return paths
