"""The warning about a galaxy that leaves the host's centre: if all its parts move, the centre moves along."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import streamkit as sk
from streamkit.study.preflight import describe_preflight, run_preflight
from streamkit.units import GYR

SPEED, LOOKBACK = 100.0, 2.0
AWAY = SPEED * LOOKBACK * GYR
ORIGIN = "measured from the "


def run_file(speed: float, bulge: bool = True) -> dict[str, Any]:
    """A stream in a halo that moves along x, and is at the origin today; the progenitor moves along.

    Its bulge, if it has one, was forgotten at the origin.
    """
    halo: dict[str, Any] = {"kind": "nfw", "mass": 1e12, "rs": "15 kpc"}
    if speed:
        halo["centre"] = {"t": [-3, 0], "x": [-3 * GYR * speed, 0], "y": [0, 0], "z": [0, 0]}
    parts = {"halo": halo} | ({"bulge": {"kind": "hernquist", "mass": 1e9, "a": 0.5}} if bulge else {})
    return {
        "potential": parts,
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
    assert "give them the same centre" in text
    assert warnings_of(run_file(0.0)) == []
    assert warnings_of(run_file(0.1)) == []  # 0.2 kpc


def test_a_satellite_on_a_path_is_not_the_galaxy_of_the_stream() -> None:
    assert warnings_of(Path(__file__).parents[3] / "examples" / "moving_host" / "moving_host.toml") == []


def test_where_all_parts_move_there_is_no_warning_and_the_check_says_so() -> None:
    spec = sk.load(run_file(SPEED, bulge=False))
    assert warnings_of(run_file(SPEED, bulge=False)) == []
    text = " ".join(describe_preflight(spec, run_preflight(spec, draws=0)).split())
    assert f"up to {AWAY:.3g} kpc from the origin of the coordinates, {LOOKBACK:.3g} Gyr ago" in text
    still = sk.load(run_file(0.0))
    assert "the host's centre" not in describe_preflight(still, run_preflight(still, draws=0))


def test_the_lighter_galaxy_has_a_warning() -> None:
    """A stream about a satellite, which is on its own path: all is measured from the centre of the heavier galaxy."""
    document = run_file(SPEED, bulge=False)
    document["potential"]["giant"] = {"kind": "nfw", "mass": 5e13, "rs": "50 kpc"} | {
        "centre": {"t": [-3, 0], "x": [2000, 2000], "y": [0, 0], "z": [0, 0]}
    }
    (text,) = warnings_of(document)
    assert "potential.halo.centre is up to" in text
    assert "from the centre of the host" in text


LMC = {"kind": "hernquist", "mass": 1.5e11, "a": 20.0, "x": -1, "y": -41, "z": -27, "vx": -57, "vy": -226, "vz": 221}
TWICE = "The motion of the host is given"


@pytest.mark.parametrize(
    ("more", "moving"),
    [
        ({"body": {"lmc": LMC}}, ["body.lmc"]),
        ({"progenitor": {"mass": 5e9, "radius": 3.0, "reflex": True}}, ["progenitor"]),
        ({"body": {"lmc": LMC | {"reflex": False}}}, []),
        ({"body": {"lmc": LMC | {"mass": 1e7}}}, []),  # which moves the host by nothing that counts
    ],
    ids=["body", "progenitor", "no reflex", "light"],
)
def test_a_host_that_a_path_and_a_body_move_has_a_warning(more: dict[str, Any], moving: list[str]) -> None:
    document = run_file(SPEED, bulge=False)
    t = np.linspace(-3, 0, 7)
    for swing in (0.0, 10.0):  # km/s; a path without acceleration is not the answer to a pull
        x = SPEED * GYR * t + swing * GYR * t**2
        document["potential"]["halo"]["centre"] = {"t": t.tolist(), "x": x.tolist(), "y": [0.0] * 7, "z": [0.0] * 7}
        for name, section in more.items():
            document[name] = document.get(name, {}) | section
        texts = [text for text in run_preflight(sk.load(document), draws=0).warnings if TWICE in text]
        assert len(texts) == (swing > 0 and len(moving) > 0)
        for text in texts:
            assert f"given (potential.halo.centre), and the host is moved by the pull of {moving[0]} too" in text
            assert f"set {moving[0]}.reflex = false" in text


@pytest.mark.parametrize(
    ("given", "reflex", "warned"),
    [
        ({"az": -50.0}, True, True),
        ({"az": {"times": [-3, 0], "values": [-50.0, 0.0]}}, True, True),  # nothing today
        ({"az": {"normal": [0.0, 50.0]}}, True, True),  # nothing at the centre of the prior
        ({"az": 0.0}, True, False),
        ({"az": -50.0}, False, False),
    ],
    ids=["constant", "in time", "free", "none", "no reflex"],
)
def test_a_host_that_a_uniform_acceleration_and_a_body_move_has_a_warning(
    given: dict[str, Any], reflex: bool, warned: bool
) -> None:
    document = run_file(0.0, bulge=False) | {"body": {"lmc": LMC | {"reflex": reflex}}}
    document["potential"]["frame"] = {"kind": "uniform_acceleration", **given}
    texts = [text for text in run_preflight(sk.load(document), draws=0).warnings if TWICE in text]
    assert len(texts) == warned
    for text in texts:
        assert "leave out potential.frame, or set body.lmc.reflex = false" in text
