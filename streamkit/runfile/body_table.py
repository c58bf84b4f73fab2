"""Many bodies that have flown past a stream, as the rows of one table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from streamkit.components import Potential
from streamkit.fields import Columns, Files, Table
from streamkit.runfile.encounter import ENCOUNTER, Encounter
from streamkit.runfile.section import Section, read_section
from streamkit.runfile.sentences import sentence
from streamkit.stream import Frame
from streamkit.units import PositiveNumber, unit_of

TABLE = "table"  # the field of a body that holds it
MET = {name: unit.name for name, field in Encounter.model_fields.items() if (unit := unit_of(field)) is not None}


class Meeting(BaseModel):
    """What the encounters of all bodies of a table share."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    stream: str | None = Field(default=None, description=Encounter.model_fields["stream"].description)
    frame: Frame = Field(default=None, description=Encounter.model_fields["frame"].description)


class BodyTable(BaseModel):
    """Bodies that have flown past a stream, such as the subhaloes of a mass function: each is a row of a table.

    The columns are the numbers of the potential, such as mass and radius, and those of an encounter. A row is a body
    with these numbers in a section of its own. The table has no priors; ``mass_factor`` may have one.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    potential: ClassVar[type[Potential]]

    kind: str = Field(description="The potential of all bodies: one with a mass in Msun.")
    table: Annotated[Table, Columns(mass="Msun", **MET)] = Field(
        description="The mass, the sizes and the encounter of each body."
    )
    mass_factor: PositiveNumber = Field(default=1.0, description="Number by which all masses are multiplied.")

    def bodies(self, meeting: Meeting) -> Iterator[tuple[Potential, Encounter]]:
        """Yield the potential and the encounter of each body; ValidationError if a number is not allowed."""
        columns = self.table.to_dict()
        for row in zip(*columns.values(), strict=True):
            numbers = dict(zip(columns, row, strict=True))
            met = {name: numbers.pop(name) for name in columns if name in Encounter.model_fields}
            numbers["mass"] *= self.mass_factor
            yield (
                self.potential.model_validate(numbers),
                Encounter(stream=meeting.stream, frame=meeting.frame, **met),
            )


@cache
def body_table_of(cls: type[Potential]) -> type[BodyTable]:
    """Return the class of the tables of bodies with this potential, with its columns."""
    units = {name: unit.name for name, unit in cls.parameters().items()}
    needed = {name: unit for name, unit in units.items() if cls.model_fields[name].is_required()}
    columns = Columns(**needed, **MET).optional(**{name: unit for name, unit in units.items() if name not in needed})
    table: Any = Annotated[Table, columns], Field(description=BodyTable.model_fields[TABLE].description)
    made = create_model("BodyTable", __base__=BodyTable, __doc__=BodyTable.__doc__, table=table)
    made.potential = cls
    return made


def read_body_table(
    path: str, cls: type[Potential], table: Mapping[str, Any], errors: list[str], files: Files
) -> tuple[Section[BodyTable] | None, Section[Meeting] | None]:
    """Validate the section of a table of bodies, and what their encounters share; on failure add sentences."""
    fields, shared = dict(table), table.get(ENCOUNTER, {})
    fields.pop(ENCOUNTER, None)
    if "mass" not in cls.parameters() or cls.parameters()["mass"].name != "Msun":
        errors.append(f"{path}.kind: the potential {cls.kind!r} has no field 'mass' in Msun; bodies need one")
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
    if section is not None and meeting is not None:
        read = []
        try:
            for body in section.centre.bodies(meeting.centre):
                read.append(body)
        except ValidationError as error:
            item = error.errors()[0]
            of = Encounter if item["loc"][:1] and item["loc"][0] in Encounter.model_fields else cls
            row = f"row {len(read) + 1}"
            errors.append(sentence(f"{path}.{TABLE}: {row}", of, item, "the body").replace(f"{row}.", f"{row}, ", 1))
            return None, None
    return section, meeting
