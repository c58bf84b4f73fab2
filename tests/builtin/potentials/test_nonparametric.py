"""The halo of no family: against NFW, power laws, its own density by Poisson's equation, and an ellipsoidal halo."""

from typing import Any

import numpy as np
import pytest
from runfiles import BASE

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import NFW
from streamkit.builtin.potentials.halos import NFWEllipsoidal
from streamkit.builtin.potentials.nonparametric import Nonparametric
from streamkit.components import Total
from streamkit.testing import quick_failures

RS, MASS = 16.0, 1e12
RNG = np.random.default_rng(5)
Q = RNG.normal(size=(3, 300)) * np.geomspace(0.3, 150, 300)
SECTION: dict[str, Any] = {"kind": "nonparametric", **Nonparametric.example}


def nfw_slope(r: Any, rs: float = RS) -> Any:
    return -(1 + 3 * r / rs) / (1 + r / rs)


def like_nfw(count: int, rs: float = RS, **fields: Any) -> Nonparametric:
    """A halo with the slopes of NFW at knots."""
    r = np.geomspace(0.005, 2000, count)
    slopes = nfw_slope(r, rs)
    inside = MASS * (np.log1p(20 / rs) - 20 / (20 + rs))
    return Nonparametric(**{"r": r, "slope": slopes[0], "bend": np.diff(slopes), "mass_inside": inside} | fields)


def test_with_the_slopes_of_nfw_it_is_nfw_by_the_square_of_the_distance_of_knots() -> None:
    wanted = Total((NFW(mass=MASS, rs=RS),))
    errors = []
    for count in (31, 61, 121):
        halo = Total((like_nfw(count),))
        errors.append((np.abs(halo.acceleration(Q) / wanted.acceleration(Q) - 1)).max())
    assert errors[2] < 1e-3
    assert 3.5 < errors[0] / errors[1] < 4.5
    assert 3.5 < errors[1] / errors[2] < 4.5
    depth, exact = (total.potential(Q) for total in (Total((like_nfw(121),)), wanted))
    assert depth is not None
    assert depth - depth[0] == pytest.approx(exact - exact[0], rel=2e-3, abs=100)


@pytest.mark.parametrize(("slope", "q"), [(-1.0, 0.8), (-2.5, 0.6), (-2.5, 1.3)])
def test_a_power_law_is_exact(slope: float, q: float) -> None:
    halo = Nonparametric(r=[1, 100], slope=slope, bend=[0.0], mass_inside=1e11, radius=10, q=[q])
    radii = np.array([2.0, 10.0, 50.0])
    core = 1e-3 ** (3 + slope) * (1 - (3 + slope) / 3)  # the missing mass of the constant density inside 1 pc
    wanted = 1e11 * (radii ** (3 + slope) - core) / (10 ** (3 + slope) - core)
    assert Total((halo,)).mass_inside(radii) == pytest.approx(wanted, rel=1e-6)
    plane = Total((halo,)).density(radii * np.array([[0.6], [0.8], [0]]))
    axis = Total((halo,)).density(radii * np.array([[0], [0], [q]]))
    assert axis == pytest.approx(plane, rel=1e-4)


def density(halo: Nonparametric, q: Any) -> Any:
    """The density of the docstring at positions q (3, n), up to a factor, by sums over fine steps."""
    r = np.sqrt((q**2).sum(axis=0))
    u = np.linspace(np.log(0.1), np.log(500), 200001)
    slopes = np.interp(u, np.log(halo.r), halo.slope + np.array([0, *np.cumsum(halo.bend)]))
    ln_rho = np.concatenate([[0], np.cumsum(0.5 * (slopes[1:] + slopes[:-1]) * np.diff(u))])
    slope, ratio = np.interp(np.log(r), u, slopes), np.exp(np.interp(np.log(r), np.log(halo.r_q), np.log(halo.q)))
    pole = ratio**-slope  # rho at the pole over rho in the plane, at one radius
    a = 2 * (pole - 1) / (pole + 2)
    assert (1 + a) / (1 - a / 2) == pytest.approx(pole)
    return np.exp(np.interp(np.log(r), u, ln_rho)) * (1 + a * (q[2] ** 2 - 0.5 * (q[0] ** 2 + q[1] ** 2)) / r**2)


