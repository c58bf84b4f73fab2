"""The architecture: packages in layers, entered by their doors; one place caches; the door opens fast."""

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

# From the top to the bottom. A package imports from those below it, and nothing beside or above.
LAYERS = (
    {"__main__"},
    {"cli"},
    {"study.calibration", "study.ablation", "study.sensitivity", "study.preflight", "study.families"},
    {"study.grid"},
    {"fit"},
    {"sample", "nbody"},
    {"model", "report"},
    {"observe", "runfile"},
    {"components"},
    {"convergence", "gaussian_mixture"},
    {"fields"},
    {"expansion"},
    {"engine"},
    {"stream"},
    {"errors", "units", "elementary", "renamed", "distribution"},
)

# What stands beside the layers: it uses the doors, and nothing else, and no layer imports it.
OUTSIDE = {"builtin", "testing"}
STORED = "testing.stored_runs"  # the conformance kit checks samplers by the door of the code that stores a run
KIT = "study.preflight", "testing"  # but `check` runs the quick half of the conformance kit
# Rooms inside packages, in the same order.
ROOMS = {
    "fit": (
        {"runner"},
        {"options", "products", "stored", "marginal"},
        {"history"},
        {"show"},
        {"samples"},
        {"judge"},
        {"directory"},
    ),
    "sample": (
        {"earlier"},
        {"sampling", "factors"},
        {"target"},
        {"emulating"},
        {"progress"},
        {"calls", "store"},
        {"evaluation"},
    ),
    "builtin.samplers.emulator": (
        {"sampler"},
        {"rounds"},
        {"start", "judge"},
        {"known"},
        {"certificate"},
        {"learned", "places", "tilt"},
        {"walk"},
        {"learn", "changes"},
        {"at_once"},
    ),
}
DOORS = {"", "engine"}  # what built-ins, the conformance kit and plugins may use: `streamkit` and `streamkit.engine`


def module_of(file):
    """Dotted name inside the package: ``builtin.potentials``; a package is its own name."""
    parts = file.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(file) for file in SOURCES}


def package_of(module):
    """The room that a module stands in: ``runfile``, ``study.grid``, or the module itself at the top level."""
    parts = module.split(".")
    return ".".join(parts[: 2 if parts[0] == "study" else 1])


@cache
def nodes(file):
    """All nodes of the syntax of a file."""
    return tuple(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))


@cache
def imports(file):
    """Modules of streamkit that a file imports, at its top or inside functions, by dotted name."""
    found = set()
    for node in nodes(file):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file.name}: relative import"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if inner.removeprefix("streamkit.") in MODULES else node.module)
    ours = {name for name in found if name.split(".")[0] == "streamkit"}
    return {name.removeprefix("streamkit").removeprefix(".") for name in ours}


@cache
def graph():
    """Every module of the package with those that it imports."""
    return {module_of(file): imports(file) for file in SOURCES}


def test_every_package_has_a_layer():
    named = set().union(*LAYERS) | OUTSIDE | {"study"}
    assert {package_of(module) for module in MODULES if module} == named


def test_imports_point_down_and_enter_by_the_door():
    """Another package by its door; the whole door of streamkit for commands alone, which stand on top."""
    wrong = []
    for module in sorted(m for m in graph() if m and package_of(m) not in OUTSIDE):
        own = package_of(module)
        (level,) = (i for i, names in enumerate(LAYERS) if own in names) if own != "study" else (0,)
        below = set().union(*LAYERS[level + 1 :])
        for other in graph()[module]:
            if package_of(other) == own or (own, other) in {KIT, ("cli", "")}:
                continue
            if other == "":
                wrong.append(f"{module} imports all of streamkit")
            elif package_of(other) not in below:
                wrong.append(f"{module} imports {other}, which is not below it")
            elif other != package_of(other) and own != "__main__":
                wrong.append(f"{module} reaches into {other}: take it from the door of {package_of(other)}")
    assert not wrong


@pytest.mark.parametrize("package", sorted(ROOMS))
def test_imports_point_down_between_the_rooms_of_a_package(package):
    """The rooms of one step stand beside each other: neither imports the other."""
    steps = ROOMS[package]
    level = {f"{package}.{room}": i for i, rooms in enumerate(steps) for room in rooms}
    depth = package.count(".") + 2
    modules = {module: ".".join(module.split(".")[:depth]) for module in graph() if module.startswith(f"{package}.")}
    assert set(modules.values()) == set(level)
    for module, room in modules.items():
        for other in graph()[module] & modules.keys():
            assert modules[other] == room or level[modules[other]] > level[room], f"{module} imports {other}"


def test_no_circles():
    """Among all modules, and with the imports for types alone."""
    for module in sorted(filter(None, graph())):
        seen, todo = set(), {m for m in graph()[module] if m in graph()}
        while todo:
            name = todo.pop()
            seen.add(name)
            todo |= {m for m in graph().get(name, ()) if m} - seen
        assert module not in seen, f"{module} imports itself in a circle"


@pytest.mark.parametrize("package", sorted(OUTSIDE))
def test_built_ins_use_the_doors_only(package):
    for file in SOURCES:
        name = module_of(file)
        if package_of(name) == package:
            doors = DOORS | ({"sample"} if name == STORED else set())
            strange = {m for m in imports(file) if m not in doors and package_of(m) != package}
            assert not strange, f"{name} imports {strange}"


def test_a_door_opens_on_what_exists():
    """Every name of a door is there, and a door that is asked for another one says so."""
    for package in (stub.parent for stub in PACKAGE.rglob("__init__.pyi")):
        door = ".".join(("streamkit", *package.relative_to(PACKAGE).parts))
        module = __import__(door, fromlist=["_"])
        for name in module.__all__:
            assert getattr(module, name) is not None, door
            assert name in dir(module), door
        with pytest.raises(AttributeError, match="attribute"):
            module.no_such_name  # noqa: B018


def test_plugins_use_the_doors_only():
    """Components see `streamkit` and its engine; a command stands on top and sees every door, and nothing behind."""
    for file in PLUGINS:
        strange = imports(file) - DOORS - ({"testing", "cli.main"} if file.name.startswith("test_") else set())
        project = next(parent / "pyproject.toml" for parent in file.parents if (parent / "pyproject.toml").exists())
        if "streamkit.commands" in project.read_text(encoding="utf-8"):
            strange = {module for module in strange if module != package_of(module)}
        assert not strange, f"{file.name} imports {strange}"


def test_no_file_is_longer_than_400_lines():
    files = [*SOURCES, *PLUGINS, *(ROOT / "tests").rglob("*.py"), *(ROOT / "examples").rglob("*.py")]
    long = {f.name: n for f in files if (n := len(f.read_text(encoding="utf-8").splitlines())) > 400}
    assert not long


def test_numbas_own_cache_is_not_used():
    """It misses changes in other files: what is cached goes through engine/cache.py, keyed by content."""
    for file in SOURCES:
        calls = [n for n in nodes(file) if isinstance(n, ast.Call)]
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
    with pytest.raises(AttributeError, match="Potentiel"):
        streamkit.Potentiel  # noqa: B018
