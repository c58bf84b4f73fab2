"""Read a file of text that people have."""

from __future__ import annotations

from pathlib import Path

from streamkit import StreamkitError


def text_of(path: Path, most: int) -> str:
    """Return the text of a file of at most ``most`` bytes; StreamkitError with a sentence for anything else."""
    if not path.is_file():
        raise StreamkitError(f"{path}: {'is a directory' if path.is_dir() else 'there is no such file'}")
    if (size := path.stat().st_size) > most:
        raise StreamkitError(f"{path}: has {size} bytes; expected at most {most}")
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise StreamkitError(f"{path}: cannot be read as text: {error}") from None


