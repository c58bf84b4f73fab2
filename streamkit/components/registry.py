"""The registry: which component classes are there, who supplies each, and what failed to load."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field, replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from streamkit.components.bases import Component
from streamkit.components.disabled import DISABLE, switched_off
from streamkit.components.given import load_given
from streamkit.components.known import where_to_find
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
    """The components by role and kind, and a sentence for every plugin or kind that could not be had.

    Attributes
    ----------
    entries
        What is loaded.
    failed
        A sentence for every plugin that cannot be used, and for every kind that several packages bring.
    presets
        Published galaxies by name.
    plugins
        What was loaded, the built-in one first.
    own
        Files of a run file and classes given in Python: they come before what is installed.
    waiting
        Entry points that were not needed so far.
    broken
        The part of ``failed`` that is about whole plugins.
    """

    entries: Mapping[str, Mapping[str, Entry]]
    failed: tuple[str, ...] = ()
    presets: Mapping[str, Preset] = field(default_factory=dict)
    plugins: tuple[Plugin, ...] = ()
    own: tuple[Plugin, ...] = ()
    waiting: tuple[EntryPoint, ...] = field(default=(), repr=False)
    broken: tuple[str, ...] = ()

    def having(self, role: str, kind: Any) -> Registry:
        """Return a registry in which a kind has been looked for: at the entry points of its name, then at all."""
        if not self.waiting or (isinstance(kind, str) and kind in self.entries[role]):
            return self
        called = self.loading([point for point in self.waiting if point.name == kind])
        found = isinstance(kind, str) and kind in called.entries[role]
        return called if found else called.loading(called.waiting)

    def having_preset(self, name: Any) -> Registry:
        """Return a registry in which a preset has been looked for, at last in every plugin."""
        return self if isinstance(name, str) and name in self.presets else self.loading(self.waiting)

    def loading(self, points: Sequence[EntryPoint]) -> Registry:
        """Return a registry that has the plugins of some of the entry points that wait.

        What plugins print goes to stderr: stdout is the command's own.
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
                    broken.append(f"{supplier_of(point)}, entry point {point.name!r} ({what})")
        entries, clashes = _entries(plugins, self.own)
        presets, taken = _presets(plugins, self.own)
        rest = tuple(point for point in self.waiting if point not in points)
        failed = (*broken, *clashes, *taken)
        return Registry(entries, failed, presets, tuple(plugins), self.own, rest, tuple(broken))

    def find(self, role: str, kind: Any, where: str) -> type[Component]:
        """Return the class called ``kind``.

        Raises SpecError: At ``where`` in the run file, if there is none; names the installed ones, the nearest, the
        package that is known to have it, and every plugin that failed to load.
        """
        found = self.having(role, kind)
        known = found.entries[role]
        if isinstance(kind, str) and kind in known:
            return known[kind].cls
        hint = where_to_find(role, str(kind)) or nearest(str(kind), known)
        lost = "".join(f"\n  A plugin failed to load: {line}" for line in found.failed)
        raise SpecError(f"{where}: no {role} is called {kind!r}.{hint} Installed: {', '.join(sorted(known))}.{lost}")

    def supplier(self, cls: type[Component]) -> str:
        """Return who supplies a class."""
        return self.entries[cls.role][cls.kind].supplier


def load_registry(
    files: Iterable[str | Path] = (),
    points: Iterable[EntryPoint] | None = None,
    *,
    classes: Iterable[type[Component]] = (),
    lazy: bool = False,
) -> Registry:
    """Load the plugins of the entry-point group ``streamkit``, one-off plugin files, and classes given in Python.

    An installed plugin that is broken, or clashes with another, is kept as a record, and named when a run file asks
    for something missing: runs that do without it go on. What `DISABLE` names is not loaded.

    Parameters
    ----------
    files
        One-off plugin files.
    points
        Entry points, in place of the installed ones.
    classes
        Component classes, as they are.
    lazy
        Import the installed plugins when `Registry.having` or `Registry.find` needs them.

    Raises PluginError for a file or a class that is broken, or has a kind of a built-in component or of each other.
    """
    waiting, broken = _usable(entry_points(group=GROUP) if points is None else points)
    with redirect_stdout(sys.stderr):
        own = (*map(load_file, map(Path, files)), *load_given(classes))
    empty = Registry({role: {} for role in ROLES}, own=own, waiting=waiting, broken=broken)
    built_in = empty.loading([point for point in waiting if is_ours(point)])
    return built_in if lazy else built_in.loading(built_in.waiting)


