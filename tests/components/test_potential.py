"""Parts of a host that are made of the others: `prepare` with the argument `host`."""

import pickle
from typing import Any, ClassVar

import numpy as np
import pytest
from pydantic import Field
from runfiles import BASE
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import NFW
from streamkit.model import Host

DISC = {"kind": "miyamoto_nagai", "mass": 6e10, "a": 3, "b": 0.3}
BULGE = {"kind": "hernquist", "mass": {"log_uniform": [1e9, 1e10]}, "a": 0.7}
RADII = np.geomspace(2.0, 150.0, 40)


def table(mass: Any) -> dict[str, Any]:
    """The spline of ln M(<r) over ln r, for `Spline` below."""
    nodes = np.linspace(np.log(0.05), np.log(500.0), 129)
    values = np.log(mass(np.exp(nodes)))
    pieces = sk.cubic_pieces(values, CubicSpline(nodes, values)(nodes, 1) * (nodes[1] - nodes[0]))
    return {"first": nodes[0], "last": nodes[-1], "pieces": pieces}


def force(x: Any, y: Any, z: Any, t: Any, first: Any, last: Any, pieces: Any) -> Any:
    r2 = x * x + y * y + z * z
    s = 0.5 * sk.log(r2)
    k = -sk.G * sk.exp(sk.cubic(s, (first, last), pieces) - 3.0 * s)
    return k * x, k * y, k * z


class Rest(sk.Potential):
    """A halo that makes G M(<r) / r of the whole host the square of a speed."""

    kind = "test_rest"
    example: ClassVar[dict[str, Any]] = {"v": 230.0}
    v: sk.Speed = Field(description="The speed.")
    acceleration = staticmethod(force)

    @staticmethod
    def prepare(v: Any, host: sk.HostView) -> dict[str, Any]:
        def rest(r: Any) -> Any:
            mass = v**2 * r / sk.G - host.mass_inside(r)
            if (mass <= 0).any():
                raise sk.OutOfDomain("nothing is left")
            return mass

        return table(rest)


class Contracted(sk.Potential):
    """An NFW halo of which each shell keeps M(<r) r while the rest of the host gathers (Blumenthal+ 1986)."""

    kind = "test_contracted"
    example: ClassVar[dict[str, Any]] = {"mass": 5e11, "rs": 16.0}
    mass: sk.Mass = Field(description="Scale mass.")
    rs: sk.Length = Field(description="Scale radius.")
    acceleration = staticmethod(force)

    @staticmethod
    def prepare(mass: Any, rs: Any, host: sk.HostView) -> dict[str, Any]:
        first = np.geomspace(0.05, 900.0, 300)
        result = nfw(first, mass, rs)
        grid = np.geomspace(0.01, 1000.0, 400)
        rest = CubicSpline(np.log(grid), host.mass_inside(grid))
        last = [
            brentq(lambda r, m=m, r0=r0: r * (m + rest(np.log(r))) - r0 * m, 0.011, 950.0)
            for m, r0 in zip(result, first, strict=True)
        ]
        inside = CubicSpline(np.log(last), np.log(result))
        return table(lambda r: np.exp(inside(np.log(r))))


class Slow(sk.Potential):
    """As `Rest`, through an expansion."""

    kind = "test_slow_rest"
    compiled = False
    evaluation = "expansion"
    v: sk.Speed = Field(description="The speed.")

    @staticmethod
    def prepare(v: Any, host: sk.HostView) -> dict[str, Any]:
        return {"inside": CubicSpline(np.geomspace(0.05, 600, 200), host.mass_inside(np.geomspace(0.05, 600, 200)))}

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, v: Any, inside: Any) -> Any:
        r = np.sqrt(x * x + y * y + z * z)
        k = -(v**2 / r - sk.G * inside(r) / r**2) / r
        return k * x, k * y, k * z


def nfw(r: Any, mass: Any, rs: Any) -> Any:
    return mass * (np.log(1 + r / rs) - r / (r + rs))


def loaded(**potentials: Any) -> sk.Spec:
    return sk.load(BASE | {"potential": potentials}, components=[Rest, Contracted, Slow])


@pytest.mark.parametrize("bulge", [2e9, 8e9])
def test_a_halo_that_completes_a_rotation_curve(bulge: float) -> None:
    spec = loaded(rest={"kind": "test_rest", "v": 230}, disc=DISC, bulge=BULGE)
    inputs = spec.bind({"potential.bulge.mass": bulge})
    host = Host(inputs.potentials)
    assert host.mass_inside(RADII) == pytest.approx(230.0**2 * RADII / sk.G, rel=1e-5)
    alone = Host({"rest": inputs.potentials["rest"]}).mass_inside(RADII)
    others = Host({name: inputs.potentials[name] for name in ("disc", "bulge")}).mass_inside(RADII)
    assert alone + others == pytest.approx(230.0**2 * RADII / sk.G, rel=1e-5)


