"""JSON Schema of the run file, with every installed component: for editors, and for other programs."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from streamkit.components import Component, Registry
from streamkit.spec.priors import KINDS
from streamkit.spec.progenitor import WAYS, PhaseSpace, Sun
from streamkit.spec.reader import DEFAULT_KIND, VERSION
from streamkit.spec.settings import Likelihood, Sampler
from streamkit.units import Unit, unit_of

DIALECT = "https://json-schema.org/draft/2020-12/schema"
_NUMBER = {"type": ["number", "string"]}


def json_schema(registry: Registry) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a run file for the components in the registry.

    A physical number is a number in the field's unit, a quantity as text, or a prior. A section with a
    ``kind`` is one of the installed components, by its constant ``kind``.
    """
    definitions: dict[str, Any] = {"prior": _prior()}
    for role, entries in registry.entries.items():
        for kind, entry in entries.items():
            definitions[f"{role}.{kind}"] = _component(entry.cls, definitions, DEFAULT_KIND.get(role))
    progenitors = []
    for kind, entry in registry.entries["potential"].items():
        for way in WAYS:
            name = f"progenitor.{kind}.{way.__name__}"
            if "mass" in entry.cls.parameters() and not entry.cls.model_fields.keys() & way.model_fields.keys():
                definitions[name] = _progenitor(entry.cls, way, definitions)
                progenitors.append({"$ref": f"#/$defs/{name}"})
    potential = _one_of(registry, "potential")
    named = {"type": "object", "minProperties": 1, "additionalProperties": potential}
    properties = {
        "version": {"type": "integer", "const": VERSION, "default": VERSION},
        "seed": {"type": "integer", "minimum": 0, "default": 0, "description": "Of every random draw."},
        "plugins": {"type": "array", "items": {"type": "string"}, "description": "One-off plugin files."},
        "sun": _object(Sun, definitions),
        "potential": {"anyOf": [potential, named], "description": "One, or several by name that add up."},
        "progenitor": {"oneOf": progenitors},
        "stripping": _one_of(registry, "stripping"),
        "integrator": _one_of(registry, "integrator"),
        "observable": _one_of(registry, "observable"),
        "likelihood": _object(Likelihood, definitions),
        "sampler": _object(Sampler, definitions),
    }
    return {
        "$schema": DIALECT,
        "title": "streamkit run file",
        "type": "object",
        "properties": properties,
        "required": ["potential", "progenitor", "stripping"],
        "additionalProperties": False,
        "$defs": definitions,
    }


def _one_of(registry: Registry, role: str) -> dict[str, Any]:
    return {"oneOf": [{"$ref": f"#/$defs/{role}.{kind}"} for kind in registry.entries[role]]}


def _prior() -> dict[str, Any]:
    """Return the schema of ``{ uniform = [low, high] }`` and the others."""
    kinds = []
    for name, kind in KINDS.items():
        count = len(fields(kind))
        numbers = {"type": "array", "items": _NUMBER, "minItems": count, "maxItems": count}
        numbers["description"] = ", ".join(field.name for field in fields(kind))
        kinds.append(_closed({name: numbers}, [name], (kind.__doc__ or "").splitlines()[0]))
    return {"oneOf": kinds}


def _closed(properties: dict[str, Any], required: list[str], description: str) -> dict[str, Any]:
    return {
        "type": "object",
        "description": description,
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }


def _component(cls: type[Component], definitions: dict[str, Any], default_kind: str | None) -> dict[str, Any]:
    """Return the schema of a section with this kind, which may be left out if it is the default one."""
    schema = _object(cls, definitions, prefix=f"{cls.role}.{cls.kind}.")
    schema["properties"] = {"kind": {"const": cls.kind}} | schema["properties"]
    if cls.kind != default_kind:
        schema["required"] = ["kind", *schema["required"]]
    return schema


def _progenitor(cls: type[Component], way: type[PhaseSpace], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a progenitor with this potential whose place is given in this way."""
    schema, place = _component(cls, definitions, None), _object(way, definitions)
    schema["properties"] |= place["properties"]
    schema["required"] += place["required"]
    schema["description"] += f" As a progenitor, its place given as: {way.title}."
    return schema


def _object(cls: type[BaseModel], definitions: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the schema of a class; nested classes go into the definitions under their prefixed names."""
    own = cls.model_json_schema(ref_template=f"#/$defs/{prefix}{{model}}")
    definitions |= {prefix + name: schema for name, schema in own.get("$defs", {}).items()}
    properties = {}
    for name, field in cls.model_fields.items():
        schema = {key: value for key, value in own["properties"][name].items() if key != "title"}
        unit = unit_of(field)
        properties[name] = _number(schema, unit, _bounds(field)) if unit is not None else schema
    return _closed(properties, own.get("required", []), (cls.__doc__ or "").strip().splitlines()[0])


def _bounds(field: FieldInfo) -> dict[str, Any]:
    """Return a number's range; pydantic leaves it out of the schema of fields that parse quantities."""
    bounds: dict[str, Any] = {}
    for item in field.metadata:
        if isinstance(item, Gt):
            bounds["exclusiveMinimum"] = item.gt
        elif isinstance(item, Ge):
            bounds["minimum"] = item.ge
        elif isinstance(item, Lt):
            bounds["exclusiveMaximum"] = item.lt
        elif isinstance(item, Le):
            bounds["maximum"] = item.le
    return bounds


def _number(schema: dict[str, Any], unit: Unit, bounds: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a physical number."""
    out: dict[str, Any] = {"description": f"{schema.get('description', '')} Unit: {unit.label}.".strip()}
    if "default" in schema:
        out["default"] = schema["default"]
    text = {"type": "string", "examples": [unit.example]}
    return out | {"anyOf": [{"type": "number", **bounds}, text, {"$ref": "#/$defs/prior"}]}
