"""Numbers and arrays as arguments of a compiled force, what `prepare` makes of the fields, and forces that grow."""

import pickle
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from numba import njit
from pydantic import Field
from scipy.integrate import solve_ivp

import streamkit as sk
from streamkit.builtin.potentials.closed_forms import NFW, Hernquist
from streamkit.elementary import cubic, cubic_pieces
from streamkit.engine import LEAPFROG, build_field, split_step
from streamkit.engine.arguments import layout_of, pack, unpacker

RNG = np.random.default_rng(5)
PLACES = RNG.normal(size=(3, 300)) * 20
TIMES = np.linspace(-3.0, 0.0, 300)


@pytest.mark.parametrize(
    "values",
    [
        (),
        (2.0,),
        (1.0, 2.0),
        (np.arange(3.0),),
        (1.5, np.arange(6.0).reshape(2, 3), 2.5, np.arange(8.0).reshape(2, 2, 2)),
    ],
    ids=len,
)
def test_what_is_packed_is_taken_apart_again(values: tuple[Any, ...]) -> None:
    packed = pack(values)
    unpack = unpacker(layout_of(values))
    result = njit(lambda everything: unpack(everything))(np.concatenate([packed, np.zeros(1)]))
    assert len(result) == len(values)
    for a, b in zip(result, values, strict=True):
        np.testing.assert_array_equal(a, b)
    if not any(layout_of(values)):
        assert packed.tolist() == list(values)


class Wave(sk.Potential):
    """A force between two springs: an array field and a number in compiled code."""

    kind = "wave"
    k: sk.NumberArray = Field(description="Spring constants.")
    t0: sk.TimeArray = Field(description="A time.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, k: Any, t0: Any) -> Any:
        return -k[0] * x, -k[1] * y, -(k[2] + t0[0] * t) * z


def test_arrays_reach_the_compiled_force_in_engine_units() -> None:
    wave = Wave(k=[1, 2, 3], t0=[0.5])
    result = build_field([NFW(mass=1e11, rs=10), wave]).acceleration(TIMES, PLACES)
    alone = build_field([NFW(mass=1e11, rs=10)]).acceleration(TIMES, PLACES)
    k = np.array([1, 2, 3])[:, None] + np.array([0, 0, 0.5 * sk.GYR])[:, None] * TIMES
    np.testing.assert_allclose(result - alone, -k * PLACES, rtol=1e-9, atol=1e-8)


class Table(sk.Potential):
    kind = "table"
    r: Annotated[sk.LengthArray, sk.Increasing()] = Field(description="Radii.")
    f: sk.NumberArray = Field(description="Forces.")
    size: Literal["small", "large"] = Field(default="small", description="How much.")
    factor: sk.Number = Field(default=1.0, description="Factor.")

    @staticmethod
    def prepare(r: Any, f: Any, size: str) -> dict[str, Any]:
        if f[0] < 0:
            raise sk.OutOfDomain("repulsive")
        return {"force": f * {"small": 1.0, "large": 10.0}[size]}

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, factor: Any, r: Any, force: Any) -> Any:
        d = sk.sqrt(x * x + y * y + z * z)
        k = -factor * sk.interp(d, r, force) / d
        return k * x, k * y, k * z


RADII, FORCES = np.geomspace(0.1, 200, 40), 1e3 / np.geomspace(0.1, 200, 40)


def test_a_compiled_force_gets_fields_and_what_is_prepared_of_them_by_name() -> None:
    table = Table(r=RADII, f=FORCES, size="large", factor=0.5)
    distance = np.sqrt((PLACES**2).sum(axis=0))
    wanted = -5.0 * np.interp(distance, RADII, FORCES) / distance * PLACES
    np.testing.assert_allclose(build_field([table]).acceleration(0.0, PLACES), wanted, rtol=1e-12)


def test_preparing_happens_once_per_instance(monkeypatch: pytest.MonkeyPatch) -> None:
    calls, prepare = [], Table.prepare
    monkeypatch.setattr(Table, "prepare", staticmethod(lambda r, f, size: [calls.append(1), prepare(r, f, size)][1]))
    table = Table(r=RADII, f=FORCES)
    first, *_ = (table.in_engine_units() for _ in range(3))
    assert len(calls) == 1
    again = pickle.loads(pickle.dumps(table))
    assert again == table
    other = table.model_copy(update={"f": 2 * FORCES})
    np.testing.assert_array_equal(other.in_engine_units()[2], 2 * first[2])
    np.testing.assert_array_equal(again.in_engine_units()[2], first[2])
    assert len(calls) == 3
    with pytest.raises(sk.OutOfDomain, match="repulsive"):
        Table(r=RADII, f=-FORCES).in_engine_units()


