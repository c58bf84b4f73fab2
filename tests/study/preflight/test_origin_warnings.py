"""The warning about a galaxy whose centre leaves the origin: what Galileo's transformation moves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import streamkit as sk
from streamkit.model import NODE, Host
from streamkit.study.preflight import run_preflight
from streamkit.units import GYR

SPEED, LOOKBACK = 100.0, 2.0
AWAY = SPEED * LOOKBACK * GYR
ORIGIN = "measured from the origin"


def run_file(speed: float) -> dict[str, Any]:
    """A stream in a halo that moves along x, and is at the origin today; the progenitor moves along."""
    halo: dict[str, Any] = {"kind": "nfw", "mass": 1e12, "rs": "15 kpc"}
    if speed:
        halo["centre"] = {"t": [-3, 0], "x": [-3 * GYR * speed, 0], "y": [0, 0], "z": [0, 0]}
    return {
        "potential": {"halo": halo},
        "progenitor": {"kind": "plummer", "mass": 1e5, "radius": "10 pc", "x": 15, "y": 0, "z": 5, "vx": speed,
                       "vy": 150, "vz": 50, "lookback": LOOKBACK},
        "stripping": {"kind": "mlcs", "particles": 200},
    }  # fmt: skip


def warnings_of(document: Any) -> list[str]:
    return [text for text in run_preflight(sk.load(document), draws=0).warnings if ORIGIN in text]


def test_the_warning_says_how_far_the_centre_was() -> None:
    (text,) = warnings_of(run_file(SPEED))
    assert f"potential.halo.centre is up to {AWAY:.3g} kpc from the origin, {LOOKBACK:.3g} Gyr ago" in text
    assert f"{np.hypot(15, 5):.3g} kpc from that centre today" in text
    assert warnings_of(run_file(0.0)) == []
    assert warnings_of(run_file(0.1)) == []  # 0.2 kpc


def test_a_satellite_on_a_path_is_not_the_galaxy_of_the_stream() -> None:
    assert warnings_of(Path(__file__).parents[3] / "examples" / "moving_host" / "moving_host.toml") == []


def test_orbits_are_followed_all_the_same() -> None:
    """An orbit has nodes at equal times. Seen from the halo it is the orbit in a halo at rest."""
    at_rest, moving = (sk.load(run_file(speed)).bind() for speed in (0.0, SPEED))
    here, there = (
        Host(inputs.potentials).alone.orbit(inputs.q, inputs.v, 0.0, -LOOKBACK * GYR, NODE)
        for inputs in (at_rest, moving)
    )
    assert np.abs(there.q).max() > 0.9 * AWAY
    assert there.q - np.outer([SPEED, 0, 0], there.t) == pytest.approx(here.q, abs=1e-5)
