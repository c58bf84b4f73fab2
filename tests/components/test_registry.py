"""Loading plugins: who supplies what, and a clear message for everything that can be wrong with them."""

import re
from importlib.metadata import distributions, entry_points

import pytest
from laid import lay
from pydantic import Field

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import Plummer
from streamkit.components import load_registry

BUILTIN = load_registry(points=[p for p in entry_points(group="streamkit") if p.name == "builtin"])

BODY = '''
"""A plugin."""
from pydantic import Field
from streamkit import Component, Mass, Potential, hookimpl
{imports}

class {name}(Potential):
    """A harmonic trap."""

    kind = "{kind}"
    mass: Mass = Field(default=1.0, description="Mass.")

    @staticmethod
    def acceleration(x, y, z, t, mass):
        """Return minus the position."""
        return -x, -y, -z


@hookimpl
def {hook}():
    """List the components."""
    return [{listed}]
'''


def text(kind="trap", name="Trap", hook="streamkit_components", listed=None, imports=""):
    return BODY.format(kind=kind, name=name, hook=hook, listed=name if listed is None else listed, imports=imports)


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Lay distributions on the path as pip would; return their entry points and the built-in one."""
    monkeypatch.syspath_prepend(tmp_path)
    builtin = [p for p in entry_points(group="streamkit") if p.name == "builtin"]

    def install(distribution, module, body, point=None):
        (tmp_path / f"{module}.py").write_text(body)
        lay(tmp_path, distribution, f"[streamkit]\n{point or module} = {module}\n")
        result = [p for d in distributions(path=[str(tmp_path)]) for p in d.entry_points]
        return builtin + result

    return install


def test_the_built_ins_are_found_through_their_entry_point():
    registry = load_registry()
    wanted = {
        "potential": {"tf", "nfw", "nfw_m200", "hernquist", "miyamoto_nagai", "plummer", "kepler",
                      "isochrone", "logarithmic"},
        "stripping": {"mlcs", "streakline"},
        "integrator": {"leapfrog", "pefrl", "dop853"},
        "observable": {"apocentres"},
        "sampler": {"emcee"},
    }  # fmt: skip
    for role, kinds in wanted.items():
        assert kinds <= set(registry.entries[role])
        for kind in kinds:
            assert registry.supplier(registry.find(role, kind, role)) == f"streamkit {sk.__version__}"


def test_a_plugin_is_found_and_named(install):
    registry = load_registry(points=install("streamkit-trap", "reg_trap", text()))
    cls = registry.find("potential", "trap", "potential.kind")
    assert cls.__name__ == "Trap"
    assert registry.supplier(cls) == "streamkit-trap 1.2"
    assert registry.failed == ()


def test_an_unknown_kind_names_the_place_the_nearest_and_the_installed(install):
    registry = load_registry(points=install("streamkit-trap", "reg_trap2", text()))
    with pytest.raises(sk.SpecError) as caught:
        registry.find("potential", "plumer", "progenitor.kind")
    message = str(caught.value)
    assert message.startswith("progenitor.kind: no potential is called 'plumer'. Did you mean 'plummer'?")
    assert "Installed: bar, dehnen, exponential_disc," in message
    assert "trap" in message


@pytest.mark.parametrize("kind", [None, 3, ["tf"], {"tf": 1}])
def test_a_kind_that_is_no_text(kind):
    with pytest.raises(sk.SpecError, match=r"potential\.kind: no potential is called"):
        load_registry().find("potential", kind, "potential.kind")


def test_a_plugin_that_fails_to_import_is_named_when_something_is_missing(install):
    points = install("streamkit-agama", "reg_broken", text(imports="import agama_of_the_future"))
    registry = load_registry(points=points)
    assert registry.find("potential", "tf", "potential.kind").kind == "tf"
    (record,) = registry.failed
    wanted = "ModuleNotFoundError: No module named 'agama_of_the_future'"
    assert record.startswith("streamkit-agama 1.2, entry point 'reg_broken'")
    assert wanted in record
    assert "Install the module 'agama_of_the_future', or update or uninstall the plugin, or switch it off" in record
    with pytest.raises(sk.SpecError, match=r"A plugin failed to load: streamkit-agama 1\.2") as caught:
        registry.find("potential", "trap", "potential.kind")
    assert wanted in str(caught.value)


def record(points):
    """Return the one record of a registry that has all the built-ins, whatever else is installed."""
    registry = load_registry(points=points)
    assert all(kinds.items() <= registry.entries[role].items() for role, kinds in BUILTIN.entries.items())
    (line,) = registry.failed
    with pytest.raises(sk.SpecError) as caught:
        registry.find("potential", "no_such_kind", "potential.kind")
    assert line in str(caught.value)
    return line


def test_a_plugin_that_raises_no_exception(install):
    points = install("streamkit-base", "reg_base", "raise BaseException('no')")
    assert record(points).startswith("streamkit-base 1.2, entry point 'reg_base' (BaseException: no). Update or uninst")


def test_two_plugins_of_one_name(install):
    install("streamkit-one", "reg_one", text(), point="same")
    points = install("streamkit-two", "reg_two", text(kind="other"), point="same")
    result = record(points)
    assert result.startswith(
        "two distributions use the entry-point name 'same': streamkit-one 1.2 and streamkit-two 1.2"
    )
    assert record(points[::-1]) == result  # whatever the order in which the file system lists them
    assert not {"trap", "other"} & set(load_registry(points=points).entries["potential"])


def test_a_kind_of_a_built_in_stays_the_built_in_one(install):
    points = install("streamkit-twin", "reg_twin", text(kind="plummer"))
    message = r"two potential components are called 'plummer': one from streamkit .*, one from streamkit-twin"
    assert re.match(message, record(points))
    assert load_registry(points=points).find("potential", "plummer", "") is Plummer


def test_two_packages_with_one_kind(install):
    """Neither is taken, asking for it names both, and the rest of both packages is there."""
    scheme = text(kind="spare", name="Spare").replace("@hookimpl", "").replace("def streamkit_components", "def unused")
    both = text(imports=scheme, listed="Trap, Spare")
    install("streamkit-left", "reg_left", both)
    points = install("streamkit-right", "reg_right", text())
    line = record(points)
    assert "are called 'trap': one from streamkit-left 1.2, one from streamkit-right 1.2" in line
    registry = load_registry(points=points)
    assert registry.find("potential", "spare", "").__name__ == "Spare"
    with pytest.raises(sk.SpecError, match=r"streamkit-left 1\.2, one from streamkit-right 1\.2"):
        registry.find("potential", "trap", "potential.kind")


def test_a_plugin_can_be_switched_off(install, monkeypatch):
    install("streamkit-left", "off_left", text(), point="left")
    points = install("streamkit-right", "off_right", "raise SystemExit", point="right")
    points = install("streamkit-third", "off_third", text(), point="third")
    monkeypatch.setenv("STREAMKIT_DISABLE_PLUGINS", "right, left,builtin")
    registry = load_registry(points=points)
    assert registry.supplier(registry.find("potential", "trap", "")) == "streamkit-third 1.2"
    assert registry.failed == (
        "streamkit-left 1.2, entry point 'left' (switched off by STREAMKIT_DISABLE_PLUGINS)",
        "streamkit-right 1.2, entry point 'right' (switched off by STREAMKIT_DISABLE_PLUGINS)",
    )
    assert registry.find("potential", "plummer", "") is Plummer


def test_a_file_with_a_kind_that_is_there_is_refused(tmp_path):
    (tmp_path / "twin.py").write_text(text(kind="plummer"))
    message = r"two potential components are called 'plummer': one from streamkit .*, one from twin\.py sha256"
    with pytest.raises(sk.PluginError, match=message):
        load_registry([tmp_path / "twin.py"])


def test_one_kind_in_two_roles_is_no_clash(install):
    scheme = '''
from streamkit import Release, Stripping, hookimpl

class Plummer(Stripping):
    """Released where the progenitor is."""
    kind = "plummer"
    draws = 0

    def release(self, orbit, tail, mass, normals):
        """Return the progenitor's own states."""
        return Release(orbit.q.copy(), orbit.v.copy())

