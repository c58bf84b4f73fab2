"""Plugins are imported when they are needed; what they state about themselves; classes given in Python."""

import json
import pickle
import sys
from importlib.metadata import distributions, entry_points

import numpy as np
import pytest
from laid import lay
from pydantic import Field
from runfiles import changed

import streamkit as sk
from streamkit.components import load_registry, where_to_find

BODY = '''
from pydantic import Field
from streamkit import Mass, Potential, hookimpl
{stated}

class Trap(Potential):
    """A harmonic trap."""

    kind = "{kind}"
    mass: Mass = Field(default=1.0, description="Mass.")

    @staticmethod
    def acceleration(x, y, z, t, mass):
        return -x, -y, -z


@hookimpl
def streamkit_components():
    return [Trap]
'''


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Lay a distribution on the path as pip would; return all the entry points there and the built-in one."""
    monkeypatch.syspath_prepend(tmp_path)

    def install(module, kind, points=None, stated="", metadata="", files=()):
        (tmp_path / f"{module}.py").write_text(BODY.format(kind=kind, stated=stated))
        lines = "".join(f"{point} = {module}\n" for point in points or [module])
        info = lay(tmp_path, module, f"[streamkit]\n{lines}", metadata=metadata)
        for name, text in files:
            (info / name).write_text(text)
        builtin = [point for point in entry_points(group="streamkit") if point.name == "builtin"]
        return builtin + [point for result in distributions(path=[str(tmp_path)]) for point in result.entry_points]

    return install


def test_only_the_plugin_that_is_asked_for_is_imported(install):
    install("lazy_named", "lazy_kind", points=["lazy_kind"])
    points = install("lazy_other", "other_kind")
    registry = load_registry(points=points, lazy=True)
    assert "plummer" in registry.entries["potential"]
    assert registry.having("potential", "plummer") is registry
    assert not {"lazy_named", "lazy_other"} & set(sys.modules)
    assert registry.find("potential", "lazy_kind", "").__module__ == "lazy_named"
    assert "lazy_other" not in sys.modules
    whole = registry.having("potential", "other_kind")  # whose entry point has another name: all are looked through
    assert {"lazy_kind", "other_kind", "plummer"} <= set(whole.entries["potential"])
    assert [plugin.name for plugin in whole.plugins] == ["builtin", "lazy_kind", "lazy_other"]


def test_a_run_file_imports_what_it_names(install, monkeypatch):
    install("run_named", "run_kind", points=["run_kind"])
    points = install("run_other", "other")
    monkeypatch.setattr("streamkit.components.registry.entry_points", lambda group: points)
    spec = sk.load(changed("stripping", "particles", 100))
    assert not {"run_named", "run_other"} & set(sys.modules)
    other = sk.load(changed("potential", {"kind": "run_kind"}), registry=spec.registry)
    assert ("potential", "run_named 1.2") in [(path, supplier) for path, _, supplier in other.components()]
    assert "run_other" not in sys.modules
    with pytest.raises(sk.SpecError, match=r"Installed: .*other, .*run_kind"):  # every name is told, so all are loaded
        sk.load(changed("potential", "kind", "no_such_kind"))


def test_several_entry_points_of_one_module_are_no_clash(install):
    registry = load_registry(points=install("multi_trap", "multi", points=["multi", "multi_too"]))
    assert registry.failed == ()
    assert registry.find("potential", "multi", "").__module__ == "multi_trap"


def test_an_entry_point_named_for_the_kind_comes_first(install):
    install("first_trap", "trap", points=["trap"])
    points = install("another_trap", "trap")
    for lazy in (True, False):
        assert load_registry(points=points, lazy=lazy).find("potential", "trap", "").__module__ == "first_trap"
    (record,) = load_registry(points=points).failed
    assert "That of first_trap 1.2, whose entry point has this name, is used" in record


def test_a_file_of_the_run_comes_before_what_is_installed(install, tmp_path):
    points = install("older_trap", "trap")
    file = tmp_path / "newer.py"
    file.write_text(BODY.format(kind="trap", stated=""))
    for lazy in (True, False):
        result = load_registry([file], points, lazy=lazy).having("potential", "another")
        assert result.supplier(result.find("potential", "trap", "")).startswith("newer.py sha256:")


@pytest.mark.parametrize(("number", "remedy"), [(sk.CONTRACT + 1, "upgrade streamkit"), (0, "upgrade the plugin")])
def test_another_contract_is_told(install, tmp_path, number, remedy):
    points = install(f"contract_{number}", "trap", stated=f"STREAMKIT_CONTRACT = {number}")
    (record,) = load_registry(points=points).failed
    result = f"written for contract {number} of streamkit, and this streamkit has contract {sk.CONTRACT}: {remedy}"
    assert record.startswith(f"contract_{number} 1.2, entry point")
    assert result in record
    with pytest.raises(sk.PluginError, match=result):
        load_registry([tmp_path / f"contract_{number}.py"])
    (tmp_path / f"other_hook_{number}.py").write_text(f"STREAMKIT_CONTRACT = {number}\n")
    with pytest.raises(sk.PluginError, match=result):  # and not that it lacks the hook of this contract
        load_registry([tmp_path / f"other_hook_{number}.py"])


def test_what_a_plugin_states_is_kept(install):
    install("stating_trap", "trap", stated=f"STREAMKIT_CONTRACT = {sk.CONTRACT}")
    points = install("silent_trap", "quiet")
    stated = {plugin.name: plugin.contract for plugin in load_registry(points=points).plugins}
    assert stated == {"builtin": sk.CONTRACT, "stating_trap": sk.CONTRACT, "silent_trap": None}
    (record,) = load_registry(points=install("odd_trap", "odd", stated="STREAMKIT_CONTRACT = 'one'")).failed
    assert "STREAMKIT_CONTRACT must be a whole number, found 'one'" in record


def test_the_supplier_tells_what_a_version_does_not(install, tmp_path):
    """An editable install that changed, or another version of the wrapped package, is another plugin."""
    editable = [("direct_url.json", json.dumps({"url": "file:///x", "dir_info": {"editable": True}}))]
    wraps = "Requires-Dist: numpy>=1\nRequires-Dist: pytest>=3\nRequires-Dist: no-such-thing; extra == 'test'\n"
    suppliers = []
    for constant in (1, 2):
        sys.modules.pop("wrapping_trap", None)
        for file in tmp_path.glob("wrapping_trap-*/*"):
            file.unlink()
        for folder in tmp_path.glob("wrapping_trap-*"):
            folder.rmdir()
        points = install("wrapping_trap", "trap", stated=f"A = {constant}", metadata=wraps, files=editable)
        registry = load_registry(points=points)
        suppliers.append(registry.supplier(registry.find("potential", "trap", "")))
    for supplier in suppliers:
        assert supplier.startswith(f"wrapping_trap 1.2 with pytest {pytest.__version__}, editable sha256:")
    assert suppliers[0] != suppliers[1]


def test_a_kind_of_a_known_package_is_told_with_it():
    only_ours = [point for point in entry_points(group="streamkit") if point.name == "builtin"]
    with pytest.raises(sk.SpecError, match="'fardal15' is in streamkit-spray: pip install streamkit-spray"):
        load_registry(points=only_ours).find("stripping", "fardal15", "stripping.kind")
    assert where_to_find("fardal15_gala").startswith(" 'fardal15_gala' is in streamkit-spray: ")
    assert where_to_find("nbody").startswith(" 'nbody' is in streamkit-nbody: ")
    assert where_to_find("dask") == ""  # an extra that is no plugin
    assert where_to_find("fardal1.") == ""


STRENGTH = 3.0


def helper(r2):
    return STRENGTH / (r2 + 1.0)


class Given(sk.Potential):
    """A potential of this module."""

    kind = "given_here"
    mass: sk.Mass = Field(default=1e12, description="Mass.")

    @staticmethod
    def acceleration(x, y, z, t, mass):
        k = -sk.G * mass / (1000.0 + x * x + y * y + z * z) ** 1.5
        return k * x, k * y, k * z


def test_a_class_given_in_python_is_taken_as_it_is():
    document = changed("potential", {"kind": "given_here", "mass": {"uniform": [5e11, 2e12]}})
    spec = sk.load(document, components=[Given])
    supplier = spec.components()[0][2]
    assert supplier.startswith("Given given in Python, sha256:")
    assert supplier in spec.toml()
    again = spec.with_values({"progenitor.kind": "plummer"})
    assert again.given == (Given,)
    sent = pickle.loads(pickle.dumps(spec))
    assert sent == spec
    assert sent.digest() == spec.digest()
    orbit = sk.Model(spec.with_values({"stripping.particles": 20})).stream()
    assert np.isfinite(orbit.q).all()
    with pytest.raises(sk.SpecError, match="no potential is called 'given_here'"):
        sk.load(document)


def local(factor):
    class Local(sk.Potential):
        """A potential of a function."""

        kind = "local"
        compiled = False
        mass: sk.Mass = Field(default=1e12, description="Mass.")

        @staticmethod
        def acceleration(x, y, z, t, mass):
            k = -mass * factor * helper(x * x + y * y + z * z)
            return k * x, k * y, k * z

    return Local


def test_the_digest_is_that_of_the_code(monkeypatch):
    document = changed("potential", {"kind": "local"})

    def digest(factor):
        return sk.load(document, components=[local(factor)]).digest()

    first = digest(1.0)
    assert digest(1.0) == first != digest(2.0)
    monkeypatch.setitem(globals(), "STRENGTH", 4.0)
    assert digest(1.0) != first


def test_what_cannot_be_given():
    document = changed("potential", {"kind": "local"})
    with pytest.raises(sk.PluginError, match=r"two potential .* 'local': one from local.<locals>.Local given"):
        sk.load(document, components=[local(1.0), local(2.0)])
    with pytest.raises(sk.PluginError, match=r"expected a list of classes, such as \[MyPotential\]"):
        sk.load(document, components=local(1.0))
    with pytest.raises(sk.PluginError, match="42 is no component class"):
        sk.load(document, components=[42])
    with pytest.raises(sk.PluginError, match="Local: a class defined inside a function cannot be sent"):
        pickle.dumps(sk.load(document, components=[local(1.0)]))
