"""Every installed component passes the conformance kit, and the kit fails what is wrong."""

import numpy as np
import pytest
from pydantic import ConfigDict, Field

import streamkit as sk
from streamkit.components import load_registry
from streamkit.testing import check, checks
from streamkit.testing.common import example_of, title

COMPONENTS = [entry for kinds in load_registry().entries.values() for entry in kinds.values()]
LONG = {
    # tests/builtin/samplers has all of them.
    ("emulator", "repeats itself"), ("emulator", "samples a gaussian"),
    ("emcee", "repeats itself"), ("emcee", "samples a gaussian"), ("emcee", "resumes"),
    ("leapfrog", "reaches its order"),  # the other integrators do
    ("apocentres", "variance is that of the scatter"),  # the other observables do
}  # fmt: skip


def is_slow(entry, check):
    """Say whether a check takes seconds. Components of installed plugins are checked by their own tests, too."""
    return not entry.supplier.startswith("streamkit ") or (entry.cls.kind, title(check)) in LONG


CASES = [
    pytest.param(
        entry.cls, check, id=f"{entry.cls.role}-{entry.cls.kind}-{title(check)}",
        marks=pytest.mark.slow if is_slow(entry, check) else (),
    )
    for entry in COMPONENTS
    for check in checks(entry.cls, slow=entry.cls.kind == "dop853")
]  # fmt: skip


@pytest.mark.parametrize(("cls", "check"), CASES)
def test_conforms(cls, check):
    check(example_of(cls))


def report(cls, **options):
    """The lines of the report on a class that fails: check name -> message."""
    with pytest.raises(AssertionError) as caught:
        check(cls, **options)
    head, *lines = str(caught.value).split("\n  ")
    assert f"({cls.role} {cls.kind!r}) fails {len(lines)} of" in head
    return dict(line.split(": ", 1) for line in lines)


class Twisted(sk.Potential):
    kind = "Twisted"
    mass: sk.Mass = Field(default=1e9)

    @staticmethod
    def acceleration(x, y, z, t, mass):
        k = sk.G * mass / (1.0 + x * x + y * y + z * z)
        return k * x - k * y, k * y + k * x, k * z

    @staticmethod
    def potential(x, y, z, t, mass):
        return 0.0 * x


def test_a_twisted_repulsive_potential():
    assert set(report(Twisted)) == {
        "names itself", "fields are described", "is curl free", "energy matches force", "density is positive",
        "pulls inwards", "mass agrees with force",
    }  # fmt: skip
    assert "density is positive" not in report(Twisted, negative_density=True)


class Careless(sk.Potential):
    """Writes into its arguments, returns one array, thaws its fields and lets anything in."""

    model_config = ConfigDict(frozen=False, extra="ignore")
    kind = "careless"
    compiled = False
    mass: sk.Mass = Field(default=1e9, description="Mass.")

    @staticmethod
    def acceleration(x, y, z, t, mass):
        x += 1.0
        return -sk.G * mass / (x * y * z), -y, -z


def test_a_careless_potential():
    result = report(Careless)
    assert {"rejects unknown fields", "is frozen", "arrays in arrays out", "is finite"} <= set(result)
    assert result["arrays in arrays out"] == "acceleration changes the positions it is given"


def plain_helper(r2):
    return 1.0 / (r2 + 1.0)


class Uncompilable(sk.Potential):
    """Calls a function that is not compiled."""

    kind = "uncompilable"
    mass: sk.Mass = Field(default=1e9, description="Mass.")

    @staticmethod
    def acceleration(x, y, z, t, mass):
        k = -sk.G * mass * plain_helper(x * x + y * y + z * z)
        return k * x, k * y, k * z


def test_a_body_that_does_not_compile():
    result = report(Uncompilable)
    uncompiled = {"engine agrees with numpy", "engine adds", "prints nothing", "potential is fast"}
    assert set(result) == uncompiled | {"mass agrees with force"}
    assert "plain_helper" in result["engine adds"]
    assert "\n" not in result["engine adds"]


class Unwritten(sk.Potential):
    """Has no example for its field."""

    kind = "unwritten"
    mass: sk.Mass = Field(description="Mass.")

    @staticmethod
    def acceleration(x, y, z, t, mass):
        return -x * mass, -y * mass, -z * mass