@hookimpl
def streamkit_components():
    """List the components."""
    return [Plummer]
'''
    registry = load_registry(points=install("streamkit-same", "reg_roles", scheme))
    assert registry.find("potential", "plummer", "") is Plummer
    assert registry.find("stripping", "plummer", "").__module__ == "reg_roles"


def test_a_misspelled_hook(install):
    result = record(install("streamkit-typo", "reg_typo", text(hook="streamkit_component")))
    assert result.startswith("streamkit-typo 1.2, entry point 'reg_typo' (PluginError: ")
    assert "streamkit_component" in result


def test_a_second_misspelled_hook_beside_the_right_one(install):
    body = text() + "\n\n@hookimpl\ndef streamkit_potentials():\n    return []\n"
    result = record(install("streamkit-extra", "reg_extra", body))
    assert re.match(r"streamkit-extra 1\.2, .*streamkit_potentials.* The only hook is 'streamkit_components'", result)


def test_a_hook_with_an_argument(install, tmp_path):
    body = text().replace("streamkit_components()", "streamkit_components(registry)")
    result = record(install("streamkit-argument", "reg_argument", body))
    assert re.search(r"(?s)^streamkit-argument 1\.2, .*registry.* it takes no argument", result)
    with pytest.raises(sk.PluginError, match=r"(?s)^reg_argument\.py sha256:\w+: .*it takes no argument"):
        load_registry([tmp_path / "reg_argument.py"])


@pytest.mark.parametrize("code", ["1 / 0", "import agama_of_the_future", "None", "raise BaseException", "exit(0)"])
def test_a_hook_that_fails(install, code):
    body = text().replace("return [Trap]", code)
    result = record(install("streamkit-fails", "reg_fails", body))
    assert result.startswith(
        "streamkit-fails 1.2, entry point 'reg_fails' (PluginError: the hook streamkit_components "
    )


def test_a_module_without_the_hook(install):
    result = record(install("streamkit-empty", "reg_empty", '"""Nothing."""\n'))
    assert re.match(r"streamkit-empty 1\.2, .*module reg_empty has no hook .* marked with @streamkit.hookimpl", result)


@pytest.mark.parametrize(
    ("listed", "message"),
    [
        ("Trap, 42", "42 is no component class"),
        ("Trap()", "Trap(mass=1.0) is no component class"),
        ("dict", "<class 'dict'> is no component class"),
        ("Potential", "Potential is abstract, it does not define acceleration"),
    ],
)
def test_things_that_are_no_components(install, listed, message):
    result = record(install("streamkit-odd", f"reg_odd{len(listed)}", text(listed=listed)))
    assert result.startswith("streamkit-odd 1.2, entry point 'reg_odd")
    assert message in result


@pytest.mark.parametrize(
    ("kind", "message"), [('""', "does not define kind"), ("['a', 'b']", "the kind must be text, found ['a', 'b']")]
)
def test_a_class_without_a_name(install, kind, message):
    body = text().replace('kind = "trap"', f"kind = {kind}")
    assert message in record(install("streamkit-kindless", f"reg_kindless{len(kind)}", body))


def test_components_are_final():
    with pytest.raises(sk.PluginError, match="Heavier derives from the component Plummer: components are final"):

        class Heavier(Plummer):
            """A Plummer sphere, heavier."""

            kind = "heavier"


def test_an_abstract_base_of_ones_own_is_allowed():
    class Spherical(sk.Potential):
        """A base without a kind."""

    class Trap(Spherical):
        """A trap."""

        kind = "own_trap"
        mass: sk.Mass = Field(default=1.0, description="Mass.")

        @staticmethod
        def acceleration(x, y, z, t, mass):
            return -x, -y, -z

    assert Trap().mass == 1.0


def test_the_arguments_of_an_acceleration_are_the_fields():
    with pytest.raises(sk.PluginError) as caught:

        class Swapped(sk.Potential):
            """Arguments in another order."""

            kind = "swapped"
            mass: sk.Mass
            a: sk.Length

            @staticmethod
            def acceleration(x, y, z, t, a, mass):
                return -x, -y, -z

    message = str(caught.value)
    assert message.endswith(
        "Swapped.acceleration: the arguments must be (x, y, z, t, mass, a), that is x, y, z, t and then the "
        "fields by name; found (x, y, z, t, a, mass)"
    )


def test_a_one_off_file_carries_the_hash_of_its_text(tmp_path):
    file = tmp_path / "my_trap.py"
    file.write_text(text())
    suppliers = []
    for body in (text(), text(), text() + "\n# a second edition\n"):
        file.write_text(body)
        registry = load_registry([file])
        suppliers.append(registry.supplier(registry.find("potential", "trap", "")))
    assert suppliers[0].startswith("my_trap.py sha256:")
    assert suppliers[0] == suppliers[1] != suppliers[2]


def test_the_hash_of_a_one_off_file_covers_what_it_imports_beside_it(tmp_path, monkeypatch):
    """A helper that changed is another plugin: a run with the old one must not be resumed with it."""
    monkeypatch.syspath_prepend(tmp_path)
    plugin, helper, deeper = (tmp_path / f"{name}.py" for name in ("beside_trap", "beside_helper", "beside_deeper"))
    plugin.write_text(text(imports="import beside_helper"))
    helper.write_text("STRENGTH = 1\n")
    suppliers = [supplier_of(plugin)]
    helper.write_text("from beside_deeper import STRENGTH\n")
    deeper.write_text("STRENGTH = 1\n")
    suppliers.append(supplier_of(plugin))
    deeper.write_text("STRENGTH = 2\n")
    suppliers.append(supplier_of(plugin))
    (tmp_path / "unrelated.py").write_text("pass\n")
    assert supplier_of(plugin) == suppliers[-1]
    assert len(set(suppliers)) == 3


def supplier_of(plugin):
    registry = load_registry([plugin])
    return registry.supplier(registry.entries["potential"]["trap"].cls)


def test_a_one_off_file_that_fails_says_so_at_once(tmp_path):
    """Unlike an installed plugin, which a run may not need, it was asked for by name."""
    file = tmp_path / "bad_trap.py"
    file.write_text("import agama_of_the_future\n")
    with pytest.raises(sk.PluginError, match=r"bad_trap\.py failed to load \(ModuleNotFoundError"):
        load_registry([file])
    with pytest.raises(sk.SpecError, match=r"plugins: cannot read .*missing\.py"):
        load_registry([tmp_path / "missing.py"])
    (tmp_path / "trap.txt").write_text(text())
    with pytest.raises(sk.SpecError, match=r"trap\.txt' is not a Python file"):
        load_registry([tmp_path / "trap.txt"])


def test_loading_twice_gives_the_same():
    assert load_registry() == load_registry()


def test_what_a_plugin_prints_is_no_part_of_the_output(install, tmp_path, capsys):
    body = text().replace("return [Trap]", "print('from the hook')\n    return [Trap]") + "\nprint('at import')\n"
    load_registry(points=install("streamkit-loud", "reg_loud", body))
    (tmp_path / "loud_file.py").write_text(body.replace('"trap"', '"loud"'))
    load_registry([tmp_path / "loud_file.py"])
    result = capsys.readouterr()
    assert result.out == ""
    assert result.err.count("at import") == 2
    assert "from the hook" in result.err
