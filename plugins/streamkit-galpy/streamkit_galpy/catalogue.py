"""The potentials and Milky Way models of galpy by name, and the units of their parameters."""

from __future__ import annotations

import ast
import inspect
import textwrap
import warnings
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from typing import Any

# Units by the name of the function ``galpy.util.conversion.parse_...`` through which a parameter goes.
PARSED = {
    "length": "kpc",
    "length_kpc": "kpc",
    "velocity": "km/s",
    "velocity_kms": "km/s",
    "angle": "deg",
    "frequency": "km / (s kpc)",
    "time": "Gyr",
    "mass": "Msun",
    "dens": "Msun/kpc3",
    "surfdens": "Msun/kpc2",
    "energy": "km2/s2",
}
# Units by galpy's ``amp_units``.
AMPLITUDES = {"mass": "Msun", "velocity2": "km2/s2", "density": "Msun/kpc3", "surfacedensity": "Msun/kpc2"}
SCALES = ("ro", "vo")
ABSTRACT = {"Potential", "CompositePotential", "WrapperPotential", "NullPotential"}
WRAPPED = "pot_"  # how the name and the parameters of the potential in a wrapper begin


@cache
def models() -> tuple[str, ...]:
    """Return the names of the Milky Way models, which galpy builds when they are asked for."""
    from galpy.potential import mwpotentials

    return "MWPotential2014", *(name for name in dir(mwpotentials) if not name.startswith("_"))


@cache
def classes() -> Mapping[str, Any]:
    """Return galpy's potentials in three dimensions by name."""
    from galpy import potential

    return {
        name: item
        for name, item in vars(potential).items()
        if inspect.isclass(item) and name not in ABSTRACT
        if issubclass(item, potential.Potential) or is_wrapper(name)
    }


def is_wrapper(name: str) -> bool:
    """Return whether a potential is made of another one, and gets its numbers from it."""
    return name.endswith("WrapperPotential") and name not in ABSTRACT


def check_name(name: Any) -> None:
    """Refuse what galpy does not have: a ValueError with the nearest name. So if galpy cannot be imported."""
    try:
        import galpy
        from galpy import potential  # noqa: F401
    except ImportError as error:
        raise ValueError(f"galpy cannot be imported ({error}): pip install 'galpy>=1.10'") from None
    names = sorted({*classes(), *models()})
    if name not in names:
        lower = {item.lower(): item for item in names}
        guess = str(name).lower()
        matches = get_close_matches(guess, lower, 1) or get_close_matches(guess + "potential", lower, 1)
        hint = f" Did you mean {lower[matches[0]]!r}?" if matches else ""
        raise ValueError(f"galpy {galpy.__version__} has no potential {name!r}.{hint} It has {', '.join(names)}.")


def signature_of(name: str) -> Mapping[str, inspect.Parameter]:
    """Return the arguments of a class of galpy's by name, without ro and vo."""
    parameters = inspect.signature(classes()[name]).parameters
    return {
        key: item for key, item in parameters.items() if key not in SCALES and item.kind is item.POSITIONAL_OR_KEYWORD
    }


@cache
def units_of(name: str) -> Mapping[str, str]:
    """Return the units of the arguments of a class that are physical quantities.

    galpy declares no units: its constructors send each such argument through a function of ``galpy.util.conversion``,
    and say in ``amp_units`` what the amplitude is. That is read from their source.
    """
    units: dict[str, str] = {}
    for cls in inspect.getmro(classes()[name]):
        if "__init__" in vars(cls) and cls is not object:
            tree = ast.parse(textwrap.dedent(inspect.getsource(cls.__init__)))
            for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
                units = _units_in(call) | units
    chosen = signature_of(name).get("amp_units")
    if chosen is not None and chosen.default in AMPLITUDES:
        units["amp"] = AMPLITUDES[chosen.default]
    return {key: unit for key, unit in units.items() if key in signature_of(name)}


def _units_in(call: ast.Call) -> dict[str, str]:
    parser = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    unit = PARSED.get(parser.removeprefix("parse_")) if parser.startswith("parse_") else None
    units = {call.args[0].id: unit} if unit and call.args and isinstance(call.args[0], ast.Name) else {}
    for keyword in call.keywords:
        if keyword.arg == "amp_units" and isinstance(keyword.value, ast.Constant) and keyword.value.value:
            units["amp"] = AMPLITUDES[keyword.value.value]
    return units


def model_scales(name: str) -> tuple[float, float]:
    """Return ro in kpc and vo in km/s: a Milky Way model's own, or galpy's 8 kpc and 220 km/s."""
    if name not in models() or name == "MWPotential2014":
        return 8.0, 220.0
    first = model(name)[0]
    return float(first._ro), float(first._vo)


def model(name: str) -> Any:
    """Return a Milky Way model; galpy takes a minute to build some."""
    from galpy import potential
    from galpy.potential import mwpotentials

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of galpy's own arithmetic
        return getattr(potential, name) if hasattr(potential, name) else getattr(mwpotentials, name)
