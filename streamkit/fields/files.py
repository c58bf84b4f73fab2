"""The data files of a run file: their folder, contents and digests; and a file of any format as a field."""

from __future__ import annotations

import csv
import hashlib
import io
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from streamkit.errors import SpecError, expect_file, nearest
from streamkit.stream import Array
from streamkit.units import Unit, spelled

if TYPE_CHECKING:
    from astropy.table import Table


# Suffixes of tables, with astropy's names of their formats. A `.npy` file holds one array.
FORMATS = {".ecsv": "ascii.ecsv", ".csv": "ascii.csv", ".fits": "fits", ".fit": "fits"}
# The beginning of that part of an ECSV file's header which makes quantities of its columns.
SERIALIZED = "__serialized_columns__"
# What a unit of another dimension may mean, by the unit that was found and the one that is expected.
FOREIGN = {
    ("mag", "kpc"): ". A distance modulus has a name of its own: distance_modulus",
    ("kpc", "mag"): ". A distance has a name of its own: distance",
}
_COMMAS = re.compile(r"(?m)^# delimiter: [\"']?,")


@dataclass
class Files:
    """The data files that the fields of one run file name: each is read once."""

    folder: Path = field(default_factory=Path.cwd)  # the folder that paths are relative to
    # Former SHA-256 of files by their names in the run file: another content is then an error.
    expected: Mapping[str, str] = field(default_factory=dict)
    read: dict[str, str] = field(default_factory=dict)  # SHA-256 of the files that have been read
    _contents: dict[str, bytes] = field(default_factory=dict, repr=False)

    def content(self, name: str) -> bytes:
        """Return the content of a file; ValueError if it cannot be read, or has changed."""
        if name not in self._contents:
            path = self.folder / name
            try:
                expect_file(path)
                content = path.read_bytes()
            except OSError as error:
                raise ValueError(f"cannot read the file {name!r} ({error.strerror}) in {self.folder}") from None
            digest = hashlib.sha256(content).hexdigest()
            if self.expected.get(name, digest) != digest:
                raise ValueError(f"the file {name!r} has changed since it was read first")
            self._contents[name], self.read[name] = content, digest
        return self._contents[name]

    def array(self, name: str) -> Array:
        """Return the array in a `.npy` file; ValueError if there is none, or one of objects."""
        with np.errstate(all="ignore"):
            try:
                array = np.load(io.BytesIO(self.content(name)), allow_pickle=False)
                if isinstance(array, np.ndarray) and array.dtype.kind in "iuf":
                    return np.asarray(array, dtype=float)
            except (ValueError, OSError, EOFError) as error:
                if name not in self._contents:
                    raise
                raise ValueError(f"{name!r} is no array in numpy's format ({error})") from None
        raise ValueError(f"{name!r} holds no array of numbers")

    def stated_unit(self, name: str, column: str) -> str:
        """Return the unit that a table states for a column; empty if it states none."""
        return spelled(self._tables(name)[0][column].unit or "")

    def header(self, name: str) -> dict[str, Any]:
        """Return what a table says of itself beside its columns; ValueError if the file holds none."""
        return dict(self._tables(name)[0].meta)

    def names(self, name: str) -> list[str]:
        """Return the names of the columns of a table; ValueError if the file holds none."""
        return list(self._tables(name)[0].colnames)

    def column(
        self, name: str, column: str, unit: Unit, given_unit: Any = None, key: str = "unit", *, gaps: bool = False
    ) -> Array:
        """Return a column of a table, (n,) in a unit.

        The file is ECSV, FITS or CSV. ``given_unit`` is the unit in the run file of a column for which the file gives
        none, and ``key`` the key of that unit in messages: the text before `` = "deg"``. With ``gaps`` values may be
        missing; they are then NaN.

        Raises ValueError for a file that holds no table, a column that is missing (names the nearest), has no unit or
        one of another dimension, has no numbers, or lacks some.
        """
        table, plain = self._tables(name)
        if column not in table.colnames:
            names = ", ".join(table.colnames)
            raise ValueError(f"{name!r} has no column {column!r}.{nearest(column, table.colnames)} It has: {names}.")
        values, where = table[column], f"column {column!r} of {name!r}"
        holes = np.zeros(len(table), dtype=bool)
        for each in (table, plain):
            mask = getattr(each[column], "mask", None) if each is not None and column in each.colnames else None
            if mask is not None:
                holes |= np.atleast_1d(mask)
        if holes.any() and not gaps:
            hole = int(np.argmax(holes))
            raise ValueError(f"{where}: the value of row {hole + 1} is missing; expected a number in each row")
        if values.dtype.kind not in "iuf":
            raise ValueError(f"{where}: found {str(values[0]) if len(values) else 'nothing'!r}, expected numbers")
        with np.errstate(over="ignore"):  # the field says what is too large
            numbers = np.asarray(values, dtype=float) * self._factor(where, values.unit, unit, given_unit, key)
        return np.where(holes, np.nan, numbers) if holes.any() else numbers

    @staticmethod
    def _factor(where: str, file_unit: Any, unit: Unit, given_unit: Any, key: str) -> float:
        from astropy import units as u  # slow to import, and only tables need it

        if file_unit is None and given_unit is None and unit.name:
            raise ValueError(
                f"{where}: the file gives no unit, expected one like {unit.name}. Write it into the file, or beside "
                f'it in the run file: {key} = "{unit.name}"{" }" if "{" in key else ""}'
            )
        try:
            with warnings.catch_warnings(action="ignore", category=u.UnitsWarning):  # of km/s/kpc
                given = u.Unit(str(given_unit or "")) if file_unit is None else file_unit
            return float((given or u.dimensionless_unscaled).to(unit.name or u.dimensionless_unscaled))
        except (ValueError, u.UnitConversionError):
            text = spelled(given_unit if file_unit is None else file_unit)
            raise ValueError(
                f"{where}: found the unit {text!r}, expected {unit.label} or one like it"
                + FOREIGN.get((text, unit.name), "")
            ) from None

    def _tables(self, name: str) -> tuple[Table, Table | None]:
        suffix = Path(name).suffix.lower()
        if suffix not in FORMATS:
            raise ValueError(
                f"{name!r}: the suffix says the format and must be one of {', '.join(FORMATS)}; found {suffix!r}"
            )
        return _parsed(name, self.content(name))


