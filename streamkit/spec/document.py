"""Read a run file; write a resolved one as TOML (the standard library only reads it); read single values."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from streamkit.errors import SpecError


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    SpecError
        If it cannot be read, is not text, or is not TOML.
    """
    try:
        return tomllib.loads(path.read_bytes().decode())
    except OSError as error:
        raise SpecError(f"{path}: cannot read the run file: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise SpecError(f"{path}: not a text file in UTF-8: {error.reason} at byte {error.start}") from None
    except tomllib.TOMLDecodeError as error:
        raise SpecError(f"{path}: not valid TOML: {error}") from None


def to_toml(document: Mapping[str, Any], header: str = "") -> str:
    """Return the document as TOML: sections as tables, what lies deeper than a section's fields inline.

    Parameters
    ----------
    document
        Top-level values and sections; a section is a table of fields, or of tables of fields with a ``kind``.
    header
        Text for a comment at the top.
    """
    lines = [f"# {line}".rstrip() for line in header.splitlines()]
    lines += [f"{_key(key)} = {_value(value)}" for key, value in document.items() if not isinstance(value, Mapping)]
    for key, value in document.items():
        if isinstance(value, Mapping):
            lines += _table(_key(key), value)
    return "\n".join(lines) + "\n"


def _table(path: str, table: Mapping[str, Any]) -> list[str]:
    if table and all(isinstance(value, Mapping) and "kind" in value for value in table.values()):
        return [line for key, value in table.items() for line in _table(f"{path}.{_key(key)}", value)]
    return ["", f"[{path}]", *(f"{_key(key)} = {_value(value)}" for key, value in table.items())]


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _text(key)


def _text(value: str) -> str:
    # JSON's escapes are TOML's; only DEL must be escaped in TOML and is not in JSON
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, float):
        return repr(value)  # TOML spells inf and nan as Python does
    if isinstance(value, int):
        return str(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    raise TypeError(f"TOML has no form for {value!r}")


def literal(text: str) -> Any:
    """Read a command-line value as TOML does: ``6.4e8``, ``true``, ``{ normal = [1, 2] }``; else a string."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
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
        found: list[str] = []
        for key in [*old, *(key for key in new if key not in old)]:
            where = f"{path}.{key}" if path else str(key)
            found += differences(old.get(key), new.get(key), where)
        return found
    return [] if old == new else [f"{path}: {_shown(old)} -> {_shown(new)}"]


def _shown(value: Any) -> str:
    return "nothing" if value is None else json.dumps(value, default=str)
