"""One plugin: import its module, call its hook, check its components, identify its code."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
import json
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import Distribution, EntryPoint, PackageNotFoundError, entry_points, version
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pluggy

from streamkit.components import hookspecs
from streamkit.components.bases import Component, Integrator, Observable, StrippingScheme
from streamkit.components.host_data import HostData
from streamkit.components.potential import Potential
from streamkit.components.preset import Preset
from streamkit.components.sampler import Sampler
from streamkit.distribution import NAME, PACKAGE, VERSION
from streamkit.errors import PluginError, SpecError, expect_file, message_of

PACKAGE_PREFIX = "streamkit."
ROLES: dict[str, type[Component]] = {
    base.role: base for base in (Potential, StrippingScheme, Integrator, Observable, HostData, Sampler)
}


@dataclass(frozen=True)
class Plugin:
    """The components and presets of one plugin, and their supplier."""

    # Distribution and version, or file; with a hash of the code if these do not identify it. The digest of a run has
    # it.
    supplier: str
    name: str  # of the entry point; empty for a file, and for classes given in Python
    contract: int | None  # the contract that the plugin states it was written for; None if it states none
    classes: tuple[type[Component], ...]
    presets: tuple[Preset, ...] = ()

    @classmethod
    def of(cls, supplier: str, name: str, module: ModuleType) -> Plugin:
        """Make a plugin of the result of a module's hook."""
        contract = _contract(module)  # first: a module of another contract may have another hook
        items = _components(module)
        presets = tuple(item for item in items if isinstance(item, Preset))
        classes = tuple(item for item in items if not isinstance(item, Preset))
        return cls(supplier, name, contract, classes, presets)


@np.errstate()  # np.seterr of a plugin ends with its import
def load_installed(point: EntryPoint) -> Plugin:
    """Import the module that an entry point names, and call its hook."""
    module = point.load()
    return Plugin.of(_identity(point, module), point.name, module)


@np.errstate()
def load_file(path: Path) -> Plugin:
    """Import a one-off plugin file. Raises PluginError if it is broken."""
    supplier, module = _load_file(path)
    try:
        return Plugin.of(supplier, "", module)
    except PluginError as error:
        raise PluginError(f"{supplier}: {error}") from error.__cause__


def supplier_of(point: EntryPoint) -> str:
    """Return distribution and version, which need no import.

    The supplier of built-in components is called by the name of the package: the digest of a run contains the supplier,
    and must not change with the name on an index.
    """
    if is_ours(point):
        return f"{PACKAGE} {VERSION}"
    return f"{point.dist.name} {point.dist.version}" if point.dist else point.value


def is_ours(point: EntryPoint) -> bool:
    """Return whether an entry point is that of the built-in components."""
    return point.value.startswith(PACKAGE_PREFIX)


def _contract(module: ModuleType) -> int | None:
    """Return the contract that a plugin states; PluginError if this streamkit has another."""
    stated = getattr(module, hookspecs.CONTRACT_ATTRIBUTE, None)
    if stated is None or stated == hookspecs.CONTRACT:
        return stated
    if not isinstance(stated, int):
        raise PluginError(f"{hookspecs.CONTRACT_ATTRIBUTE} must be a whole number, found {stated!r}")
    remedy = "upgrade streamkit" if stated > hookspecs.CONTRACT else "upgrade the plugin, or take an older streamkit"
    raise PluginError(
        f"it was written for contract {stated} of streamkit, and this streamkit has contract {hookspecs.CONTRACT}: "
        + remedy
    )


def _identity(point: EntryPoint, module: ModuleType) -> str:
    """Return the supplier, with a hash for an editable install, and with the versions of the wrapped packages."""
    name = supplier_of(point)
    if point.dist is None or is_ours(point):
        return name
    others = sorted(_requires(point.dist) - _required_by_streamkit())  # optional extras are left out
    wrapped = [f"{other} {version(other)}" for other in others if _is_installed(other)]
    if wrapped:
        name += f" with {', '.join(wrapped)}"
    if _is_editable(point.dist) and module.__file__:
        name += f", editable sha256:{_digest(_files(Path(module.__file__)))}"
    return name


def _is_editable(dist: Distribution) -> bool:
    try:
        return bool(json.loads(dist.read_text("direct_url.json") or "{}")["dir_info"]["editable"])
    except (ValueError, KeyError, TypeError):
        return False


