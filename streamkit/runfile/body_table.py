"""Many bodies, as the rows of one table: with a place today each, or with the encounter of each with a stream."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from streamkit.components import Potential
from streamkit.fields import Columns, Files, Table
from streamkit.runfile.encounter import ENCOUNTER, Encounter
from streamkit.runfile.progenitor import BODY_WAYS, BodyPlace, choose_coordinates
from streamkit.runfile.section import Section, read_section
from streamkit.runfile.sentences import sentence
from streamkit.stream import Frame
from streamkit.units import PositiveNumber, unit_of

TABLE = "table"  # the field of a body that holds it
TABLE_WAYS = tuple(way for way in BODY_WAYS if "frame" not in way.model_fields)  # the sets of coordinates of a table
MOST_ROWS = 100  # with a place today: their forces act on all particles at all times
MET = {name: unit.name for name, field in Encounter.model_fields.items() if (unit := unit_of(field)) is not None}


class Meeting(BaseModel):
    """What the encounters of all bodies of a table share."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    stream: str | None = Field(default=None, description=Encounter.model_fields["stream"].description)
    frame: Frame = Field(default=None, description=Encounter.model_fields["frame"].description)


class Together(BaseModel):
    """What the bodies of a table with places today share."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    friction: Literal["chandrasekhar", "none"] = Field(
        default="chandrasekhar", description=BodyPlace.model_fields["friction"].description
    )
    reflex: bool = Field(default=True, description=BodyPlace.model_fields["reflex"].description)


class BodyTable(BaseModel):
    """Many bodies, each a row of a table: subhaloes of a mass function that flew past a stream, or satellite galaxies.

    The columns are the numbers of the potential, such as mass and radius, and those of an encounter, or of a place
    today: ra, dec, distance, pm_ra_cosdec, pm_dec, v_los; l, b ...; or x, y, z, vx, vy, vz. A row is a body with these
    numbers in a section of its own; one with a place today pulls all streams, at most 100 of them. The table has no
    priors; ``mass_factor`` may have one.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    potential: ClassVar[type[Potential]]
    place: ClassVar[type[BaseModel]] = Encounter

    kind: str = Field(description="The potential of all bodies: one with a mass in Msun.")
    table: Annotated[Table, Columns(mass="Msun", **MET)] = Field(
        description="The mass, the sizes and the encounter or the place of each body."
    )
    mass_factor: PositiveNumber = Field(default=1.0, description="Number by which all masses are multiplied.")

    def bodies(self, shared: Meeting | Together) -> Iterator[tuple[Potential, Any]]:
        """Yield the potential of each body and its encounter, or its place; ValidationError for a number."""
        columns = self.table.to_dict()
        for row in zip(*columns.values(), strict=True):
            numbers = dict(zip(columns, row, strict=True))
            place = {name: numbers.pop(name) for name in columns if name in self.place.model_fields}
            numbers["mass"] *= self.mass_factor
            yield self.potential.model_validate(numbers), self.place(**dict(shared), **place)


@cache
def body_table_of(cls: type[Potential], place: type[BaseModel] | None = Encounter) -> type[BodyTable]:
    """Return the class of the tables of bodies with this potential, with its columns and those of their places.

    Without a ``place``, for the schema, it has those of all places, which may be missing.
    """
    units = {name: unit.name for name, unit in cls.parameters().items()}
    needed = {name: unit for name, unit in units.items() if cls.model_fields[name].is_required()}
    where = {} if place is None else MET if place is Encounter else _coordinates(place)
    rest = {} if place else MET | {name: unit for way in TABLE_WAYS for name, unit in _coordinates(way).items()}
    rest |= units
    columns = Columns(**needed, **where).optional(**{k: unit for k, unit in rest.items() if k not in needed})
    table: Any = Annotated[Table, columns], Field(description=BodyTable.model_fields[TABLE].description)
    made = create_model("BodyTable", __base__=BodyTable, __doc__=BodyTable.__doc__, table=table)
    made.potential, made.place = cls, place or Encounter
    return made


def _coordinates(place: Any) -> dict[str, str]:
    """Return the units of the coordinates of a place today, by their names."""
    units = {name: unit_of(place.model_fields[name]) for name in place.coordinates()}
    return {name: unit.name for name, unit in units.items() if unit is not None}