def test_a_contracted_halo_keeps_its_adiabatic_invariant() -> None:
    spec = loaded(disc=DISC, halo={"kind": "test_contracted", "mass": 5e11, "rs": 16})
    potentials = spec.bind().potentials
    halo, disc = (Host({name: potentials[name]}) for name in ("halo", "disc"))
    mass, rest = halo.mass_inside(RADII), disc.mass_inside(RADII)
    before = np.array([brentq(lambda r, m=m: nfw(r, 5e11, 16.0) - m, 0.01, 2000.0) for m in mass])
    assert (before > 1.02 * RADII).any()
    assert RADII * (mass + rest) == pytest.approx(before * mass, rel=2e-5)
    alone = Host({"halo": Contracted(mass=5e11, rs=16.0)})
    assert alone.mass_inside(RADII) == pytest.approx(nfw(RADII, 5e11, 16.0), rel=1e-5)


def test_two_that_ask_see_the_same_others() -> None:
    spec = loaded(one={"kind": "test_rest", "v": 230}, disc=DISC, two={"kind": "test_rest", "v": 230})
    potentials = spec.bind().potentials
    one, two = (Host({name: potentials[name]}).mass_inside(RADII) for name in ("one", "two"))
    np.testing.assert_array_equal(one, two)
    assert Host(potentials).mass_inside(RADII) == pytest.approx(
        2 * 230.0**2 * RADII / sk.G - Host({"disc": potentials["disc"]}).mass_inside(RADII), rel=1e-5
    )


def test_an_expansion_of_one_that_asks_is_kept_and_follows_the_others() -> None:
    spec = loaded(slow={"kind": "test_slow_rest", "v": 230}, bulge=BULGE)
    for mass in (2e9, 8e9):
        potentials = spec.bind({"potential.bulge.mass": mass}).potentials
        q = np.array([[20.0, 3.0], [5.0, -4.0], [-9.0, 40.0]])
        r = np.sqrt((q**2).sum(axis=0))
        assert np.sqrt((Host(potentials).alone.acceleration(0.0, q) ** 2).sum(axis=0)) == pytest.approx(
            230**2 / r, rel=2e-3
        )
    still = loaded(slow={"kind": "test_slow_rest", "v": 230}, disc=DISC)
    assert still.bind().potentials["slow"].expanded() is still.bind().potentials["slow"].expanded()


def test_a_stream_a_rejection_and_pickles() -> None:
    spec = loaded(rest={"kind": "test_rest", "v": {"uniform": [150, 250]}}, disc=DISC)
    assert pickle.loads(pickle.dumps(spec.bind().potentials["rest"])).v == 200.0
    assert np.isfinite(sk.Model(spec.with_values({"progenitor.lookback": 0.5})).stream().q).all()
    heavy = loaded(rest={"kind": "test_rest", "v": 30}, disc=DISC)
    with pytest.raises(sk.OutOfDomain, match="nothing is left"):
        sk.Model(heavy).stream()


def test_who_may_ask() -> None:
    place = {"x": 30, "y": 1, "z": 2, "vx": 1, "vy": 2, "vz": 3}
    body = {"kind": "test_contracted", "mass": 1e10, "rs": 3, **place}
    with pytest.raises(sk.SpecError, match=r"body.a.kind: 'test_contracted' depends on the other parts of the host"):
        sk.load(BASE | {"body": {"a": body}}, components=[Contracted])
    with pytest.raises(sk.PluginError, match=r"prepare: the arguments are fields by name; found 'hots'"):

        class Wrong(sk.Potential):
            kind = "test_wrong"

            @staticmethod
            def prepare(hots):
                return {}

            @staticmethod
            def acceleration(x, y, z, t):
                return x, y, z


def test_the_argument_is_the_field_where_there_is_one() -> None:
    class Named(sk.Potential):
        """Has a field called host."""

        kind = "test_named_host"
        host: sk.Number = Field(default=2.0, description="A number.")

        @staticmethod
        def prepare(host):
            return {"twice": 2 * host}

        @staticmethod
        def acceleration(x, y, z, t, twice):
            return -twice * x, -twice * y, -twice * z

    assert not Named.asks_for_host()
    assert Named().in_engine_units() == (4.0,)
    assert NFW.asks_for_host() is False
