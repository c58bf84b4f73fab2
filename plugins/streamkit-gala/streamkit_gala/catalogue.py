"""The potentials of gala by name, and their parameters as gala declares them."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cache
from typing import Any

import numpy as np

# Physical types that a run file can hold.
PHYSICAL = ("mass", "length", "speed", "angle", "mass density", "dimensionless")
IN_TIME = "TimeInterpolatedPotential"  # another potential of gala's whose parameters change
# Classes that are no potentials; sums are several sections of a run file.
NOT_ALONE = ("PotentialBase", "CPotentialBase", "CompositePotential", "CCompositePotential", "NullPotential")


@dataclass(frozen=True)
class Parameter:
    """A parameter of a gala potential."""

    name: str  # name in the run file: gala's name, ``m``, and for a part of a composite ``halo_m``
    keys: tuple[str, ...]  # the keys of gala's argument: ``("m",)``, ``("halo", "m")``
    physical_type: str | None  # astropy's name; None for a parameter that is no physical quantity
    default: Any = None  # gala's default in the units of `unit_system`; None if there is none
    dimensions: int = 0  # 0 for a number


@cache
def unit_system() -> Any:
    """Return gala's unit system with the units of streamkit's engine: kpc, km/s, Msun, rad, and G from astropy.

    It names the derived units, too: gala would compose them anew in every call, for a millisecond.
    """
    import astropy.units as u  # these two are slow to import, and only a run file with a gala potential needs them
    from gala.units import UnitSystem

    speed = u.km / u.s
    time = u.def_unit("kpc/(km/s)", u.kpc / speed)
    return UnitSystem(u.kpc, time, u.Msun, u.rad, speed, speed**2, speed**2 / u.kpc)


@cache
def classes() -> Mapping[str, Any]:
    """Return gala's potentials by name. ValueError if gala cannot be imported."""
    try:
        from gala import potential
    except ImportError as error:
        raise ValueError(f"gala cannot be imported ({error}): pip install 'gala>=1.11'") from None
    items = vars(potential).items()
    return {
        name: item
        for name, item in items
        if inspect.isclass(item)
        and issubclass(item, potential.PotentialBase)
        and item.ndim == 3
        and name not in NOT_ALONE
    }


def class_called(name: Any) -> Any:
    """Return gala's class; ValueError with the nearest name if there is none."""
    potentials = classes()
    if isinstance(name, str) and name in potentials:
        return potentials[name]
    import gala

    lower = {item.lower(): item for item in potentials}
    guess = str(name).lower()
    matches = get_close_matches(guess, lower, 1) or get_close_matches(guess + "potential", lower, 1)
    hint = f" Did you mean {lower[matches[0]]!r}?" if matches else ""
    raise ValueError(
        f"gala {gala.__version__} has no potential {name!r}.{hint} It has {', '.join(sorted(potentials))}."
    )


def construct(cls: Any, values: Mapping[tuple[str, ...], Any]) -> Any:
    """Build a gala potential from numbers in the units of `unit_system`, by gala's keys."""
    arguments: dict[str, Any] = {}
    for (first, *rest), value in values.items():
        if rest:
            arguments.setdefault(first, {})[rest[0]] = value
        else:
            arguments[first] = value
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what later versions of gala will do: the version is part of a run
        return cls(units=unit_system(), **arguments)


def parameters_of(name: str, options: Mapping[str, Any]) -> tuple[Parameter, ...]:
    """Return the parameters of the potential that gala calls ``name``.

    ``options`` is the section of the run file: the ``version`` of a Milky Way, the ``lmax`` of a multipole and the
    potential that changes in time decide which parameters there are.

    Raises ValueError: If there is no such potential, or it takes what a run file cannot hold.
    """
    cls = class_called(name)
    signature = inspect.signature(cls)
    if hasattr(cls, "keys"):
        return tuple(_of_composite(cls, signature, options))
    if name == "MultipolePotential":
        return tuple(_of_multipole(options))
    if name == IN_TIME:
        return tuple(_of_changing(options))
    return tuple(_of_class(name, cls)) + tuple(_switches(signature))


