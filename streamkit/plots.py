"""Pictures of a run and of a stream: one function each, on figures of their own, with no global state."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from streamkit.phase import Array, Prediction, Stream
from streamkit.units import GYR

if TYPE_CHECKING:
    from astropy.table import QTable

    from streamkit.results import Results
    from streamkit.spec import Setup

LEADING_COLOUR, TRAILING_COLOUR, BOUND_COLOUR = "#0072B2", "#D55E00", "#7F7F7F"
"""Okabe & Ito's blue and vermilion, told apart by every eye, and grey."""
BAND = "#0072B2"
DATA = "black"

SYMBOLS = {
    "potential.v0": r"$v_0$",
    "potential.rs": r"$r_s$",
    "potential.alpha": r"$\alpha$",
    "progenitor.mass": r"$M_{\rm sat}$",
    "progenitor.radius": r"$a_{\rm sat}$",
    "progenitor.distance": r"$d$",
    "progenitor.v_los": r"$v_{\rm los}$",
    "progenitor.pm_l_cosb": r"$\mu_l \cos b$",
    "progenitor.pm_b": r"$\mu_b$",
    "progenitor.lookback": r"$t_{\rm back}$",
    "stripping.sigma": r"$\sigma$",
    "sun.r0": r"$R_0$",
    "sun.v_circ": r"$v_{\rm c}(R_0)$",
}
"""The field's symbols for parameters of the built-in components; others show their name."""


def radii(_results: Results) -> Array:
    """(nr,) Radii in kpc that the pictures of a profile are drawn at."""
    return np.linspace(5.0, 200.0, 79)


def remark(results: Results) -> str:
    """Return what every picture says above its axes: nothing for a converged run."""
    return "QUICK LOOK: not for science" if results.quick else ""


def corner(results: Results) -> Figure:
    """Draw the marginal distributions of all pairs of parameters, with 68 % and 95 % contours."""
    raise AssertionError(results)


def mass_profile(results: Results, profile: QTable | None = None, axes: Axes | None = None) -> Figure:
    """Draw the mass inside each radius with its 68 % and 95 % bands, and the apocentres of the data."""
    raise AssertionError(results, profile, axes)


def rotation_curve(results: Results, profile: QTable | None = None, axes: Axes | None = None) -> Figure:
    """Draw the circular velocity with its 68 % and 95 % bands."""
    raise AssertionError(results, profile, axes)


def traces(results: Results) -> Figure:
    """Draw the walkers' paths: every parameter and ln p against the step, with the burn-in shaded."""
    raise AssertionError(results)


def stream(stream: Stream, prediction: Prediction | None, setup: Setup, note: str = "") -> Figure:
    """Draw a stream in its orbital plane, and unwrapped with the fitted apocentres and the data over it."""
    raise AssertionError(stream, prediction, setup, note)


def save_stream(stream_: Stream, prediction: Prediction | None, setup: Setup, path: Path) -> None:
    """Draw a stream into a file; its suffix says the format."""
    stream(stream_, prediction, setup).savefig(path, dpi=200)