def _usable(points: Iterable[EntryPoint]) -> tuple[tuple[EntryPoint, ...], tuple[str, ...]]:
    """Return the entry points that may be loaded, in an order of their own, and a record for each of the others."""
    groups: dict[tuple[bool, str], list[EntryPoint]] = {}
    for point in sorted(points, key=_order):
        groups.setdefault(_order(point)[:2], []).append(point)
    off, usable, broken = switched_off(), [], []
    for (is_foreign, name), group in groups.items():
        suppliers = [supplier_of(point) for point in group]
        if is_foreign and name in off:
            broken += [f"{supplier}, entry point {name!r} (switched off by {DISABLE})" for supplier in suppliers]
        elif len(group) > 1:
            broken.append(
                f"two distributions use the entry-point name {name!r}: {' and '.join(suppliers)}. "
                f"None of them is loaded: uninstall all but one, or switch them off with {DISABLE}."
            )
        else:
            usable += group
    return tuple(usable), tuple(broken)


def _order(point: EntryPoint) -> tuple[bool, str, str]:
    """Built-ins first, then by names: the order in which a file system lists them must not matter."""
    return not is_ours(point), point.name, supplier_of(point)


def _entries(plugins: Iterable[Plugin], own: Iterable[Plugin]) -> tuple[dict[str, dict[str, Entry]], list[str]]:
    """Return the components, and a record for each kind that several installed packages have.

    The built-in one, which comes first, is then the one, or else that whose entry point has the name of the kind; of
    several others, none. A run's own files and classes come before installed packages, and may not have the kind of
    a built-in one.
    """
    offers: dict[tuple[str, str], list[tuple[Plugin, type[Component]]]] = {}
    for plugin in plugins:
        for cls in plugin.classes:
            found = offers.setdefault((cls.role, cls.kind), [])
            if all(other is not cls for _, other in found):  # several entry points may name one module
                found.append((plugin, cls))
    entries: dict[str, dict[str, Entry]] = {role: {} for role in ROLES}
    clashes = []
    for (role, kind), found in offers.items():
        chosen, end = _choose(kind, found)
        if chosen is not None:
            entries[role][kind] = Entry(chosen[1], chosen[0].supplier)
        if len(found) > 1:
            clashes.append(f"{_clash(found)}. {end}, or switch one off with {DISABLE}.")
    _add_own(entries, own)
    return entries, clashes


def _presets(plugins: Iterable[Plugin], own: Iterable[Plugin]) -> tuple[dict[str, Preset], list[str]]:
    """Return the presets, those of a run's own files before the others, and a record for each name that was taken."""
    presets: dict[str, Preset] = {}
    taken = []
    for plugin in plugins:
        for preset in plugin.presets:
            if presets.setdefault(preset.name, preset) is not preset:
                told = f"a preset is called {preset.name!r} already, so this one is not available"
                taken.append(f"{plugin.supplier}: {told}")
    return presets | {preset.name: preset for plugin in own for preset in plugin.presets}, taken


Offer = tuple[Plugin, type[Component]]


def _choose(kind: str, found: list[Offer]) -> tuple[Offer | None, str]:
    """Return the one of several components of a kind that is used, and how to say so."""
    named = [offer for offer in found if offer[0].name == kind]
    if _is_built_in(found[0][1]):
        return found[0], "The built-in one is used"
    if len(found) == 1 or len(named) == 1:
        chosen = found[0] if len(found) == 1 else named[0]
        return chosen, f"That of {chosen[0].supplier}, whose entry point has this name, is used: uninstall all but one"
    return None, "None of them is available: uninstall all but one package"


def _add_own(entries: dict[str, dict[str, Entry]], own: Iterable[Plugin]) -> None:
    seen: dict[tuple[str, str], Offer] = {}
    for plugin in own:
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


def _clash(found: Sequence[Offer]) -> str:
    first = found[0][1]
    suppliers = ", one from ".join(plugin.supplier for plugin, _ in found)
    return f"two {first.role} components are called {first.kind!r}: one from {suppliers}"
