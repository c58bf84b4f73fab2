"""Errors about streams: each at the place that the user wrote, and one for all streams that have the same."""

from __future__ import annotations

import re
from collections.abc import Sequence

from streamkit.runfile.stream_tables import DEFAULTS, StreamTables

MOST_NAMES = 5  # names of streams in one sentence
UNKNOWN = re.compile(r"(.*)\.[^.]+: .* has no field '[^']*'\. Did you mean '([^']*)'\?")
BEGINNING = re.compile(r"(?:the section \[)?stream\.")


def where_written(errors: Sequence[str], tables: StreamTables, run_file: str) -> list[str]:
    """Return errors with their file, at the places that the user wrote.

    Each error begins with a path in the run file as it would be without defaults and files of streams. Equal errors of
    several streams become one. A missing field is left out beside a misspelt name of it.
    """
    misspelt = tuple(f"{found[1]}.{found[2]}: missing" for error in errors if (found := UNKNOWN.match(error)))
    about = [(_stream(error, tables), error) for error in errors if not error.startswith(misspelt)]
    having: dict[str, set[str]] = {}
    for name, error in about:
        having.setdefault(_of_any(error, name), set()).add(name)
    same: dict[tuple[bool, str], tuple[str, list[str]]] = {}  # the text of the first of equal errors, and their streams
    for name, error in about:
        everywhere = len(having[_of_any(error, name)]) == len(tables.tables)
        is_shared = bool(name) and tables.is_shared(name, _place(error, name), everywhere)
        text = _above(error, name, tables)
        first = _in_file(text, name, is_shared, tables, run_file), list[str]()
        _, names = same.setdefault((is_shared, _of_any(text, name)), first)
        names += [name] if name and name not in names else []
    return [_with_names(text, names, shared, len(tables.tables)) for (shared, _), (text, names) in same.items()]


def _of_any(error: str, stream: str) -> str:
    """Return an error without the name of its stream."""
    return error.replace(f"stream.{stream}.", "stream.NAME.") if stream else error


def _above(error: str, stream: str, tables: StreamTables) -> str:
    """Return an error about a field that stands above the sections of its stream at the field's place there."""
    place = _place(error, stream) if stream else ()
    field = tables.above(stream, place)
    return error.replace(f"stream.{stream}.{'.'.join(place)}", f"stream.{stream}.{field}", 1) if field else error


def _in_file(error: str, stream: str, is_shared: bool, tables: StreamTables, run_file: str) -> str:
    """Return an error with its file, and with paths as in this file."""
    if stream and is_shared:
        error = error.replace(f"stream.{stream}.", f"{DEFAULTS}.")
    elif stream in tables.files:
        return f"{tables.files[stream]}: {error.replace(f'stream.{stream}.', '')}"
    return f"{run_file}: {error}"


def _stream(error: str, tables: StreamTables) -> str:
    """Return the name of the stream that an error is about; an empty text for another error."""
    begins = BEGINNING.match(error)
    rest = error[begins.end() :] if begins else ""
    names = [name for name in tables.tables if rest.startswith((f"{name}.", f"{name}:"))]
    return max(names, key=len, default="")


def _place(error: str, stream: str) -> tuple[str, ...]:
    """Return the names below its stream of the section or the field that an error is about."""
    below = error.partition(f"stream.{stream}")[2]
    return tuple(filter(None, re.split(r": |[\[\]]", below, maxsplit=1)[0].split(".")))


def _with_names(text: str, names: Sequence[str], shared: bool, streams: int) -> str:
    """Add the names of the streams with the same error."""
    others = list(names if shared else names[1:])
    if not others or (shared and len(others) == streams):
        return text
    more = f" and {len(others) - MOST_NAMES} more" if len(others) > MOST_NAMES else ""
    shown = ", ".join(others[:MOST_NAMES]) + more
    return f"{text} ({'' if shared else 'the same '}in {shown})"
