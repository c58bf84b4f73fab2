"""The small run files that the tests vary, a plugin file, and a JSON Schema validator."""

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import streamkit as sk
from streamkit.components import Registry
from streamkit.runfile import json_schema

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*/*.toml"))

# Priors in every section and no observable: for what reads run files.
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

# A fit for what runs, stores and reports: a short piece of the Sagittarius stream on the sky. A call takes a fifth of
# the time of one with apocentres, and every stream of the prior has both observables.
FIT: dict[str, Any] = {
    "seed": 3,
    "potential": {"kind": "tf", "v0": {"uniform": [215, 245]}, "rs": 12, "alpha": {"uniform": [0.25, 0.45]}},
    "progenitor": {
        "kind": "plummer", "mass": 6.4e8, "radius": 0.85, "l": 5.5689, "b": -14.1669, "distance": 25.2,
        "pm_l_cosb": -2.44, "pm_b": 1.97, "v_los": 153, "lookback": 0.5,
    },
    "stripping": {"kind": "mlcs", "particles": 100, "sigma": 10},
    "integrator": {"kind": "leapfrog", "step": 0.06},
    "observable": {
        "kind": "track", "kernel": 4, "frame": {"pole": [128.9, -56.9], "origin": [283.6, -30.5]},
        "distance": {"phi1": [-5, 5], "distance": [24.6, 24.5], "error": [1, 1]},
        "radial_velocity": {"phi1": [-5, 5], "radial_velocity": [146, 124], "error": [10, 10]},
    },
    "sampler": {"walkers": 6, "steps": 4},
}  # fmt: skip

# The same satellite, long enough ago to have apocentres.
APOCENTRES: dict[str, Any] = FIT | {
    "progenitor": FIT["progenitor"] | {"lookback": 3.5},
    "stripping": {"kind": "mlcs", "particles": 600, "sigma": 10},
    "integrator": {"kind": "leapfrog", "step": 0.03},
    "observable": {"kind": "apocentres", "leading": [57, 5], "trailing": [112, 15], "precession": [100, 8]},
}

# Published values beside a run of `FIT`.
PUBLISHED = """quantity,radius,value,error_minus,error_plus,reference
M,100,4.1e11,0.7e11,0.8e11,Gibbons+ 2014
v_c,8,237,3,4,a <b>bold</b> guess
"""

# What commands are given, as text: mock 1 of Gibbons, Belokurov & Evans (2014).
RUN = """
seed = 7
[potential]
kind = "tf"
v0 = { uniform = ["190 km/s", "230 km/s"] }
rs = "12 kpc"
alpha = 0.45
[progenitor]
kind = "plummer"
mass = { log_uniform = ["3e8 Msun", "9e8 Msun"] }
radius = "0.85 kpc"
x = 19.155535
y = 0.0278852
z = -5.7149425
vx = 176.48999
vy = -0.36306170
vz = 201.58182
lookback = "3.77 Gyr"
[stripping]
kind = "mlcs"
particles = 400
[observable]
kind = "apocentres"
leading = ["57.0 kpc", "1.0 kpc"]
trailing = ["96.2 kpc", "5 kpc"]
precession = ["95.0 deg", "5 deg"]
[sampler]
walkers = 8
steps = 4
"""



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


def schema_with(registry: Registry, *kinds: str) -> dict[str, Any]:
    """Return the JSON Schema of run files with these potentials and all other components: sooner made than of all."""
    potentials = {kind: registry.entries["potential"][kind] for kind in ("tf", "plummer", *kinds)}
    return json_schema(replace(registry, entries={**registry.entries, "potential": potentials}))


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
        "not": lambda refused: not accepts(refused, value, root),
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


def several(*names: str, **host: Any) -> dict[str, Any]:
    """FIT with its stream under several names, each with a free velocity, and with more sections of the host."""
    document = copy.deepcopy(FIT)
    sections = {name: document.pop(name) for name in ("progenitor", "stripping", "observable")}
    sections["progenitor"]["v_los"] = {"normal": [153, 5]}
    document["sampler"] = {"walkers": 20}
    return document | host | {"stream": {name: copy.deepcopy(sections) for name in names}}