def test_its_force_has_its_density() -> None:
    """Poisson's equation, with slopes that change and axis ratios from flat to long."""
    halo = Nonparametric(
        r=[1, 5, 20, 80], slope=-0.5, bend=[-1.2, 0.3, -1.6], mass_inside=1e11, q=[0.6, 1.2], r_q=[5, 60]
    )
    ratio = Total((halo,)).density(Q) / density(halo, Q)
    assert ratio == pytest.approx(np.median(ratio), rel=3e-4)
    r = np.sqrt((Q**2).sum(axis=0))
    between = (np.abs(np.log(r / np.array([1, 5, 20, 60, 80])[:, None])) > 0.02).all(axis=0)  # no knot in the cell
    assert ratio[between] == pytest.approx(np.median(ratio), rel=1e-5)
    assert Total((halo,)).mass_inside(np.array([20.0])) == pytest.approx(1e11, rel=1e-6)


def test_the_density_is_positive_for_all_parameters() -> None:
    for _ in range(30):
        r = np.sort(np.exp(RNG.uniform(-1, 6, 6)))
        halo = Nonparametric(
            r=r, slope=RNG.uniform(-2, 1), bend=RNG.normal(-0.4, 1.0, 5), mass_inside=1e11, radius=r[2],
            q=np.exp(RNG.normal(0, 0.7, 2)), r_q=[5, 50],
        )  # fmt: skip
        pull = np.sqrt((Total((halo,)).acceleration(Q) ** 2).sum(axis=0)) / np.sqrt((Q**2).sum(axis=0))
        assert (Total((halo,)).density(Q) > -1e-5 * pull / (4 * np.pi * sk.G)).all()  # of differences of the force


def test_a_flattened_halo_is_nearly_the_ellipsoid() -> None:
    """Of the same axis ratio, and with the scale radius of the sphere of the same volume."""
    ellipsoid = Total((NFWEllipsoidal(mass=MASS, rs=RS, q=0.85),))
    halo = Total((like_nfw(60, RS * 0.85 ** (1 / 3), q=[0.85], mass_inside=float(ellipsoid.mass_inside([20.0])[0])),))
    r = np.array([5.0, 10.0, 20.0, 50.0, 100.0])
    assert halo.mass_inside(r) == pytest.approx(ellipsoid.mass_inside(r), rel=0.01)
    assert halo.flattening(r, r) == pytest.approx(ellipsoid.flattening(r, r), abs=0.005)


def test_no_mass_lies_beyond_and_the_conditions_of_a_component_hold() -> None:
    halo = Total((like_nfw(8),))
    far = np.array([3e5, 1e7])
    assert halo.mass_inside(far) == pytest.approx(halo.mass_inside(np.array([2.1e5]))[0], rel=1e-6)
    assert quick_failures(Nonparametric(**Nonparametric.example)) == []


def loaded(**fields: Any) -> sk.Spec:
    return sk.load(BASE | {"potential": SECTION | fields})


def test_every_knot_may_have_a_prior() -> None:
    spec = loaded(bend=[{"normal": [-0.3, 0.3]}] * 6, q=[{"uniform": [0.5, 1.5]}, 1])
    assert {"potential.bend.0", "potential.bend.5", "potential.q.0"} <= set(spec.names)
    halo = spec.bind_all({"potential.bend.2": -1.0}).potentials["potential"]
    assert halo.bend == pytest.approx([-0.3, -0.3, -1.0, -0.3, -0.3, -0.3])


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"bend": [0.1, 0.2]}, r"bend has 2 number\(s\) and r 7 knots: expected 6"),
        ({"radius": "1 kpc"}, r"radius is 1 kpc, expected 2 to 200"),
        ({"q": [0.8]}, r"q has 1 number\(s\) and r_q 2 radii"),
        ({"q": [0.8, -1]}, "an axis ratio must be positive, found -1"),
        ({"r": [5, 2, 10, 20, 40, 80, 200]}, "larger than the one before"),
        ({"mass_inside": 0}, "mass_inside"),
        ({"q": [{"normal": [0.8, 0.1]}, {"uniform": [-1, 1]}]}, r"potential\.q.*outside the field's range"),
    ],
)
def test_bad_fields_are_told(fields: Any, said: str) -> None:
    with pytest.raises(sk.SpecError, match=said):
        loaded(**fields)