def read_body_table(
    path: str, cls: type[Potential], table: Mapping[str, Any], errors: list[str], files: Files
) -> tuple[Section[BodyTable] | None, Section[Any] | None]:
    """Validate the section of a table of bodies, and what they share; on failure add sentences."""
    names = _columns(table[TABLE], files)
    if names and ENCOUNTER not in table and not names & (MET.keys() - cls.model_fields.keys()):
        return _read_places(path, cls, table, names, errors, files)
    fields, shared = dict(table), table.get(ENCOUNTER, {})
    fields.pop(ENCOUNTER, None)
    if _massless(path, cls, errors):
        return None, None
    if not isinstance(shared, Mapping):
        errors.append(f"{path}.{ENCOUNTER}: found {shared!r}, expected a table with stream or frame, or none")
        return None, None
    if twice := [name for name in shared if name in Encounter.model_fields and name not in Meeting.model_fields]:
        errors.append(f"{path}.{ENCOUNTER}.{twice[0]}: found beside a table of bodies, which has a column for it")
        return None, None
    called = f"the table of bodies ({cls.kind})"
    section = read_section(path, body_table_of(cls), fields, errors, called, (ENCOUNTER,), files)
    meeting = read_section(f"{path}.{ENCOUNTER}", Meeting, shared, errors, "the encounter of a table of bodies")
    return (section, meeting) if _rows_allowed(section, meeting, errors) else (None, None)


def _read_places(
    path: str, cls: type[Potential], table: Mapping[str, Any], names: set[str], errors: list[str], files: Files
) -> tuple[Section[BodyTable] | None, Section[Together] | None]:
    """Validate the section of a table with places today, and what the bodies share; on failure add sentences."""
    if _massless(path, cls, errors):
        return None, None
    try:
        way = choose_coordinates(names - cls.model_fields.keys(), cls.model_fields, TABLE_WAYS)
    except ValueError as error:
        errors.append(f"{path}.{TABLE}: {error} Or expected those of an encounter: {', '.join(MET)}.")
        return None, None
    shared = {key: value for key, value in table.items() if key in Together.model_fields}
    fields = {key: value for key, value in table.items() if key not in shared}
    called, more = f"the table of bodies ({cls.kind})", tuple(Together.model_fields)
    section = read_section(path, body_table_of(cls, way), fields, errors, called, more, files)
    together = read_section(path, Together, shared, errors, called)
    if section is not None and (rows := len(section.centre.table)) > MOST_ROWS:
        errors.append(f"{path}.{TABLE}: found {rows} bodies with places today, expected at most {MOST_ROWS}")
        return None, None
    return (section, together) if _rows_allowed(section, together, errors) else (None, None)


def _columns(value: Any, files: Files) -> set[str]:
    """Return the names of the columns that a table has; none where it cannot be read, which is told later."""
    given: Any = {"file": str(value)} if isinstance(value, str | Path) else value
    if not isinstance(given, Mapping):
        return set()
    if "file" not in given:
        return set(given)
    try:
        renamed = given.get("columns", {})
        return set(files.names(given["file"])) - set(renamed.values()) | set(renamed)
    except (ValueError, TypeError, AttributeError):
        return set()


def _massless(path: str, cls: type[Potential], errors: list[str]) -> bool:
    """Return whether bodies of this kind have no mass, with a sentence."""
    if "mass" in cls.parameters() and cls.parameters()["mass"].name == "Msun":
        return False
    errors.append(f"{path}.kind: the potential {cls.kind!r} has no field 'mass' in Msun; bodies need one")
    return True


def _rows_allowed(section: Section[BodyTable] | None, shared: Section[Any] | None, errors: list[str]) -> bool:
    """Return whether both sections are valid with all rows; add a sentence for the first row that is not."""
    if section is None or shared is None:
        return False
    read = []
    try:
        for body in section.centre.bodies(shared.centre):
            read.append(body)
    except ValidationError as error:
        item, table = error.errors()[0], section.centre
        of = table.place if item["loc"][:1] and item["loc"][0] in table.place.model_fields else table.potential
        row = f"row {len(read) + 1}"
        where = f"{section.path}.{TABLE}: {row}"
        errors.append(sentence(where, of, item, "the body").replace(f"{row}.", f"{row}, ", 1))
        return False
    return True