class Object(sk.Potential):
    """A spring through NumPy, with an object that was made of a word."""

    kind = "object"
    compiled = False
    word: str = Field(description="A word.")

    @staticmethod
    def prepare(word: str) -> dict[str, Any]:
        return {"spring": np.poly1d([0.0, float(len(word))])}

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, spring: Any) -> Any:
        return -spring(x) * x, -spring(y) * y, -spring(z) * z


def test_a_force_in_python_may_get_any_object() -> None:
    two = [Object(word="a"), Object(word="four")]
    np.testing.assert_allclose(build_field(two).acceleration(TIMES, PLACES), -5 * PLACES, rtol=1e-12)


def wrong(**changes: Any) -> type:
    """Make a potential with a mistake."""
    annotations = {"word": str} if "word" in changes else {}
    body = {"kind": "wrong", "__annotations__": annotations, "__module__": __name__, "__doc__": "Wrong."} | changes
    return type("Wrong", (sk.Potential,), body)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"word": "a", "acceleration": staticmethod(lambda x, y, z, t: (x, y, z))}, "word is not"),
        (
            {"word": "a", "prepare": staticmethod(lambda wort: {}), "acceleration": staticmethod(lambda x, y, z, t: x)},
            "found 'wort'. Did you mean 'word'",
        ),
        (
            {"word": "a", "prepare": staticmethod(lambda word: {}), "acceleration": staticmethod(lambda x, y, z: x)},
            "must have the same arguments: x, y, z, t",
        ),
    ],
)
def test_a_wrong_signature_is_told_where_the_class_is_written(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(sk.PluginError, match=said):
        wrong(**changes)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (lambda word: {"spin": 1.0}, "'spring' is no field, and `prepare` does not give it. Did you mean 'spin'"),
        (lambda word: 3.0, "expected a mapping or a named tuple"),
        (lambda word: {"spring": "a"}, "expected a number or an array"),
        (lambda word: {"spring": np.zeros((1, 1, 1, 1))}, "at most 3"),
    ],
)
def test_what_prepare_gives_is_checked(given: Any, said: str) -> None:
    def acceleration(x: Any, y: Any, z: Any, t: Any, spring: Any) -> Any:
        return x, y, z

    cls = wrong(word="a", prepare=staticmethod(given), acceleration=staticmethod(acceleration))
    with pytest.raises(sk.PluginError, match=said):
        cls().in_engine_units()


