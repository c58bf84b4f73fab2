"""The JSON Schema: accepts the examples, refuses what `load` refuses."""

import tomllib
from pathlib import Path
from typing import Any

import pytest
from runfiles import BASE, EXAMPLES, accepts, changed, error_of

import streamkit as sk
from streamkit.components import load_registry
from streamkit.runfile import json_schema


def satisfies(path: Path, schema: dict[str, Any]) -> bool:
    document = tomllib.loads(path.read_text())
    return accepts(schema, document, schema) and accepts(schema, sk.load(path).document, schema)


def test_an_example_satisfies_the_schema(schema: dict[str, Any]) -> None:
    assert satisfies(next(path for path in EXAMPLES if path.stem == "gd1"), schema)


@pytest.mark.slow
def test_all_examples_satisfy_the_schema_of_all_components() -> None:
    schema = json_schema(load_registry())
    assert not [path.stem for path in EXAMPLES if not satisfies(path, schema)]


@pytest.mark.parametrize(
    "source",
    [
        changed("potential", "r_s", 3),
        changed("potential", "rs", -1),
        changed("potential", "rs", ...),
        changed("potential", "v0", {"unifrom": [1, 2]}),
        changed("potential", "v0", {"uniform": [1, 2, 3]}),
        changed("stripping", "kind", "mlsc"),
        changed("stripping", "particles", "10"),
        changed("stripping", ...),
        changed("progenitor", "l", 3),
        changed("progenitor", "kind", "tf"),
        changed("progenitor", "growth", {"t": [-1, 0], "factor": [0.5, 1]}),
        changed("version", 2),
        changed("potenial", {}),
        changed("observable", {"kind": "apocentres", "leading": [1]}),
        changed("observable", {"one": {"kind": "apocentres", "leading": [1]}}),
        changed("stream", {"gd1": {"progenitor": BASE["progenitor"], "stripping": BASE["stripping"]}}),
    ],
)
def test_the_schema_refuses_what_load_refuses(source: dict[str, Any], schema: dict[str, Any]) -> None:
    assert accepts(schema, BASE, schema)
    assert accepts(schema, changed("potential", "growth", {"t": [-1, 0], "factor": [0.5, 1]}), schema)
    assert not accepts(schema, source, schema)
    error_of(source)