def _of_class(name: str, cls: Any) -> Iterator[Parameter]:
    for key, declared in cls._parameters.items():
        default = _in_system(declared.default)
        parameter = Parameter(key, (key,), declared.physical_type, default, getattr(declared, "ndim", 0))
        is_number = parameter.physical_type in PHYSICAL and not parameter.dimensions
        if not is_number and not (parameter.dimensions and parameter.physical_type == "dimensionless"):
            raise ValueError(
                f"gala's {name} takes {key!r}, a {parameter.physical_type or 'Python object'}"
                f"{' array' if parameter.dimensions else ''}, which this section cannot hold. streamkit has "
                "spherical_table and multipole for tables, and [body.NAME] for what moves."
            )
        yield parameter


def _of_changing(options: Mapping[str, Any]) -> Iterator[Parameter]:
    """Yield the times, and the parameters of the potential that changes, with one dimension more where lists are."""
    inner = options.get("potential_cls")
    if not isinstance(inner, str):
        raise ValueError('potential_cls: missing; the name of the potential that changes, such as "NFWPotential"')
    try:
        cls = class_called(inner)
        if inner == IN_TIME or hasattr(cls, "keys"):
            raise ValueError(f"found {inner!r}, expected a potential with parameters of its own")
        declared = tuple(_of_class(inner, cls))
    except ValueError as error:
        raise ValueError(f"potential_cls: {error}") from None
    yield Parameter("potential_cls", ("potential_cls",), None, inner)
    yield Parameter("time_knots", ("time_knots",), "time", None, 1)
    yield Parameter("interpolation_method", ("interpolation_method",), None, "cspline")
    for each in declared:
        given = options.get(each.name)
        rows = isinstance(given, list | np.ndarray) or (isinstance(given, Mapping) and "file" in given)
        yield replace(each, default=None, dimensions=1) if rows and not each.dimensions else each


def _of_composite(cls: Any, signature: inspect.Signature, options: Mapping[str, Any]) -> Iterator[Parameter]:
    """Yield the parameters of the parts, with gala's values as defaults."""
    given = {}
    if "version" in signature.parameters:
        yield Parameter("version", ("version",), None, "latest")
        given = {("version",): options.get("version", "latest")}
    for part, potential in construct(cls, given).items():
        for key, value in potential.parameters.items():
            declared = potential._parameters[key]
            yield Parameter(f"{part}_{key}", (part, key), declared.physical_type, _in_system(value))
        for switch in _switches(inspect.signature(type(potential))):
            yield Parameter(f"{part}_{switch.name}", (part, switch.name), None, switch.default)


def _of_multipole(options: Mapping[str, Any]) -> Iterator[Parameter]:
    order = options.get("lmax")
    if not isinstance(order, int) or isinstance(order, bool) or not 0 <= order <= 20:
        raise ValueError(f"lmax: found {order!r}, expected a whole number from 0 to 20, the order of the multipoles")
    yield Parameter("lmax", ("lmax",), None, order)
    yield Parameter("inner", ("inner",), None, False)
    yield Parameter("m", ("m",), "mass")
    yield Parameter("r_s", ("r_s",), "length")
    for degree in range(order + 1):
        for m in range(degree + 1):
            for kind in ("S", "T") if m else ("S",):
                yield Parameter(f"{kind}{degree}{m}", (f"{kind}{degree}{m}",), "dimensionless", 0.0)


def _switches(signature: inspect.Signature) -> Iterator[Parameter]:
    """Yield the parameters that are true or false."""
    for key, parameter in signature.parameters.items():
        if isinstance(parameter.default, bool):
            yield Parameter(key, (key,), None, parameter.default)


def _in_system(value: Any) -> Any:
    """Return a number in the units of `unit_system`."""
    if hasattr(value, "unit"):
        value = value.decompose(unit_system()).value
    return float(value) if value is not None and not isinstance(value, str | bool) else value
