"""Plugin files: found beside the run file, validated as strictly as built-ins, part of digest and schema."""

import json
import pickle
from pathlib import Path

import pytest
from runfiles import PLUGIN, accepts, changed, schema_with

import streamkit as sk
from streamkit.runfile import to_toml


@pytest.fixture
def plugin_run(tmp_path: Path) -> Path:
    (tmp_path / "cored.py").write_text(PLUGIN)
    document = changed("potential", {"kind": "cored", "v": {"uniform": ["100 km/s", "300 km/s"]}})
    path = tmp_path / "run.toml"
    path.write_text(to_toml({"plugins": ["cored.py"]} | document))
    return path


def test_a_plugin_file_beside_the_run_file(plugin_run: Path) -> None:
    spec = sk.load(plugin_run)
    assert spec.names[0] == "potential.v"
    assert spec.document["potential"]["core"] == "1.0 kpc"
    (_, _, supplier), *_ = spec.components()
    assert supplier.startswith("cored.py sha256:")
    again = pickle.loads(pickle.dumps(spec))
    assert again == spec
    assert again.digest() == spec.digest()
    assert spec.with_values({"potential.core": 2}).bind().potentials["potential"].model_dump()["core"] == 2.0
    digest = spec.digest()
    (plugin_run.parent / "cored.py").write_text(PLUGIN + "# changed\n")
    assert sk.load(plugin_run).digest() != digest


def test_paths_of_plugins_stay_as_written(plugin_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(plugin_run.parent)
    spec = sk.load("run.toml")
    monkeypatch.chdir("/")
    assert spec.document["plugins"] == ["cored.py"]
    assert str(plugin_run.parent) not in spec.toml()
    assert pickle.loads(pickle.dumps(spec)) == spec
    (plugin_run.parent / "resolved.toml").write_text(spec.toml())
    assert sk.load(plugin_run.parent / "resolved.toml").digest() == spec.digest()


def test_plugins_are_validated_as_strictly(plugin_run: Path) -> None:
    result = sk.load(plugin_run).registry
    for fields, part in [
        ({"v": -1}, "potential.v: found -1 km/s, should be greater than 0 (Speed far out)"),
        ({"v": 1, "cor": 1}, "potential.cor: the potential 'cored' has no field 'cor'. Did you mean 'core'?"),
        ({"v": 1, "core": 6}, "potential.core: found 6: a core is at most 5 kpc (Core radius)"),
        (
            {"v": 1, "core": {"uniform": [1, 6]}},
            "potential.core: the prior uniform(1, 6) kpc reaches outside",
        ),
        ({}, "potential.v: missing (Speed far out)"),
    ]:
        with pytest.raises(sk.SpecError) as caught:
            sk.load(changed("potential", {"kind": "cored"} | fields), registry=result)
        assert part in str(caught.value)


def test_the_schema_knows_plugins_and_is_json(plugin_run: Path) -> None:
    result = schema_with(sk.load(plugin_run).registry, "cored")
    assert json.loads(json.dumps(result)) == result
    assert result["$defs"]["potential.cored"]["properties"]["kind"] == {"const": "cored"}
    assert accepts(result, changed("potential", {"kind": "cored", "v": "200 km/s"}), result)
    assert not accepts(result, changed("potential", {"kind": "cored", "w": "200 km/s"}), result)
