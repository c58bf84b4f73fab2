"""Warnings about live progenitors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import streamkit as sk
from streamkit.model import Model
from streamkit.study.preflight import run_preflight
from streamkit.study.preflight.warnings import weight_warnings

DARK_HALO = {
    "potential": {"kind": "tf", "v0": "215 km/s", "rs": "12 kpc", "alpha": 0.45},
    "progenitor": {
        "kind": "nfw_truncated", "mass": "2e9 Msun", "rs": "1 kpc", "rt": "5 kpc",
        "x": 25, "y": 0, "z": 0, "vx": 0, "vy": 120, "vz": 100, "lookback": "1 Gyr",
    },
    "stripping": {"kind": "restricted_nbody", "particles": 1000, "stars": "hernquist", "stars_radius": "0.1 kpc"},
}  # fmt: skip
WORTH = "stand for most of its stars"


def test_stars_deep_in_a_dark_halo_are_named_by_check() -> None:
    """A tenth of r_s holds 0.4 % of the halo and a quarter of Hernquist's stars of that radius."""
    (warning,) = [text for text in run_preflight(sk.load(DARK_HALO)).warnings if WORTH in text]
    assert "all of them (1000)" in warning
    assert "Raise stripping.particles" in warning
    without = {"kind": "restricted_nbody", "particles": 1000}
    assert not any(WORTH in text for text in run_preflight(sk.load({**DARK_HALO, "stripping": without})).warnings)


@pytest.mark.parametrize(("share", "worth"), [(0.0, None), (0.9, 5)])
def test_the_number_of_equal_particles(share: float, worth: int | None) -> None:
    """Four particles with a share s of the weight of n, evenly: (s^2 / 4 + (1 - s)^2 / (n - 4))^-1 equal ones."""
    spec = sk.load({**DARK_HALO, "stripping": {"kind": "restricted_nbody", "particles": 1000}})
    stream = Model(spec).stream()
    out = np.flatnonzero(~stream.bound)
    weight = np.ones(len(stream))
    if share:
        weight[out] = (1 - share) / (len(out) - 4)
        weight[out[:4]] = share / 4
    warnings = weight_warnings(spec, spec.bind(), replace(stream, weight=weight))
    if worth is None:
        assert warnings == []
    else:
        assert round(1 / (share**2 / 4 + (1 - share) ** 2 / (len(out) - 4))) == worth
        assert f"those that have left it ({len(out)}) are worth {worth} equal ones" in warnings[0]
