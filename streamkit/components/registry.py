"""The registry: which component classes are installed, who supplies each, and what failed to load."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Iterable, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

import pluggy

from streamkit.components import hookspecs
from streamkit.components.bases import Component, Integrator, Observable, Potential, Stripping
from streamkit.components.preset import Preset
from streamkit.errors import PluginError, SpecError, nearest

GROUP, OURS = "streamkit", "streamkit."
DISABLE = "STREAMKIT_DISABLE_PLUGINS"
"""Environment variable: entry-point names, separated by commas, of plugins that are not loaded."""
ROLES: dict[str, type[Component]] = {base.role: base for base in (Potential, Stripping, Integrator, Observable)}


@dataclass(frozen=True)
class Entry:
    """A component class and its supplier, such as ``streamkit-spray 0.1.0``."""

    cls: type[Component]
    supplier: str


@dataclass(frozen=True)
class Registry:
    """The installed components by role and kind, and a sentence for every plugin or kind that could not be had."""

    entries: Mapping[str, Mapping[str, Entry]]
    failed: tuple[str, ...] = ()
    presets: Mapping[str, Preset] = field(default_factory=dict)

    def find(self, role: str, kind: Any, where: str) -> type[Component]:
        """Return the class called ``kind``.

        Raises SpecError: At ``where`` in the run file, if there is none; names the installed ones, the nearest, and
        every plugin that failed to load.
        """
        known = self.entries[role]
        if isinstance(kind, str) and kind in known:
            return known[kind].cls
        lost = "".join(f"\n  A plugin failed to load: {line}" for line in self.failed)
        raise SpecError(
            f"{where}: no {role} is called {kind!r}.{nearest(str(kind), known)} "
            f"Installed: {', '.join(sorted(known))}.{lost}"
        )

    def supplier(self, cls: type[Component]) -> str:
        """Return who supplies a class."""
        return self.entries[cls.role][cls.kind].supplier


def load_registry(files: Iterable[str | Path] = (), points: Iterable[EntryPoint] | None = None) -> Registry:
    """Load every plugin: those of the entry-point group ``streamkit``, then one-off plugin files.

    An installed plugin that is broken, or clashes with another, is kept as a record, and named when a run file asks
    for something missing: runs that do without it go on. What `DISABLE` names is not loaded.

    What plugins print goes to stderr: stdout is the command's own.

    Raises PluginError for a plugin file that is broken or brings a kind that is there already.
    """
    with redirect_stdout(sys.stderr):
        return _load(files, entry_points(group=GROUP) if points is None else points)


def _load(files: Iterable[str | Path], points: Iterable[EntryPoint]) -> Registry:
    groups: dict[tuple[bool, str], list[EntryPoint]] = {}
    for point in sorted(points, key=_order):
        groups.setdefault(_order(point)[:2], []).append(point)
    off = {name.strip() for name in os.environ.get(DISABLE, "").split(",")}
    failed: list[str] = []
    loaded: list[tuple[str, list[type[Component] | Preset]]] = []
    for (is_foreign, name), group in groups.items():
        suppliers = [_supplier(point) for point in group]
        if is_foreign and name in off:
            failed += [f"{supplier}, entry point {name!r} (switched off by {DISABLE})" for supplier in suppliers]
        elif len(group) > 1:
            failed.append(
                f"two distributions use the entry-point name {name!r}: {' and '.join(suppliers)}. "
                f"None of them is loaded: uninstall all but one, or switch them off with {DISABLE}."
            )
        else:
            try:
                loaded.append((suppliers[0], _components(group[0].load())))
            except KeyboardInterrupt:
                raise
            except BaseException as error:
                failed.append(f"{suppliers[0]}, entry point {name!r} ({type(error).__name__}: {error})")
    entries, clashes = _without_clashes(loaded)
    presets: dict[str, Preset] = {}
    for supplier, found in loaded:
        for preset in (item for item in found if isinstance(item, Preset)):
            if presets.setdefault(preset.name, preset) is not preset:
                clashes.append(f"{supplier}: a preset is called {preset.name!r} already, so this one is not available")
    for supplier, module in map(_load_file, map(Path, files)):
        try:
            classes = _components(module)
        except PluginError as error:
            raise PluginError(f"{supplier}: {error}") from error.__cause__
        for cls in classes:
            if isinstance(cls, Preset):
                presets[cls.name] = cls
                continue
            clash = entries[cls.role].setdefault(cls.kind, entry := Entry(cls, supplier))
            if clash is not entry:
                raise PluginError(_clash(cls, [clash.supplier, supplier]))
    return Registry(entries, (*failed, *clashes), presets)


def _without_clashes(
    loaded: list[tuple[str, list[type[Component] | Preset]]],
) -> tuple[dict[str, dict[str, Entry]], list[str]]:
    """Return the installed components, and a record for each kind that several suppliers have.

    The built-in one, which comes first, is then the one; of several others, none.
    """
    offers: dict[tuple[str, str], list[Entry]] = {}
    for supplier, classes in loaded:
        for cls in (item for item in classes if not isinstance(item, Preset)):
            offers.setdefault((cls.role, cls.kind), []).append(Entry(cls, supplier))
    entries: dict[str, dict[str, Entry]] = {role: {} for role in ROLES}
    clashes = []
    for (role, kind), found in offers.items():
        is_ours = found[0].cls.__module__.startswith(OURS)
        if is_ours or len(found) == 1:
            entries[role][kind] = found[0]
        if len(found) > 1:
            told = _clash(found[0].cls, [entry.supplier for entry in found])
            end = "The built-in one is used" if is_ours else "None of them is available: uninstall all but one package"
            clashes.append(f"{told}. {end}, or switch one off with {DISABLE}.")
    return entries, clashes


def _clash(cls: type[Component], suppliers: list[str]) -> str:
    return f"two {cls.role} components are called {cls.kind!r}: one from {', one from '.join(suppliers)}"


def _components(module: ModuleType) -> list[type[Component] | Preset]:
    """Return what the hook of a plugin gives, in a list of its own.

    Raises PluginError: If there is no hook, a misspelled one, one with arguments or one that fails, and for what is no
    whole component.
    """
    manager = pluggy.PluginManager(GROUP)
    manager.add_hookspecs(hookspecs)
    try:
        manager.register(module, name=module.__name__)
        manager.check_pending()
    except pluggy.PluginValidationError as error:
        raise PluginError(f"{error}. The only hook is 'streamkit_components', and it takes no argument.") from None
    if not manager.get_hookcallers(module):
        raise PluginError(f"the module {module.__name__} has no hook 'streamkit_components'")
    try:
        found = list(module.streamkit_components())
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        what = f"{type(error).__name__}: {error}"
        raise PluginError(f"the hook streamkit_components gives no list ({what})") from error
    for cls in found:
        _check(cls)
    return found


def _check(cls: Any) -> None:
    if isinstance(cls, Preset):
        return
    if not (inspect.isclass(cls) and issubclass(cls, Potential | Stripping | Integrator | Observable)):
        raise PluginError(f"{cls!r} is no component class: {', '.join(ROLES)}")
    if "kind" in cls.model_fields:
        raise PluginError(
            f"{cls.__name__} has a field called 'kind', which in a run file names the component: "
            "call the field something else"
        )
    if inspect.isabstract(cls) or not cls.__dict__.get("kind"):
        missing = ", ".join(sorted(cls.__abstractmethods__)) or "kind"
        raise PluginError(f"{cls.__name__} is abstract, it does not define {missing}")
    if not isinstance(cls.kind, str):
        raise PluginError(f"{cls.__name__}: the kind must be text, found {cls.kind!r}")
    missing = ", ".join(name for name in ROLES[cls.role].__annotations__ if not _has(cls, name))
    if missing:
        raise PluginError(f"{cls.__name__} does not define {missing}, which every {cls.role} has")


def _has(cls: type[Component], name: str) -> bool:
    """Say whether a class has what its base annotates: a field, or a constant that it must define."""
    return name in cls.model_fields or hasattr(cls, name)


def _order(point: EntryPoint) -> tuple[bool, str, str]:
    """Built-ins first, then by names: the order in which a file system lists them must not matter."""
    return not point.value.startswith(OURS), point.name, _supplier(point)


def _supplier(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist else point.value


def _with_neighbours(path: Path) -> list[Path]:
    """Return a Python file and the files of its folder that it imports, directly or through each other."""
    found = [path]
    for file in found:
        try:
            tree = ast.parse(file.read_bytes())
        except (SyntaxError, ValueError):  # importing it says so
            continue
        names: set[str] = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        for parts in (name.split(".") for name in sorted(names)):
            inside = path.parent.joinpath(*parts)
            found += [f for f in (inside.with_suffix(".py"), inside / "__init__.py") if f.is_file() and f not in found]
    return found


def _load_file(path: Path) -> tuple[str, ModuleType]:
    """Import a one-off plugin file; its supplier carries the hash of its text and of what it imports beside it."""
    try:
        digest = hashlib.sha256(b"".join(file.read_bytes() for file in _with_neighbours(path))).hexdigest()[:12]
    except OSError as error:
        raise SpecError(f"plugins: cannot read {str(path)!r}: {error.strerror}") from None
    name = f"streamkit_file_{path.stem}_{digest}"
    if name in sys.modules:
        return f"{path.name} sha256:{digest}", sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise SpecError(f"plugins: {str(path)!r} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # pickle, and machine code from the disk, look for it there
    try:
        spec.loader.exec_module(module)
    except (PluginError, KeyboardInterrupt):
        del sys.modules[name]
        raise
    except BaseException as error:
        del sys.modules[name]
        raise PluginError(f"plugin file {path.name} failed to load ({type(error).__name__}: {error})") from error
    return f"{path.name} sha256:{digest}", module
