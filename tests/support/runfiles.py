"""A small run file that the tests vary, a plugin file, and a JSON Schema validator."""

import copy
from pathlib import Path
from typing import Any

import pytest

import streamkit as sk

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*/*.toml"))

BASE: dict[str, Any] = {
    "seed": 7,
    "potential": {"kind": "tf", "v0": {"uniform": ["40 km/s", "400 km/s"]}, "rs": "12 kpc", "alpha": 0.45},
    "progenitor": {
        "kind": "plummer", "mass": {"log_uniform": [1e8, "1e9 Msun"]}, "radius": 0.85,
        "x": 19.0, "y": 0.0, "z": -5.7, "vx": 176.0, "vy": 0.0, "vz": "202 km/s",
        "lookback": {"uniform": [0, 10]},
    },
    "stripping": {"kind": "mlcs", "particles": 100, "sigma": {"normal": [10, 1]}},
}  # fmt: skip


def changed(*path_and_value: Any) -> dict[str, Any]:
    """Return BASE with one entry replaced, or removed if the value is ..."""
    return with_entry(BASE, *path_and_value)


def with_entry(whole: dict[str, Any], *path_and_value: Any) -> dict[str, Any]:
    """Return a copy of a run file with one entry replaced, or removed if the value is ..."""
    *path, value = path_and_value
    document = copy.deepcopy(whole)
    table = document
    for key in path[:-1]:
        table = table.setdefault(key, {})
    if value is ...:
        del table[path[-1]]
    else:
        table[path[-1]] = value
    return document


def error_of(source: Any) -> str:
    with pytest.raises(sk.SpecError) as caught:
        sk.load(source)
    return str(caught.value)


PLUGIN = '''
from typing import Any
from pydantic import Field, field_validator
from streamkit import Component, Length, Potential, Speed, hookimpl

class Cored(Potential):
    """A cored isothermal sphere."""

    kind = "cored"
    v: Speed = Field(gt=0, description="Speed far out.")
    core: Length = Field(default=1.0, description="Core radius.")

    @field_validator("core")
    @classmethod
    def _small(cls, value: float) -> float:
        if value > 5:
            raise ValueError("a core is at most 5 kpc")
        return value

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, v: Any, core: Any) -> Any:
        k = -v * v / (x * x + y * y + z * z + core * core)
        return k * x, k * y, k * z

@hookimpl
def streamkit_components() -> list[type[Component]]:
    return [Cored]
'''


def accepts(schema: dict[str, Any], value: Any, root: dict[str, Any]) -> bool:
    """Validate the part of JSON Schema that ours is written in; an unknown keyword is an error."""
    types = {
        "object": dict,
        "array": list,
        "string": str,
        "integer": int,
        "number": (int, float),
        "boolean": bool,
    }
    wanted = schema.get("type", [])
    names = [wanted] if isinstance(wanted, str) else wanted
    if names and not any(name != "null" and isinstance(value, types[name]) for name in names):
        return False
    checks = {
        "$ref": lambda ref: accepts(root["$defs"][ref.removeprefix("#/$defs/")], value, root),
        "anyOf": lambda options: any(accepts(option, value, root) for option in options),
        "oneOf": lambda options: sum(accepts(option, value, root) for option in options) == 1,
        "const": lambda wanted: value == wanted,
        "enum": lambda wanted: value in wanted,
        "minimum": lambda bound: value >= bound,
        "maximum": lambda bound: value <= bound,
        "exclusiveMinimum": lambda bound: value > bound,
        "exclusiveMaximum": lambda bound: value < bound,
        "minItems": lambda bound: len(value) >= bound,
        "maxItems": lambda bound: len(value) <= bound,
        "minProperties": lambda bound: len(value) >= bound,
        "items": lambda item: all(accepts(item, member, root) for member in value),
        "prefixItems": lambda items: all(accepts(s, v, root) for s, v in zip(items, value, strict=False)),
        "required": lambda names: all(name in value for name in names),
        "properties": lambda known: all(accepts(known[k], v, root) for k, v in value.items() if k in known),
        "additionalProperties": lambda rest: all(
            rest is True or (rest is not False and accepts(rest, value[key], root))
            for key in value.keys() - schema.get("properties", {}).keys()
        ),
    }  # fmt: skip
    plain = {"type", "title", "description", "default", "examples", "$schema", "$defs"}
    assert set(schema) <= checks.keys() | plain, set(schema) - checks.keys() - plain
    return all(checks[key](argument) for key, argument in schema.items() if key in checks)
