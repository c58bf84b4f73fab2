"""The registry: the component classes, their suppliers, and the plugins that failed to load."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field, replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from streamkit.components.available import DISABLE, switched_off, where_to_find
from streamkit.components.bases import Component
from streamkit.components.given import load_given
from streamkit.components.plugin import ROLES, Plugin, is_ours, load_file, load_installed, supplier_of
from streamkit.components.preset import Preset
from streamkit.errors import PluginError, SpecError, message_of, nearest

GROUP = "streamkit"


@dataclass(frozen=True)
class Entry:
    """A component class and its supplier, such as ``streamkit-spray 0.1.0``."""

    cls: type[Component]
    supplier: str


@dataclass(frozen=True)
class Registry:
    """The components by role and kind, and a sentence for every plugin or kind that is not available."""

    entries: Mapping[str, Mapping[str, Entry]]  # the loaded components, by role and kind
    # A sentence for every plugin that cannot be used, and for every kind that several packages provide.
    failed: tuple[str, ...] = ()
    presets: Mapping[str, Preset] = field(default_factory=dict)  # published galaxies by name
    plugins: tuple[Plugin, ...] = ()  # the loaded plugins, the built-in one first
    # Plugin files of a run file, and classes given in Python: they take precedence over installed plugins.
    local: tuple[Plugin, ...] = ()
    waiting: tuple[EntryPoint, ...] = field(default=(), repr=False)  # entry points that are not loaded yet
    broken: tuple[str, ...] = ()  # the sentences of ``failed`` about whole plugins

    def having(self, role: str, kind: Any) -> Registry:
        """Return a registry that has searched for a kind: in the entry points of that name, then in all."""
        if not self.waiting or (isinstance(kind, str) and kind in self.entries[role]):
            return self
        called = self.loading([point for point in self.waiting if point.name == kind])
        is_loaded = isinstance(kind, str) and kind in called.entries[role]
        return called if is_loaded else called.loading(called.waiting)

    def having_preset(self, name: Any) -> Registry:
        """Return a registry that has searched for a preset, in every plugin if necessary."""
        return self if isinstance(name, str) and name in self.presets else self.loading(self.waiting)

    def loading(self, points: Sequence[EntryPoint]) -> Registry:
        """Return a registry with the plugins of some waiting entry points.

        Output of plugins goes to stderr: stdout belongs to the command.
        """
        plugins, broken = list(self.plugins), list(self.broken)
        with redirect_stdout(sys.stderr):
            for point in points:
                try:
                    plugins.append(load_installed(point))
                except KeyboardInterrupt:
                    raise
                except BaseException as error:
                    what = f"{type(error).__name__}: {message_of(error)}"
                    broken.append(f"{supplier_of(point)}, entry point {point.name!r} ({what}){_remedy(error)}")
        entries, clashes = _entries(plugins, self.local)
        presets, taken = _presets(plugins, self.local)
        rest = tuple(point for point in self.waiting if point not in points)
        failed = (*broken, *clashes, *taken)
        return Registry(entries, failed, presets, tuple(plugins), self.local, rest, tuple(broken))

    def find(self, role: str, kind: Any, where: str) -> type[Component]:
        """Return the class called ``kind``.

        Raises SpecError: If there is none. The message has the path ``where`` in the run file, the installed kinds, the
        nearest of them or the package that provides this kind, and every plugin that failed to load.
        """
        registry = self.having(role, kind)
        entries = registry.entries[role]
        if isinstance(kind, str) and kind in entries:
            return entries[kind].cls
        home = next((other for other, kinds in registry.entries.items() if str(kind) in kinds), "")
        found = f" It is a kind of {home}." if home else ""
        if role == "potential" and str(kind) in registry.presets:
            found = f' It is a preset: preset = "{kind}".'
        hint = where_to_find(str(kind)) or found or nearest(str(kind), entries)
        lost = "".join(f"\n  A plugin failed to load: {line}" for line in registry.failed)
        raise SpecError(f"{where}: no {role} is called {kind!r}.{hint} Installed: {', '.join(sorted(entries))}.{lost}")

    def supplier(self, cls: type[Component]) -> str:
        """Return the supplier of a class."""
        return self.entries[cls.role][cls.kind].supplier


def load_registry(
    files: Iterable[str | Path] = (),
    points: Iterable[EntryPoint] | None = None,
    *,
    classes: Iterable[type[Component]] = (),
    lazy: bool = False,
) -> Registry:
    """Load the plugins of the entry-point group ``streamkit``, one-off plugin files, and classes given in Python.

    An installed plugin that is broken, or clashes with another, does not stop a run without its components: the plugin
    is recorded, and the error message for a missing kind names it. Plugins that `DISABLE` names are not loaded. With
    ``lazy`` installed plugins are imported when `Registry.having` or `Registry.find` needs them. ``points`` are entry
    points in place of the installed ones.

    Raises PluginError for a file or a class that is broken, or whose kind is that of a built-in component or of another
    file or class.
    """
    waiting, broken = _usable(entry_points(group=GROUP) if points is None else points)
    with redirect_stdout(sys.stderr):
        local = (*map(load_file, map(Path, files)), *load_given(classes))
    empty = Registry({role: {} for role in ROLES}, local=local, waiting=waiting, broken=broken)
    built_in = empty.loading([point for point in waiting if is_ours(point)])
    return built_in if lazy else built_in.loading(built_in.waiting)


def _remedy(error: BaseException) -> str:
    """Return what helps against an exception of a plugin's import; streamkit's own errors say it themselves."""
    if isinstance(error, PluginError):
        return ""
    lost = error.name if isinstance(error, ModuleNotFoundError) else None
    first = f"Install the module {lost.partition('.')[0]!r}, or update" if lost else "Update"
    return f". {first} or uninstall the plugin, or switch it off with {DISABLE}."


def _usable(points: Iterable[EntryPoint]) -> tuple[tuple[EntryPoint, ...], tuple[str, ...]]:
    """Return the entry points that may be loaded, sorted, and a record for each of the others."""
    groups: dict[tuple[bool, str], list[EntryPoint]] = {}
    for point in sorted(points, key=_order):
        groups.setdefault(_order(point), []).append(point)
    off, usable, broken = switched_off(), [], []
    for (is_foreign, name), group in groups.items():
        if is_foreign and name in off:
            said = f"entry point {name!r} (switched off by {DISABLE})"
            broken += [f"{supplier}, {said}" for supplier in _suppliers(group)]
        elif is_foreign and len(group) > 1:
            broken.append(
                f"two distributions use the entry-point name {name!r}: {' and '.join(_suppliers(group))}. "
                f"None of them is loaded: uninstall all but one, or switch them off with {DISABLE}."
            )
        else:
            usable.append(group[0])  # an older install under another name lists the built-in components again
    return tuple(usable), tuple(broken)


def _order(point: EntryPoint) -> tuple[bool, str]:
    """Sort built-ins first, then by names: the order of a file system's listing must not matter."""
    return not is_ours(point), point.name


