"""What a plugin must provide, refused where it is loaded and not where it is used."""

import pytest

import streamkit as sk
from streamkit import registry

CALL = "    @staticmethod\n    def acceleration(x, y, z, t):\n        return x, y, z\n"


@pytest.mark.parametrize(
    ("base", "body", "wanted"),
    [
        ("Potential", f"    kind: str = 'x'\n{CALL}", "a field called 'kind', which in a run file names the component"),
        ("Stripping", "    kind = 'x'\n    def release(self, *a): ...", "X does not define draws, which every strip"),
        ("Integrator", "    kind = 'x'\n    def advance(self, *a): ...", "X does not define order, which every integr"),
        ("Component", "    kind = 'x'", "is no component class: potential, stripping, integrator, observable"),
    ],
)
def test_a_class_that_is_half_a_component(tmp_path, base, body, wanted):
    file = tmp_path / "half.py"
    hook = "@hookimpl\ndef streamkit_components():\n    return [X]\n"
    file.write_text(f"from streamkit import Component, {base}, hookimpl\nclass X({base}):\n{body}\n{hook}")
    with pytest.raises(sk.PluginError) as caught:
        registry.load([file])
    assert str(caught.value).startswith("half.py sha256:")
    assert wanted in str(caught.value)


@pytest.mark.parametrize("result", ["None", "1 / 0", "[None]"])
def test_a_hook_that_gives_no_list(tmp_path, result):
    file = tmp_path / "half.py"
    file.write_text(f"from streamkit import hookimpl\n@hookimpl\ndef streamkit_components():\n    return {result}\n")
    with pytest.raises(sk.PluginError, match=r"half\.py sha256:\w+: (the hook .* gives no list|None is no comp)"):
        registry.load([file])
