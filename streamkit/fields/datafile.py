"""A data file of any format as a field: its path, and the digest of its content."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from streamkit.errors import SpecError
from streamkit.fields.files import Files


@dataclass(frozen=True)
class DataFile:
    """A file that a run file names, relative to itself. Two are equal if their contents are."""

    path: Path = field(compare=False)
    """Its absolute path."""
    sha256: str
    """The digest of its content when the run file was read."""

    def read_bytes(self) -> bytes:
        """Return its content; SpecError if the file is gone, or has changed since the run file was read."""
        try:
            content = self.path.read_bytes()
        except OSError as error:
            raise SpecError(f"cannot read the data file {str(self.path)!r}: {error.strerror}") from None
        if hashlib.sha256(content).hexdigest() != self.sha256:
            raise SpecError(f"the data file {str(self.path)!r} has changed since the run file was read")
        return content

    def read_text(self) -> str:
        """Return its content as text in UTF-8; raises as `read_bytes`, and for other bytes."""
        try:
            return self.read_bytes().decode()
        except UnicodeDecodeError as error:
            raise SpecError(f"{self.path}: not a text file in UTF-8: {error.reason} at byte {error.start}") from None

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Read a path, write it."""
        return core_schema.with_info_plain_validator_function(
            lambda value, info: cls._read(value, info.context),
            serialization=core_schema.plain_serializer_function_ser_schema(lambda file: str(file.path)),
        )

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Describe the path."""
        return {"type": "string", "examples": ["table.dat"]}

    @classmethod
    def _read(cls, value: Any, files: Files | None) -> DataFile:
        if isinstance(value, DataFile):
            return value
        if not isinstance(value, str | Path):
            raise ValueError(f"found {value!r}, expected the name of a file in quotes")
        files = files or Files()
        files.content(str(value))
        return cls((files.folder / value).absolute(), files.read[str(value)])