def _suppliers(points: Iterable[EntryPoint]) -> list[str]:
    """Return the suppliers, sorted. Their names stand in files that take longer to read than all else of a load."""
    return sorted(map(supplier_of, points))


def _entries(plugins: Iterable[Plugin], local: Iterable[Plugin]) -> tuple[dict[str, dict[str, Entry]], list[str]]:
    """Return the components, and a record for each kind that several installed packages have.

    Among several components of one kind the built-in one is used, else the one whose entry point has the name of the
    kind, else none. Local files and classes take precedence over installed packages, and may not have the kind of a
    built-in component.
    """
    offers: dict[tuple[str, str], list[tuple[Plugin, type[Component]]]] = {}
    for plugin in plugins:
        for cls in plugin.classes:
            offered = offers.setdefault((cls.role, cls.kind), [])
            if all(other is not cls for _, other in offered):  # several entry points may name one module
                offered.append((plugin, cls))
    entries: dict[str, dict[str, Entry]] = {role: {} for role in ROLES}
    clashes = []
    for (role, kind), offered in offers.items():
        chosen, end = _choose(kind, offered)
        if chosen is not None:
            entries[role][kind] = Entry(chosen[1], chosen[0].supplier)
        if len(offered) > 1:
            clashes.append(f"{_clash(offered)}. {end}, or switch one off with {DISABLE}.")
    _add_local(entries, local)
    return entries, clashes


def _presets(plugins: Iterable[Plugin], local: Iterable[Plugin]) -> tuple[dict[str, Preset], list[str]]:
    """Return the presets, local ones first, and a record for each preset whose name another one has already."""
    presets: dict[str, Preset] = {}
    taken = []
    for plugin in plugins:
        for preset in plugin.presets:
            if presets.setdefault(preset.name, preset) is not preset:
                sentence = f"a preset is called {preset.name!r} already, so this one is not available"
                taken.append(f"{plugin.supplier}: {sentence}")
    return presets | {preset.name: preset for plugin in local for preset in plugin.presets}, taken


Offer = tuple[Plugin, type[Component]]


def _choose(kind: str, offered: list[Offer]) -> tuple[Offer | None, str]:
    """Return the component that is used among several of a kind, and a sentence that says so."""
    named = [offer for offer in offered if offer[0].name == kind]
    if _is_built_in(offered[0][1]):
        return offered[0], "The built-in one is used"
    if len(offered) == 1 or len(named) == 1:
        chosen = offered[0] if len(offered) == 1 else named[0]
        return chosen, f"That of {chosen[0].supplier}, whose entry point has this name, is used: uninstall all but one"
    return None, "None of them is available: uninstall all but one package"


def _add_local(entries: dict[str, dict[str, Entry]], local: Iterable[Plugin]) -> None:
    seen: dict[tuple[str, str], Offer] = {}
    for plugin in local:
        for cls in plugin.classes:
            there = entries[cls.role].get(cls.kind)
            clash = seen.setdefault((cls.role, cls.kind), (plugin, cls))
            if clash[1] is not cls:
                raise PluginError(_clash([clash, (plugin, cls)]))
            if there is not None and there.cls is not cls and _is_built_in(there.cls):
                raise PluginError(_clash([(replace(plugin, supplier=there.supplier), there.cls), (plugin, cls)]))
            entries[cls.role][cls.kind] = Entry(cls, plugin.supplier)


def _is_built_in(cls: type[Component]) -> bool:
    return cls.__module__.startswith("streamkit.builtin")


def _clash(offered: Sequence[Offer]) -> str:
    first = offered[0][1]
    suppliers = ", one from ".join(plugin.supplier for plugin, _ in offered)
    return f"two {first.role} components are called {first.kind!r}: one from {suppliers}"