class Interpolated(sk.Potential):
    """The functions for tables, one per component of the force."""

    kind = "interpolated"
    xp: sk.NumberArray = Field(description="Places.")
    fp: sk.NumberArray = Field(description="Values.")
    pieces: sk.NumberTensor = Field(description="Cubics.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, xp: Any, fp: Any, pieces: Any) -> Any:
        return sk.interp(x, xp, fp), sk.interp(y, (-10.0, 10.0), fp), sk.cubic(z, (-10.0, 10.0), pieces)


@pytest.mark.parametrize("count", [2, 3, 8, 33])
def test_tables_in_compiled_code_are_those_of_numpy(count: int) -> None:
    """At random places, at the knots, beyond the ends, at infinity and for NaN."""
    fp, even = RNG.normal(size=count), np.linspace(-10, 10, count)
    xp = np.sort(RNG.normal(size=count)) * 8
    pieces = cubic_pieces(np.sin(even), np.cos(even) * (even[1] - even[0]))
    ends = [-1e300, 1e300, -np.inf, np.inf, -10.0, 10.0, np.nan, 0.0]
    x = np.concatenate([RNG.uniform(-15, 15, 500), xp, ends])
    y = np.concatenate([RNG.uniform(-15, 15, 500), even, ends])
    force = Interpolated(xp=xp, fp=fp, pieces=pieces)
    with np.errstate(invalid="ignore"):
        result = build_field([force]).acceleration(0.0, np.stack([x, y, y]))
        plain = force.acceleration(x, y, y, 0.0, *force.in_engine_units())
    np.testing.assert_allclose(result, plain, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(result[0], np.interp(x, xp, fp), rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(result[1], np.interp(y, even, fp), rtol=1e-12, atol=1e-13)
    inside = np.abs(y) <= 10
    assert np.abs(result[2][inside] - np.sin(y[inside])).max() < 1.01 * (20 / (count - 1)) ** 4 / 384


def test_cubic_pieces_go_through_values_and_slopes() -> None:
    y, d = RNG.normal(size=(2, 9))
    a, b, c, e = cubic_pieces(y, d).T
    np.testing.assert_allclose([a, b], [y[:-1], d[:-1]])
    np.testing.assert_allclose([a + b + c + e, b + 2 * c + 3 * e], [y[1:], d[1:]], atol=1e-14)
    assert cubic(0.5, (0.0, 1.0), [[1.0, 2.0, 4.0, 8.0]] @ np.eye(4)) == 4.0


GROWTH = {"t": [-4.0, -2.0, "-500 Myr", 0.0], "factor": [0.3, 0.5, 0.9, 1.0]}


@pytest.mark.parametrize("compiled", [pytest.param(True, marks=pytest.mark.slow), False])
def test_a_growing_halo_is_that_of_scipy(compiled: bool) -> None:
    """One orbit over 5 Gyr, beyond the first row of the table, and together with a bulge that stands still."""
    classes = (NFW, Hernquist) if compiled else (type("N", (sk.Spherical,), _copied(NFW)), Hernquist)
    halo = classes[0](mass=1e12, rs=16, growth=GROWTH)
    bulge = classes[1](mass=1e10, a=0.5)
    field = build_field([bulge, halo])
    q, v = np.array([20.0, 3.0, 10.0]), np.array([30.0, 150.0, 60.0])
    orbit = field.orbit(q, v, 0.0, -5 * sk.GYR, 1e-3)

    def motion(t: float, w: Any) -> Any:
        x, y, z = w[:3]
        f = np.interp(t / sk.GYR, [-4, -2, -0.5, 0], [0.3, 0.5, 0.9, 1.0])
        r = np.sqrt(x * x + y * y + z * z)
        a = -sk.G * (f * 1e12 * (np.log1p(r / 16) - r / (r + 16)) / r**3 + 1e10 / (r * (r + 0.5) ** 2)) * w[:3]
        return [*w[3:], *a]

    exact = solve_ivp(motion, (0, -5 * sk.GYR), [*q, *v], rtol=1e-11, atol=1e-11, max_step=0.05).y[:, -1]
    np.testing.assert_allclose([*orbit.q[:, 0], *orbit.v[:, 0]], exact, rtol=2e-6)


def _copied(cls: Any) -> dict[str, Any]:
    fields = {"__annotations__": {"mass": sk.Mass, "rs": sk.Length}, "__module__": __name__, "__doc__": "Plain."}
    return fields | {"kind": "plain", "compiled": False, "pull": staticmethod(cls.pull)}


def test_particles_of_many_times_feel_the_factor_of_their_own() -> None:
    still, growing = NFW(mass=1e12, rs=16), NFW(mass=1e12, rs=16, growth=GROWTH)
    result = build_field([growing]).acceleration(TIMES, PLACES) / build_field([still]).acceleration(TIMES, PLACES)
    wanted = np.interp(TIMES / sk.GYR, [-4, -2, -0.5, 0], [0.3, 0.5, 0.9, 1.0])
    np.testing.assert_allclose(result, [wanted] * 3, rtol=1e-12)
    q, v = PLACES[:, :5].copy(), np.zeros((3, 5))
    split_step(build_field([growing]), LEAPFROG, q, v, np.full(5, -1.0), -0.5, 50)
    assert np.isfinite(q).all()


@pytest.mark.parametrize(
    ("growth", "said"),
    [
        ({"t": [-2, 0], "factor": [0.5, 2]}, r"factor today \(t = 0\) is 2, expected 1"),
        ({"t": [-2, 0], "factor": [-0.5, 1]}, "found the factor -0.5"),
        ({"t": [0, -2], "factor": [1, 1]}, "larger than the one before"),
        ({"t": [0], "factor": [1]}, "at least 2"),
    ],
)
def test_a_growth_without_sense_is_told(growth: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        NFW(mass=1e12, rs=16, growth=growth)
