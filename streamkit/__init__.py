"""streamkit: weigh a galaxy with a tidal stream.

The one door: every public name, and nothing else. What needs numba, emcee or astropy is loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from streamkit.components import Component, Integrator, Observable, Potential, Stripping
from streamkit.errors import (
    ChainError,
    ComponentError,
    OutOfDomain,
    PluginError,
    SpecError,
    StreamkitError,
)
from streamkit.functions import exp, log, power, sqrt
from streamkit.hookspecs import hookimpl
from streamkit.phase import LEADING, TRAILING, Array, BoolArray, IntArray, Orbit, Prediction, Release, Stream
from streamkit.units import (
    GYR,
    Angle,
    AngleDatum,
    Coordinate,
    Duration,
    G,
    Length,
    LengthDatum,
    Mass,
    Number,
    PositiveNumber,
    ProperMotion,
    Speed,
    Velocity,
    VelocityDatum,
)

if TYPE_CHECKING:
    from streamkit.model import Model
    from streamkit.posterior import Posterior
    from streamkit.results import Results
    from streamkit.runner import run
    from streamkit.spec import Spec, load

__version__ = "0.1.0"

_LAZY = {
    "Model": "model",
    "Posterior": "posterior",
    "Results": "results",
    "Spec": "spec",
    "load": "spec",
    "run": "runner",
}

__all__ = [
    "GYR", "LEADING", "TRAILING", "Angle", "AngleDatum", "Array", "BoolArray", "ChainError", "Component",
    "ComponentError", "Coordinate", "Duration", "G", "IntArray", "Integrator", "Length", "LengthDatum", "Mass",
    "Model", "Number", "Observable", "Orbit", "OutOfDomain", "PluginError", "PositiveNumber", "Posterior",
    "Potential", "Prediction", "ProperMotion", "Release", "Results", "Spec", "SpecError", "Speed", "Stream",
    "StreamkitError", "Stripping", "Velocity", "VelocityDatum", "exp", "hookimpl", "load", "log", "power",
    "run", "sqrt",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"streamkit.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'streamkit' has no attribute {name!r}")
