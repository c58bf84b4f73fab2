"""Presets: published models by name, as the named potentials that the resolved run file holds."""

import numpy as np
import pytest
from runfiles import changed

import streamkit as sk
from streamkit.builtin.potentials.milky_way import GALA_V2
from streamkit.components import load_registry


def spec(table):
    return sk.load(changed("potential", table))


def test_a_preset_is_its_named_potentials():
    named, short = spec(dict(GALA_V2.sections)), spec({"preset": "gala_v2"})
    assert short.digest() == named.digest()
    assert list(short.document["potential"]) == ["preset", *GALA_V2.sections]
    assert 'preset = "gala_v2"' in short.toml()


def test_a_resolved_run_file_reads_back(tmp_path):
    ours = spec({"preset": "gala_v2", "halo": {"mass": {"uniform": [4e11, 7e11]}}})
    (tmp_path / "run.toml").write_text(ours.toml())
    again = sk.load(tmp_path / "run.toml")
    assert again.document == ours.document
    assert again.digest() == ours.digest()
    other = ours.with_values({"potential.halo.kind": "nfw_triaxial", "potential.halo.q": 0.9})
    assert other.document["potential"]["halo"]["kind"] == "nfw_triaxial"


def test_own_sections_change_a_field_a_kind_or_add_a_potential():
    result = {
        "halo": {"mass": {"log_uniform": ["3e11 Msun", "9e11 Msun"]}},
        "disc": {"kind": "miyamoto_nagai", "mass": 6.8e10, "a": 3.0, "b": 0.28},
        "bar": {"kind": "plummer", "mass": 1e9, "radius": 1.0},
    }
    ours = spec({"preset": "gala_v2"} | result)
    document = ours.document["potential"]
    assert ours.names[:1] == ("potential.halo.mass",)
    assert document["halo"]["rs"] == "15.626 kpc"
    assert document["disc"] == {"kind": "miyamoto_nagai", "mass": "68000000000.0 Msun", "a": "3.0 kpc", "b": "0.28 kpc"}
    assert list(document) == ["preset", "bulge", "nucleus", "disc", "halo", "bar"]
    assert np.isfinite(sk.Model(ours).stream().q).all()


def test_other_specs_do_not_see_a_change():
    spec({"preset": "gala_v2", "halo": {"mass": 1e12}})
    assert spec({"preset": "gala_v2"}).document["potential"]["halo"]["mass"] == "554270000000.0 Msun"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"preset": "gala_2"}, "potential.preset: no model is called 'gala_2'. Did you mean 'gala_v2'?"),
        ({"preset": 3}, "potential.preset: no model is called 3"),
        ({"preset": ["gala_v2"]}, "potential.preset: no model is called"),
        ({"preset": "gala_v2", "mass": 1e12}, "potential.mass: found 1000000000000.0 beside a preset"),
        ({"preset": "gala_v2", "kind": "nfw"}, "potential.kind: found 'nfw' beside a preset"),
        ({"preset": "gala_v2", "halo": {"masss": 1.0}}, "potential.halo.masss"),
        ({"preset": "gala_v2", "hole": {"mass": 4e6}}, "potential.hole: 'kind' is missing"),
    ],
)
def test_bad_presets(table, message):
    with pytest.raises(sk.SpecError) as error:
        spec(table)
    assert message in str(error.value)


def test_a_plugin_file_may_bring_a_preset(tmp_path):
    (tmp_path / "models.py").write_text(
        "from streamkit import Preset, hookimpl\n"
        "@hookimpl\ndef streamkit_components():\n"
        "    return [Preset('mine', 'A paper', {'halo': {'kind': 'nfw', 'mass': 4e11, 'rs': 16.0}})]\n"
    )
    assert load_registry([tmp_path / "models.py"]).presets["mine"].sections["halo"]["mass"] == 4e11