def test_an_example_that_does_not_validate_is_the_first_thing_said():
    with pytest.raises(AssertionError, match=r"Unwritten\(\*\*Unwritten.example\) raised 1 validation error .*\nmass"):
        check(Unwritten)


class Dice(sk.Stripping):
    """Draws its own numbers, mixes the particles, swaps the tails and kicks along the x axis."""

    kind = "dice"
    draws = 1
    length: float = Field(default=1.0, description="A length.")

    def times(self, orbit):
        return super().times(orbit)[:-1]

    def release(self, orbit, tail, mass, normals):
        q = orbit.q - tail * orbit.r_tidal * orbit.frame[0] + normals.mean()
        v = orbit.v + np.random.default_rng().normal(size=orbit.v.shape)
        v[0] += 50.0
        return sk.Release(q, v)


def test_a_scheme_that_throws_dice():
    result = report(Dice)
    assert set(result) == {
        "fields are described", "releases as many as asked", "chance is an argument", "keeps no state",
        "tails lie on their sides", "turns with the orbit",
    }  # fmt: skip
    assert result["releases as many as asked"] == "2 particles asked for, times has shape (1,)"
    assert result["fields are described"].startswith("plain float: length")


class Euler(sk.Integrator):
    """First order, declared as second; forgets the particles' own times; steps depend on their number."""

    kind = "euler"
    order = 2
    step: sk.Duration = Field(default=0.001, description="Step.")

    def advance(self, field, q, v, t0, t1):
        if q.shape[1] == 0:
            return
        steps = int(np.ceil((t1 - t0[0]) / (self.step * sk.GYR))) + q.shape[1] % 7
        h = (t1 - t0[0]) / steps
        for i in range(steps):
            a = field.acceleration(t0[0] + i * h, q)
            q += h * v
            v += h * a


def test_an_integrator_of_lower_order_than_it_says():
    result = report(Euler)
    assert {"reaches its order", "takes any number", "takes releases off the grid"} <= set(result)
    assert float(result["reaches its order"].split("measured ")[1].split()[0]) == pytest.approx(1.0, abs=0.3)


class Coarse(sk.Integrator):
    """Takes one leapfrog step per block, however long."""

    kind = "coarse"
    order = 2

    def advance(self, field, q, v, t0, t1):
        h = t1 - t0
        q += 0.5 * h * v
        v += h * field.acceleration(t0 + 0.5 * h, q)
        q += 0.5 * h * v


def test_an_integrator_that_misses_its_accuracy():
    assert "fixed: relative error" in report(Coarse)["reaches its accuracy"]
    check(Coarse, accuracy=0.5)


class Hasty(sk.Observable):
    """Divides by what may be nothing, looks at the first particle and writes into the stream."""

    kind = "hasty"

    def predict(self, stream):
        mean = np.array([stream.r[0] + stream.r.sum() / len(stream), stream.r[stream.arm > 0].mean()])
        stream.chi[:] = 0.0
        return sk.Prediction(("first", "leading"), mean, np.array([-1.0, 0.0]))

    def data(self):
        return np.zeros(2), np.array([1.0, -1.0])

    def covariance(self):
        return np.array([[1.0, 2.0], [2.0, 1.0]])

    def quantities(self):
        return {"first": np.array([0])}

    def ln_likelihood(self, prediction, add_noise):
        return -np.inf


def test_an_observable_in_a_hurry():
    result = report(Hasty)
    assert set(result) == {
        "has a fixed length", "measures a stream", "does not care for the order", "leaves the stream alone",
        "says why not", "has a covariance of its data", "gives each datum one quantity", "has a likelihood",
        "keeps no state", "prints nothing", "variance is that of the scatter", "observable is fast",
    }  # fmt: skip
    assert "for a stream with no particles" in result["says why not"]


def test_only_components_can_be_checked():
    with pytest.raises(
        AssertionError, match="is no potential, stripping scheme, integrator, observable, host data or sampler"
    ):
        check(sk.Component)


def test_fields_of_a_potential_must_carry_units():
    with pytest.raises(sk.PluginError, match="every field of a potential must be a number with a unit"):

        class Bare(sk.Potential):
            """Nothing."""

            kind = "bare"
            width: float = 1.0

            @staticmethod
            def acceleration(x, y, z, t):
                return x, y, z
