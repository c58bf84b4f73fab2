"""The architecture: imports point down, files stay short, one place caches, the door opens fast."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import streamkit

PACKAGE = Path(streamkit.__file__).parent
ROOT = PACKAGE.parent
SOURCES = sorted(PACKAGE.rglob("*.py"))
PLUGINS = sorted((ROOT / "plugins").rglob("*.py")) + sorted((ROOT / "tests" / "third_party").rglob("*.py"))

LAYERS = (
    {"cli"},
    {"runner"},
    {"report", "plots", "results"},
    {"posterior"},
    {"model"},
    {"spec", "schema"},
    {"engine", "registry"},
    {"components", "hookspecs"},
    {"phase"},
    {"units", "functions", "errors"},
)
"""From the top to the bottom. A file that is not named must fit in between: see `test_imports_point_down`."""

DOORS = {"", "engine"}
"""What built-ins, the conformance kit and plugins may use: `streamkit` and `streamkit.engine`."""


def module_of(file):
    """Dotted name inside the package: ``builtin.potentials``; a package is its own name."""
    parts = file.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(file) for file in SOURCES}


def guarded(tree):
    """Nodes that only a type checker sees."""
    tests = [n for n in ast.walk(tree) if isinstance(n, ast.If) and "TYPE_CHECKING" in ast.unparse(n.test)]
    return {id(child) for test in tests for statement in test.body for child in ast.walk(statement)}


@cache
def imports(file):
    """Modules of streamkit that a file imports, at its top or inside functions, by dotted name."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    hidden = guarded(tree)
    found = set()
    for node in ast.walk(tree):
        if id(node) in hidden:
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file.name}: relative import"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if inner.removeprefix("streamkit.") in MODULES else node.module)
    ours = {name for name in found if name.split(".")[0] == "streamkit"}
    return {name.removeprefix("streamkit").removeprefix(".") for name in ours}


GRAPH = {module_of(file): imports(file) - {""} for file in SOURCES if module_of(file)}


def reached(module, graph):
    """Everything a module imports, directly or through others; parts of a package count as the package."""
    seen, todo = set(), {m for m in graph if m == module or m.startswith(f"{module}.")}
    start = set(todo)
    while todo:
        name = todo.pop()
        seen.add(name)
        todo |= {m for m in graph.get(name, ()) if m not in seen}
    return {name.split(".")[0] for name in seen - start}


@pytest.mark.parametrize("level", range(len(LAYERS)))
def test_imports_point_down(level):
    above = set().union(*LAYERS[:level])
    for module in LAYERS[level]:
        assert any(m.split(".")[0] == module for m in GRAPH), f"there is no {module}"
        wrong = reached(module, GRAPH) & above
        assert not wrong, f"{module} reaches up to {', '.join(sorted(wrong))}"


def test_no_circles():
    for module in sorted(GRAPH):
        seen, todo = set(), set(GRAPH[module])
        while todo:
            name = todo.pop()
            seen.add(name)
            todo |= set(GRAPH.get(name, ())) - seen
        assert module not in seen, f"{module} imports itself in a circle"


@pytest.mark.parametrize("package", ["builtin", "testing"])
def test_built_ins_use_the_doors_only(package):
    for file in SOURCES:
        name = module_of(file)
        if name.split(".")[0] == package:
            strange = {m for m in imports(file) if m not in DOORS and m.split(".")[0] != package}
            assert not strange, f"{name} imports {strange}"


def test_plugins_use_the_doors_only():
    """Plugins that bring components; streamkit-nbody brings a command, which stands on top of everything."""
    components = [file for file in PLUGINS if "streamkit-nbody" not in file.parts]
    assert components
    for file in components:
        allowed = DOORS | ({"testing"} if file.name.startswith("test_") else set())
        strange = imports(file) - allowed
        assert not strange, f"{file.name} imports {strange}"


def test_the_core_knows_neither_built_ins_nor_the_kit():
    for file in SOURCES:
        name = module_of(file)
        if name.split(".")[0] not in {"builtin", "testing"}:
            strange = {m for m in imports(file) if m.split(".")[0] in {"builtin", "testing"}}
            assert not strange, f"{name} imports {strange}"


def test_no_file_is_longer_than_300_lines():
    files = [*SOURCES, *PLUGINS, *(ROOT / "tests").glob("*.py"), *(ROOT / "examples").glob("*.py")]
    long = {f.name: n for f in files if (n := len(f.read_text(encoding="utf-8").splitlines())) > 300}
    assert not long


def test_numbas_own_cache_is_not_used():
    """It misses changes in other files: what is cached goes through engine/cache.py, keyed by content."""
    for file in SOURCES:
        calls = [n for n in ast.walk(ast.parse(file.read_text(encoding="utf-8"))) if isinstance(n, ast.Call)]
        assert not any(keyword.arg == "cache" for call in calls for keyword in call.keywords), file.name


def test_the_door_is_light():
    """Naming a component or writing a plugin needs neither the compiler nor the plots."""
    heavy = ("numba", "astropy", "emcee", "matplotlib", "scipy", "h5py", "corner")
    code = f"import sys, streamkit; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there():
    assert len(set(streamkit.__all__)) == len(streamkit.__all__)
    for name in streamkit.__all__:
        assert getattr(streamkit, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'Potentiel'"):
        streamkit.Potentiel  # noqa: B018
