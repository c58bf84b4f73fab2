"""JSON Schema of the run file, with every installed component: for editors, and for other programs."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Union

from pydantic import BaseModel, ConfigDict, Field, WithJsonSchema, create_model
from pydantic.json_schema import GenerateJsonSchema

from streamkit.components import Component, Registry
from streamkit.runfile.body_table import Meeting, Together, body_table_of
from streamkit.runfile.cross_checks import varies
from streamkit.runfile.encounter import Encounter
from streamkit.runfile.progenitor import BODY_WAYS, OTHER_NAMES, WAYS, Place, Sun
from streamkit.runfile.reader import DEFAULT_KIND, HOST_ALONE
from streamkit.runfile.section import section_model
from streamkit.runfile.settings import Engine, Likelihood, RunFile
from streamkit.runfile.stream_tables import ABOVE, SECTIONS

# A stream with defaults: fields of its sections may be missing.
PART = {
    "type": "object",
    "properties": {name: {"type": "object"} for name in SECTIONS}
    | {"frame": {"type": ["string", "object", "array"]}, "table": {"type": ["string", "object"]}},
    "additionalProperties": False,
}


class _Generator(GenerateJsonSchema):
    def normalize_name(self, name: str) -> str:
        """Name a definition by role and kind, ``potential.tf``: pydantic itself cuts what stands before a dot."""
        return name.replace("/", ".")

    def field_title_should_be_set(self, schema: Any) -> bool:
        """Leave out the titles, which only repeat the names."""
        return False


class _Met(BaseModel):
    """A body that flies past a stream: what stands in place of its place today."""

    title: ClassVar[str] = "encounter"
    encounter: section_model(Encounter) = Field(description="Where and when the body met a stream.")  # type: ignore[valid-type]  # made at run time


def json_schema(registry: Registry) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a run file for the components in the registry.

    A physical number is a number in the field's unit, a quantity as text, or a prior. A section with a
    ``kind`` is one of the installed components, by its constant ``kind``.
    """
    sections: dict[str, Any] = {
        role: Union[tuple(_component(entry.cls) for entry in entries.values())]  # noqa: UP007  of as many as there are
        for role, entries in registry.entries.items()
    }
    placed: Any = ("progenitor", WAYS), ("body", (*BODY_WAYS, _Met))
    progenitors, bodies = (
        tuple(
            _component(entry.cls, what, way)
            for entry in registry.entries["potential"].values()
            for way in ways
            if "mass" in entry.cls.parameters() or varies(entry.cls)
            if not entry.cls.model_fields.keys() & way.model_fields.keys()
        )
        for what, ways in placed
    )
    massive = [entry.cls for entry in registry.entries["potential"].values() if "mass" in entry.cls.parameters()]
    bodies += tuple(_rows(cls) for cls in massive if "table" not in cls.model_fields)
    for role in ("potential", "observable"):
        named = dict.__class_getitem__((str, sections[role]))
        sections[role] |= Annotated[named, Field(min_length=1)]
    if registry.presets:
        text = "A published model by its name; sections of your own beside it change or add a potential."
        names: Any = Literal[tuple(registry.presets)]
        sections["potential"] |= create_model(
            "Preset", __config__=ConfigDict(extra="allow"), __doc__=text, preset=(names, ...)
        )
    sections["data"] = dict.__class_getitem__((str, sections["data"]))
    sections["progenitor"] = Union[progenitors]  # noqa: UP007
    sections["body"] = dict.__class_getitem__((str, Union[bodies]))  # noqa: UP007
    of_a_stream: Any = {name: (sections[name], ...) for name in ("progenitor", "stripping")}
    of_a_stream["observable"] = sections["observable"], {}
    stream = create_model("Stream", __config__=RunFile.model_config, __doc__="One of several.", **of_a_stream)
    sections["stream"] = dict.__class_getitem__((str, stream))
    sections |= {cls.__name__.lower(): section_model(cls) for cls in (Sun, Likelihood, Engine)}
    fields: Any = {name: (sections.get(name, f.annotation), f) for name, f in RunFile.model_fields.items()}
    schema = create_model("RunFile", __config__=RunFile.model_config, __doc__="A run file of streamkit.", **fields)
    several = {"anyOf": [{"required": ["stream"]}, {"required": ["streams"]}]}
    of_streams = [{"required": [name]} for name in (*SECTIONS, "stream", "streams")]
    host_alone = {"required": ["data"], "not": {"anyOf": of_streams}}
    one_or_several = {"oneOf": [{"required": ["progenitor", "stripping"]}, several, host_alone]}
    made = schema.model_json_schema(schema_generator=_Generator)
    whole = made["properties"]["stream"]["additionalProperties"]
    made["properties"]["stream_defaults"] |= PART
    made["properties"]["stream"]["additionalProperties"] = {"anyOf": [whole, PART]}
    given_above = PART | {"anyOf": [{"required": [name]} for name in ABOVE]}
    complete = {"stream": {"additionalProperties": {"anyOf": [whole, given_above]}}}
    one_or_several["anyOf"] = [{"required": ["stream_defaults"]}, {"properties": complete}]
    for definition in made["$defs"].values():
        _allow_other_names(definition)
    return {"$schema": GenerateJsonSchema.schema_dialect} | made | one_or_several


def _component(cls: type[Component], what: str = "", way: type[Place | _Met] | None = None) -> type[BaseModel]:
    """Return the model of a section of this kind, or of a progenitor or body whose place is given in this way."""
    kind: Any = Annotated[Literal[cls.kind], WithJsonSchema({"const": cls.kind})]
    fields: Any = {"kind": (kind, cls.kind if way is None and DEFAULT_KIND.get(cls.role) == cls.kind else ...)}
    if way is None:
        base = section_model(cls, in_time=cls.role == "potential")
        made = create_model(f"{cls.role}/{cls.kind}", __base__=base, **fields)
        return _open(made) if varies(cls) else made
    bases = section_model(cls, HOST_ALONE), section_model(way)
    text = f"{section_model(cls).__doc__} As a {what}, its place given as: {way.title}."
    placed = create_model(f"{what}/{cls.kind}/{way.__name__}", __base__=bases, __doc__=text, **fields)
    return _open(placed) if varies(cls) else placed


def _rows(cls: Any) -> type[BaseModel]:
    """Return the model of a table of bodies with this potential."""
    kind: Any = Annotated[Literal[cls.kind], WithJsonSchema({"const": cls.kind})]
    meeting: Any = section_model(Meeting)
    bases = section_model(body_table_of(cls, None)), section_model(Together)
    return create_model(f"bodies/{cls.kind}", __base__=bases, kind=(kind, ...), encounter=(meeting, {}))


def _allow_other_names(definition: dict[str, Any]) -> None:
    """Allow the other name of a coordinate in the section of a progenitor or a body."""
    for other, name in OTHER_NAMES.items():
        if name in definition.get("required", ()):
            definition["properties"][other] = definition["properties"][name]
            definition["required"].remove(name)
            definition["oneOf"] = [{"required": [name]}, {"required": [other]}]


def _open(made: type[BaseModel]) -> type[BaseModel]:
    """Allow further fields."""
    made.model_config["extra"] = "allow"
    made.model_rebuild(force=True)
    return made
