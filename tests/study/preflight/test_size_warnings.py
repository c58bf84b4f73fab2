"""Numbers that are too large for an orbit, on a circle whose angular velocity is known."""

from __future__ import annotations

from typing import Any

import pytest

import streamkit as sk
from streamkit.study.preflight.orbit import summarise_orbit
from streamkit.study.preflight.size_warnings import size_warnings

RADIUS, SPEED = 10.0, 300.0  # kpc, km/s: 30.7 rad/Gyr
KEPLER = {"kind": "kepler", "mass": SPEED**2 * RADIUS / sk.G}
ON_SKY = {
    "kind": "plummer", "mass": 1e6, "radius": 0.1, "b": 10, "distance": 20, "pm_l_cosb": 0, "pm_b": 0, "v_los": 0,
    "lookback": 1,
}  # fmt: skip


def warned(**sections: Any) -> list[str]:
    document = {
        "potential": KEPLER,
        "progenitor": {"kind": "plummer", "mass": 1e6, "radius": 0.1, "lookback": 0.5}
        | dict(zip(("x", "y", "z", "vx", "vy", "vz"), (RADIUS, 0, 0, 0, SPEED, 0), strict=True)),
        "stripping": {"kind": "mlcs", "particles": 100, "sigma": 1},
    }
    inputs = sk.load(document | sections).bind()
    return size_warnings(inputs, summarise_orbit(inputs))


@pytest.mark.parametrize("kind", ["leapfrog", "pefrl"])
def test_a_step_of_a_radian_is_too_long(kind: str) -> None:
    radian = RADIUS / SPEED / sk.GYR
    assert warned(integrator={"kind": kind}) == warned(integrator={"kind": kind, "step": 0.99 * radian}) == []
    (text,) = warned(integrator={"kind": kind, "step": 10.0})
    assert text.startswith("integrator.step = 10 Gyr is too long for this orbit")
    assert f"1 radian in {radian:.2g} Gyr" in text


def test_a_dispersion_above_the_orbital_speed_is_a_likely_wrong_unit() -> None:
    assert warned(stripping={"kind": "mlcs", "particles": 100, "sigma": 0.9 * SPEED}) == []
    (text,) = warned(stripping={"kind": "mlcs", "particles": 100, "sigma": 1e4})
    assert "stripping.sigma = 10000 km/s is above the progenitor's own speed, 300 km/s" in text


@pytest.mark.parametrize(
    ("section", "message"),
    [
        (
            {"integrator": {"kind": "adaptive", "eta": 1000}},
            "integrator.eta: found 1000, should be less .* equal to 2",
        ),
        ({"integrator": {"kind": "adaptive", "eta_progenitor": 9}}, "less than or equal to 2"),
        (
            {"integrator": {"kind": "dop853", "rtol": 100}},
            "integrator.rtol: found 100, should be less than",
        ),
        ({"progenitor": ON_SKY | {"l": 3000}}, "progenitor.l: found 3000 deg, should be less than or equal to 360"),
        ({"sampler": {"walkers": 10**9}}, "sampler.walkers: found 1000000000, should be less than or equal to 100000"),
        ({"sampler": {"steps": 10**21}}, "should be less than or equal to 100000000"),
    ],
)
def test_absurd_numbers_are_refused(section: dict[str, Any], message: str) -> None:
    with pytest.raises(sk.SpecError, match=message):
        warned(**section)