@cache
def _required_by_streamkit() -> set[str]:
    ours = [point.dist for point in entry_points(group=PACKAGE) if is_ours(point)]
    return {PACKAGE, NAME}.union(*(_requires(dist) for dist in ours if dist))


def _requires(dist: Distribution) -> set[str]:
    lines = [line for line in dist.requires or () if "extra ==" not in line]
    return {re.split(r"[^\w.-]", line, maxsplit=1)[0].lower().replace("_", "-") for line in lines}


def _is_installed(name: str) -> bool:
    try:
        return bool(version(name))
    except PackageNotFoundError:
        return False


def _files(path: Path) -> list[Path]:
    """Return the Python files of a module: all of its package, or the file and its neighbours."""
    return sorted(path.parent.rglob("*.py")) if path.name == "__init__.py" else with_neighbours(path)


def _digest(files: Iterable[Path]) -> str:
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:12]


def _components(module: ModuleType) -> list[type[Component] | Preset]:
    """Call the hook of a plugin; return a list of its components and presets.

    Raises PluginError: If there is no hook, a misspelled one, one with arguments or one that fails, and for an
    incomplete component.
    """
    manager = pluggy.PluginManager("streamkit")
    manager.add_hookspecs(hookspecs)
    try:
        manager.register(module, name=module.__name__)
        manager.check_pending()
    except pluggy.PluginValidationError as error:
        raise PluginError(f"{error}. The only hook is 'streamkit_components', and it takes no argument.") from None
    if not manager.get_hookcallers(module):
        raise PluginError(
            f"the module {module.__name__} has no hook 'streamkit_components': a function without arguments, marked "
            "with @streamkit.hookimpl, that returns the list of its components"
        )
    try:
        items = list(module.streamkit_components())
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        what = f"{type(error).__name__}: {message_of(error)}"
        raise PluginError(f"the hook streamkit_components gives no list ({what})") from error
    for item in items:
        if not isinstance(item, Preset):
            check_class(item)
    return items


def check_class(cls: Any) -> None:
    """Raise PluginError for an object that is no complete component class."""
    if not (inspect.isclass(cls) and issubclass(cls, Component) and issubclass(cls, tuple(ROLES.values()))):
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
    names = [name for name in ROLES[cls.role].__annotations__ if name not in cls.model_fields]
    missing = ", ".join(name for name in names if not hasattr(cls, name))  # a constant that its base annotates
    if missing:
        raise PluginError(f"{cls.__name__} does not define {missing}, which every {cls.role} has")


def with_neighbours(path: Path) -> list[Path]:
    """Return a Python file and the files of its folder that it imports, directly or through each other."""
    files = [path]
    for file in files:
        try:
            tree = ast.parse(file.read_bytes())
        except (SyntaxError, ValueError):  # the import reports it
            continue
        names: set[str] = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        for parts in (name.split(".") for name in sorted(names)):
            inside = path.parent.joinpath(*parts)
            files += [f for f in (inside.with_suffix(".py"), inside / "__init__.py") if f.is_file() and f not in files]
    return files


def _module_name(path: Path, digest: str) -> str:
    return f"streamkit_file_{path.stem}_{digest}"


def is_loaded(path: Path) -> bool:
    """Return whether a plugin file with this name and content was imported by this process already."""
    try:
        expect_file(path)
        return _module_name(path, _digest(with_neighbours(path))) in sys.modules
    except (OSError, ValueError):
        return False


def _load_file(path: Path) -> tuple[str, ModuleType]:
    """Import a one-off plugin file; its supplier has the hash of the file and of the neighbours that it imports."""
    try:
        expect_file(path)
        digest = _digest(with_neighbours(path))
    except OSError as error:
        raise SpecError(f"plugins: cannot read {str(path)!r}: {error.strerror}") from None
    name = _module_name(path, digest)
    if name in sys.modules:
        return f"{path.name} sha256:{digest}", sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise SpecError(f"plugins: {str(path)!r} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # needed to unpickle its classes, and to load its cached machine code
    try:
        spec.loader.exec_module(module)
    except (PluginError, KeyboardInterrupt):
        del sys.modules[name]
        raise
    except BaseException as error:
        del sys.modules[name]
        raise PluginError(
            f"plugin file {path.name} failed to load ({type(error).__name__}: {message_of(error)})"
        ) from error
    return f"{path.name} sha256:{digest}", module
