"""The registry: which component classes are installed, who supplies each, and what failed to load."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

import pluggy

from streamkit.components import hookspecs
from streamkit.components.bases import Component, Integrator, Observable, Potential, Stripping
from streamkit.errors import PluginError, SpecError, nearest

GROUP = "streamkit"
ROLES: dict[str, type[Component]] = {base.role: base for base in (Potential, Stripping, Integrator, Observable)}


@dataclass(frozen=True)
class Entry:
    """A component class and its supplier, such as ``streamkit-spray 0.1.0``."""

    cls: type[Component]
    supplier: str


@dataclass(frozen=True)
class Registry:
    """The installed components by role and kind, and the plugins that failed to load."""

    entries: Mapping[str, Mapping[str, Entry]]
    failed: tuple[str, ...] = ()

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

    A plugin that fails to import is kept as a record, and named when a run file asks for something missing.

    Raises PluginError for two plugins or two components of the same name, a misspelled hook, or a broken component.
    """
    failed: list[str] = []
    modules: list[tuple[str, str, ModuleType]] = []
    seen: dict[str, str] = {}
    for point in sorted(entry_points(group=GROUP) if points is None else points, key=_order):
        supplier = _supplier(point)
        if point.name in seen:
            raise PluginError(
                f"two distributions use the entry-point name {point.name!r}: {seen[point.name]} and {supplier}. "
                "Uninstall one of them."
            )
        seen[point.name] = supplier
        try:
            modules.append((point.name, supplier, point.load()))
        except (Exception, SystemExit) as error:
            failed.append(f"{supplier}, entry point {point.name!r} ({type(error).__name__}: {error})")
    modules.extend(_load_file(Path(file)) for file in files)
    return Registry(_collect(modules), tuple(failed))


def _collect(modules: list[tuple[str, str, ModuleType]]) -> dict[str, dict[str, Entry]]:
    manager = pluggy.PluginManager(GROUP)
    manager.add_hookspecs(hookspecs)
    entries: dict[str, dict[str, Entry]] = {role: {} for role in ROLES}
    for name, supplier, module in modules:
        manager.register(module, name=name)
        callers = manager.get_hookcallers(module) or []
        if not callers:
            raise PluginError(f"{supplier}: the module {module.__name__} has no hook 'streamkit_components'")
        try:
            manager.check_pending()
        except pluggy.PluginValidationError as error:
            raise PluginError(f"{supplier}: {error}. The only hook is 'streamkit_components'.") from None
        try:
            found = list(module.streamkit_components())
        except Exception as error:
            what = f"{type(error).__name__}: {error}"
            raise PluginError(f"{supplier}: the hook streamkit_components gives no list ({what})") from error
        for cls in found:
            _add(entries, cls, supplier)
    return entries


def _add(entries: dict[str, dict[str, Entry]], cls: Any, supplier: str) -> None:
    if not (inspect.isclass(cls) and issubclass(cls, Potential | Stripping | Integrator | Observable)):
        raise PluginError(f"{supplier}: {cls!r} is no component class: {', '.join(ROLES)}")
    if "kind" in cls.model_fields:
        raise PluginError(
            f"{supplier}: {cls.__name__} has a field called 'kind', which in a run file names the component: "
            "call the field something else"
        )
    if inspect.isabstract(cls) or not cls.__dict__.get("kind"):
        missing = ", ".join(sorted(cls.__abstractmethods__)) or "kind"
        raise PluginError(f"{supplier}: {cls.__name__} is abstract, it does not define {missing}")
    missing = ", ".join(name for name in ROLES[cls.role].__annotations__ if not _has(cls, name))
    if missing:
        raise PluginError(f"{supplier}: {cls.__name__} does not define {missing}, which every {cls.role} has")
    clash = entries[cls.role].get(cls.kind)
    if clash is not None:
        raise PluginError(
            f"two {cls.role} components are called {cls.kind!r}: one from {clash.supplier}, one from {supplier}"
        )
    entries[cls.role][cls.kind] = Entry(cls, supplier)


def _has(cls: type[Component], name: str) -> bool:
    """Say whether a class has what its base annotates: a field, or a constant that it must define."""
    return name in cls.model_fields or hasattr(cls, name)


def _order(point: EntryPoint) -> tuple[bool, str, str]:
    """Built-ins first, then by names: the order in which a file system lists them must not matter."""
    return not point.value.startswith("streamkit."), point.name, _supplier(point)


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


def _load_file(path: Path) -> tuple[str, str, ModuleType]:
    """Import a one-off plugin file; its supplier carries the hash of its text and of what it imports beside it."""
    try:
        digest = hashlib.sha256(b"".join(file.read_bytes() for file in _with_neighbours(path))).hexdigest()[:12]
    except OSError as error:
        raise SpecError(f"plugins: cannot read {str(path)!r}: {error.strerror}") from None
    name = f"streamkit_file_{path.stem}_{digest}"
    if name in sys.modules:
        return name, f"{path.name} sha256:{digest}", sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise SpecError(f"plugins: {str(path)!r} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # pickle, and machine code from the disk, look for it there
    try:
        spec.loader.exec_module(module)
    except PluginError:
        del sys.modules[name]
        raise
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise PluginError(f"plugin file {path.name} failed to load ({type(error).__name__}: {error})") from error
    return name, f"{path.name} sha256:{digest}", module
