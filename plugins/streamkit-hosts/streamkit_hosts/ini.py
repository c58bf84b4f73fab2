"""Read the INI files of AGAMA: sections with parameters, and what follows the words Coefficients or Timestamps."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from streamkit import StreamkitError
from streamkit_hosts.text import text_of

MOST_BYTES = 200_000_000  # of a file
DEEPEST = 4  # files that name files


@dataclass(frozen=True)
class Section:
    """A section: its parameters with names in small letters, and the lines after Coefficients or Timestamps."""

    file: Path
    name: str
    parameters: dict[str, str] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)

    @property
    def where(self) -> str:
        """The file and the section, for messages."""
        return f"{self.file} [{self.name}]"


def sections_of(path: Path, depth: int = 0) -> list[Section]:
    """Return the potentials of a file, and in place of a section that names another file, those of that file."""
    if depth > DEEPEST:
        raise StreamkitError(f"{path}: its files name files that name files, more than {DEEPEST} deep")
    found: list[Section] = []
    table = False
    for line in text_of(path, MOST_BYTES).splitlines():
        text = line.strip()
        if text.startswith("[") and text.endswith("]"):
            found.append(Section(path, text[1:-1].strip()))
            table = False
        elif found and (table or text.lower() in ("coefficients", "timestamps")):
            if table:
                found[-1].lines.append(line)
            table = True
        elif found and text and text[0] not in "#;":
            name, sign, value = text.partition("=")
            if not sign:
                raise StreamkitError(f"{found[-1].where}: found {text[:60]!r}, expected name = value")
            found[-1].parameters[name.strip().lower()] = value.partition("#")[0].strip()
    potentials = [section for section in found if section.name.lower().startswith("potential")]
    if not potentials:
        raise StreamkitError(f"{path}: has no section [Potential]")
    out = []
    for section in potentials:
        if "type" in section.parameters:
            out.append(section)
            continue
        if "file" not in section.parameters:
            raise StreamkitError(f"{section.where}: has neither a type nor a file")
        for inner in sections_of(path.parent / section.parameters["file"], depth + 1):
            both = {k: _from(path, v) for k, v in section.parameters.items() if k != "file"} | inner.parameters
            if len(both) < len(section.parameters) - 1 + len(inner.parameters):
                raise StreamkitError(f"{section.where}: sets again what {inner.where} sets")
            out.append(Section(inner.file, inner.name, both, inner.lines))
    return out


def _from(path: Path, value: str) -> str:
    """Return a value; the whole path of a file beside the file that names it."""
    return str((path.parent / value).resolve()) if (path.parent / value).is_file() else value
