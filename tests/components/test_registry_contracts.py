"""What a plugin must provide, refused where it is loaded and not where it is used."""

import pytest

import streamkit as sk
from streamkit.components import load_registry

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
        load_registry([file])
    assert str(caught.value).startswith("half.py sha256:")
    assert wanted in str(caught.value)


HALF = """
from streamkit import Potential, hookimpl
class X(Potential):
    kind = 'half'
    def acceleration(x, y, z, t):
        return x, y, z
    acceleration = staticmethod(acceleration)
@hookimpl
def streamkit_components():
    {code}
"""


@pytest.mark.parametrize("code", ["return (X,)", "yield X", "return iter([X])"])
def test_a_hook_may_give_any_sequence(tmp_path, code):
    (tmp_path / "half.py").write_text(HALF.format(code=code))
    assert load_registry([tmp_path / "half.py"]).find("potential", "half", "").__name__ == "X"


@pytest.mark.parametrize("code", ["raise SystemExit", "raise BaseException('no')", "yield X; raise BaseException"])
def test_a_hook_that_raises_no_exception(tmp_path, code):
    (tmp_path / "half.py").write_text(HALF.format(code=code))
    with pytest.raises(sk.PluginError, match=r"half\.py sha256:\w+: the hook .* gives no list \((System|Base)E"):
        load_registry([tmp_path / "half.py"])


def test_ctrl_c_while_plugins_are_loaded_passes(tmp_path):
    (tmp_path / "half.py").write_text(HALF.format(code="raise KeyboardInterrupt"))
    with pytest.raises(KeyboardInterrupt):
        load_registry([tmp_path / "half.py"])
    (tmp_path / "rude.py").write_text("raise KeyboardInterrupt")
    with pytest.raises(KeyboardInterrupt):
        load_registry([tmp_path / "rude.py"])


@pytest.mark.parametrize("result", ["None", "1 / 0", "[None]"])
def test_a_hook_that_gives_no_list(tmp_path, result):
    file = tmp_path / "half.py"
    file.write_text(f"from streamkit import hookimpl\n@hookimpl\ndef streamkit_components():\n    return {result}\n")
    with pytest.raises(sk.PluginError, match=r"half\.py sha256:\w+: (the hook .* gives no list|None is no comp)"):
        load_registry([file])


def test_compiled_code_that_raises_is_refused_where_it_is_written():
    """Numba would print the exception and go on without the force."""
    with pytest.raises(sk.PluginError, match=r"Picky\.acceleration: compiled code cannot raise or assert"):

        class Picky(sk.Potential):
            kind = "picky"

            @staticmethod
            def acceleration(x, y, z, t):
                assert x > 0
                return -x, -y, -z


@pytest.mark.parametrize("code", ["raise SystemExit(3)", "1 / 0", "raise type('Base', (BaseException,), {})"])
def test_a_plugin_file_that_ends_the_program_is_an_error(tmp_path, code):
    (tmp_path / "rude.py").write_text(code)
    document = {"plugins": [str(tmp_path / "rude.py")], "seed": 1}
    with pytest.raises(
        sk.PluginError, match=r"^run mapping: plugin file rude\.py failed to load \((SystemExit|Zero|Base)"
    ):
        sk.load(document)