@lru_cache(maxsize=64)
def _parsed(name: str, raw: bytes) -> tuple[Table, Table | None]:
    """Return a table, and the same without quantities where its header makes some. Nobody changes them.

    Of a quantity that it has written, astropy reads a missing value as zero: the mask is in the plain one alone.
    A run file is read several times by one command, and astropy takes some 20 ms a table.
    """
    from astropy.table import Table  # slow to import, and only tables need it

    suffix, plain = Path(name).suffix.lower(), None
    if not raw.strip():
        raise ValueError(f"{name!r} is empty; expected a table in the format {suffix[1:].upper()}")
    try:  # astropy takes a text without the end of a line for the name of a file
        content: Any = io.BytesIO(raw) if suffix.startswith(".fit") else raw.decode("utf-8-sig") + "\n"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table = Table.read(content, format=FORMATS[suffix])
            if suffix == ".ecsv" and SERIALIZED in content:
                plain = Table.read(content.replace(SERIALIZED, "plain"), format=FORMATS[suffix])
    except UnicodeDecodeError as error:
        raise ValueError(f"{name!r} is no text in UTF-8: {error.reason} at byte {error.start}") from None
    except Exception as error:  # each format has errors of its own
        text = " ".join(str(error).split())[:200]
        raise ValueError(f"{name!r} is no table in the format {suffix[1:].upper()} ({text})") from None
    if isinstance(content, str):
        _require_different(name, content)
    return table, plain


def _require_different(name: str, text: str) -> None:
    """Refuse a table with two columns of one name: astropy would rename the second."""
    header = next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")
    delimiter = " " if name.lower().endswith(".ecsv") and not _COMMAS.search(text) else ","
    names = next(csv.reader([header.strip()], delimiter=delimiter, skipinitialspace=True))
    if twice := [each for i, each in enumerate(names) if each in names[:i]]:
        raise ValueError(f"{name!r} has two columns {twice[0]!r}; each needs a name of its own")


@dataclass(frozen=True)
class DataFile:
    """A file that a run file names, relative to itself. Two are equal if their contents are."""

    path: Path = field(compare=False)
    """The absolute path."""
    sha256: str
    """The digest of the content when the run file was read."""

    def read_bytes(self) -> bytes:
        """Return the content; SpecError if the file is missing, or has changed since the run file was read."""
        try:
            content = self.path.read_bytes()
        except OSError as error:
            raise SpecError(f"cannot read the data file {str(self.path)!r}: {error.strerror}") from None
        if hashlib.sha256(content).hexdigest() != self.sha256:
            raise SpecError(f"the data file {str(self.path)!r} has changed since the run file was read")
        return content

    def read_text(self) -> str:
        """Return the content as UTF-8 text; raises as `read_bytes`, and for bytes that are not UTF-8."""
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
