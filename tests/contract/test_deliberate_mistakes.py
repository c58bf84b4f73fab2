"""Mistakes that authors make, each caught by the check that is named, with what to do about it."""

import faulthandler
import os
import re
import time

import numpy as np
import pytest
from pydantic import Field

import streamkit as sk
from streamkit.testing import check, checks, common, contained, quick_failures
from streamkit.testing.common import failures


def told(cls, name):
    """Return what the check called ``name`` says of the example of a class."""
    (one,) = [one for one in checks(cls) if common.title(one) == name]
    lines = failures(cls(**cls.example), [one])
    return lines[0].removeprefix(f"{name}: ") if lines else ""


def plummer(factor=1.0, length=1.0, run=lambda x: None, centre=0.0):
    """A Plummer sphere of 1e12 Msun and 20 kpc with something wrong."""

    class Sphere(sk.Potential):
        """A Plummer sphere."""

        kind = "sphere"
        compiled = False
        example = {"mass": 1e12, "a": 20.0}
        mass: sk.Mass = Field(description="Total mass.")
        a: sk.Length = Field(description="Scale radius.")

        @staticmethod
        def acceleration(x, y, z, t, mass, a):
            run(x)
            d2 = (x * x + y * y + z * z) * length**2 + a * a
            k = -sk.G * mass * factor / d2**1.5
            if centre:
                k = k + centre / (x * x + y * y + z * z)
            return k * x * length, k * y * length, k * z * length

    return Sphere


def test_one_without_a_mistake_passes():
    with pytest.raises(
        AssertionError, match=r"fails 1 of .* checks:\n  survives pickle: .*local object"
    ):  # it is local
        check(plummer())
    assert quick_failures(plummer()(mass=1e12, a=20.0)) == []


@pytest.mark.parametrize(
    ("factor", "length", "why"),
    [
        (1.022712165**2, 1.0, r"kpc/Gyr\^2"),
        (1.022712165e-3, 1.0, "km/s/Myr"),
        (1e-3, 1.0, "parsec"),
        (1.0, 1e3, "positions are read as parsec"),
        (4 * np.pi, 1.0, "4 pi"),
        (1e4, 1.0, "If mass is no total mass"),
    ],
)
def test_a_force_in_other_units(factor, length, why):
    result = told(plummer(factor, length), "mass agrees with force")
    assert "the force must be in (km/s)^2/kpc" in result
    assert re.search(why, result), result


def test_a_repulsive_force():
    assert "its sign is wrong" in told(plummer(-1.0), "pulls inwards")
    assert any("its sign is wrong" in line for line in quick_failures(plummer(-1.0)(mass=1e12, a=20.0)))


def test_no_number_at_the_centre():
    with np.errstate(all="ignore"):
        assert "falls to zero towards r = 0, and is [nan nan nan]" in told(
            plummer(centre=1e-300), "is finite at the centre"
        )


def test_chance_state_and_an_in_place_change():
    rng = np.random.default_rng(1)
    calls = []

    def noise(x):
        x *= 1 + 1e-9 * rng.standard_normal()

    def change(x):
        x += 1.0

    class Counting(sk.Potential):
        """A force that grows at every call."""

        kind = "counting"
        compiled = False
        mass: sk.Mass = Field(default=1e12, description="Mass.")

        @staticmethod
        def acceleration(x, y, z, t, mass):
            calls.append(1)
            k = -sk.G * mass * (1 + 1e-6 * len(calls)) / (400.0 + x * x + y * y + z * z) ** 1.5
            return k * x, k * y, k * z

    for cls in (plummer(run=noise), Counting):
        assert "something else the second time: draw no random numbers" in told(cls, "keeps no state")
        assert any(line.startswith("keeps no state") for line in quick_failures(cls(**cls.example)))
    assert "changes the positions" in told(plummer(run=change), "arrays in arrays out")
    assert any("changes the positions" in line for line in quick_failures(plummer(run=change)(mass=1e12, a=20.0)))


def test_printing():
    assert "prints 'here'" in told(plummer(run=lambda x: print("here")), "prints nothing")
    assert "prints 'there'" in told(plummer(run=lambda x: os.write(1, b"there")), "prints nothing")


def test_a_force_that_takes_a_month():
    result = told(plummer(run=lambda x: time.sleep(2e-3)), "potential is fast")
    assert "a fit of 160000 streams would take" in result
    days = float(result.split("would take ")[1].split()[0])
    assert days == pytest.approx(28_000 * 2e-3 * 160_000 / 86400, rel=0.3)  # 28 000 calls of 2 ms


@pytest.mark.parametrize("end", [os.abort, lambda: os._exit(3)])
def test_a_crash_of_the_interpreter(end):
    here = os.getpid()

    def crash(x):
        if os.getpid() != here:
            faulthandler.disable()  # of pytest's
            end()

    with pytest.raises(AssertionError, match=r"survives: the (interpreter crashed \(SIGABRT\)|process .* status 3)"):
        check(plummer(run=crash))


def test_a_loop_without_an_end():
    assert "is there a loop that does not end?" in contained.in_a_process(lambda: time.sleep(60), limit=0.2)[0]


def scaled(kinds):
    """A halo whose scale radius a, and whose rate of growth, are declared as ``kinds``."""

    class Growing(sk.Potential):
        """A growing Plummer sphere."""

        kind = "growing"
        example = {"mass": 1e12, "a": 20.0, "rate": 0.1}
        mass: sk.Mass = Field(description="Total mass.")
        a: kinds[0] = Field(description="Scale radius.")
        rate: kinds[1] = Field(description="Growth.")

        @staticmethod
        def acceleration(x, y, z, t, mass, a, rate):
            k = -sk.G * mass * (1.0 + rate * t) / (x * x + y * y + z * z + a * a) ** 1.5
            return k * x, k * y, k * z

    return Growing


def test_a_dimensional_field_that_is_declared_as_a_plain_number():
    """Of two such fields neither can be told alone."""

    class Halo(sk.Potential):
        """A Plummer sphere with a scale radius that is no length."""

        kind = "numbered"
        example = {"mass": 1e12, "a": 20.0}
        mass: sk.Mass = Field(description="Total mass.")
        a: sk.PositiveNumber = Field(description="Scale radius.")

        @staticmethod
        def acceleration(x, y, z, t, mass, a):
            k = -sk.G * mass / (x * x + y * y + z * z + a * a) ** 1.5
            return k * x, k * y, k * z

    assert "the force scales as if it were a length in kpc (Length)" in told(Halo, "has dimensions")
    assert "one over a time (declare the time" in told(scaled((sk.Length, sk.Number)), "has dimensions")
    assert told(plummer(), "has dimensions") == ""


def test_a_time_that_is_converted_twice():
    class Swinging(sk.Potential):
        """Takes t to Gyr, and its period not."""

        kind = "swinging"
        example = {"mass": 1e12, "period": 1.0}
        mass: sk.Mass = Field(description="Total mass.")
        period: sk.Duration = Field(description="Period.")

        @staticmethod
        def acceleration(x, y, z, t, mass, period):
            k = (
                -sk.G
                * mass
                * (1 + 0.1 * np.sin(2 * np.pi * t / sk.GYR / period))
                / (400 + x * x + y * y + z * z) ** 1.5
            )
            return k * x, k * y, k * z

    assert "t and period arrive in kpc/(km/s) alike" in told(Swinging, "time is not converted twice")


def scheme(asked, used):
    class Kicked(sk.Stripping):
        """Kicked along the line to the centre."""

        kind = "kicked"
        draws = asked

        def release(self, orbit, tail, mass, normals):
            outwards = orbit.frame[0]
            kick = sum(normals[i] for i in range(used))
            return sk.Release(orbit.q + tail * orbit.r_tidal * outwards, orbit.v + 5 * kick * outwards)

    return Kicked


def test_draws_too_many_and_too_few():
    assert told(scheme(2, 2), "uses its draws") == ""
    assert told(scheme(3, 2), "uses its draws") == "normals[2] changes nothing: draws is 3, declare as many as are used"
    assert "out of bounds for axis 0 with size 1, with draws = 1: declare as many" in told(
        scheme(1, 2), "uses its draws"
    )
    assert any("normals[2]" in line for line in quick_failures(scheme(3, 2)()))


def observable(factor):
    class Mean(sk.Observable):
        """Mean distance."""

        kind = "mean_distance"

        def data(self):
            return np.array([30.0]), np.array([1.0])

        def predict(self, stream):
            r = stream.r[~stream.bound]
            if len(r) < 10:
                return sk.Prediction(("r",), np.full(1, np.nan), np.full(1, np.nan), why_not="too few particles")
            return sk.Prediction(("r",), np.array([r.mean()]), np.array([factor * r.var() / len(r)]))

    return Mean


@pytest.mark.parametrize(("factor", "fine"), [(1.0, True), (0.0, False), (100.0, False), (0.01, False)])
def test_a_variance_that_is_not_that_of_the_scatter(factor, fine):
    result = told(observable(factor), "variance is that of the scatter")
    assert (result == "") == fine, result
    assert fine or "sum(w^2 (x - mean)^2)" in result


def walker(reason="", twice=1.0, settings=None, forgets=False):
    """Independent random walks, with something wrong."""

    class Walks(sk.ChainSampler):
        """Random walks."""

        kind = "walks"
        example = {"walkers": 8, "steps": 200}

        def reject_dimension(self, d):
            return reason

        def quick_settings(self, d):
            return settings or {}

        def walk(self, target, ensemble):
            random = np.random.default_rng(target.seed) if forgets else ensemble.generator()
            points, lnp = ensemble.points.copy(), ensemble.ln_probability.copy()
            while True:
                new = points + 0.5 * random.standard_normal(points.shape)
                value = target.ln_prior(new) + target.evaluate(new)
                taken = np.log(random.random(len(points))) < value - lnp
                points[taken], lnp[taken] = new[taken], value[taken]
                yield sk.Ensemble(points.copy(), twice * lnp, taken, random.bit_generator.state)

    return Walks


def test_return_types_of_a_samplers_optional_methods():
    assert not told(walker(), "returns what it says")
    assert "reject_dimension returns None" in told(walker(reason=None), "returns what it says")
    assert "walkres" in told(walker(settings={"walkres": 3}), "returns what it says")


def test_a_chain_by_its_files():
    """A generator that begins anew resumes with the random numbers of the start."""
    assert not told(walker(), "survives its files")
    assert "resumed from its files has other steps" in told(walker(forgets=True), "survives its files")
    assert "expected ln prior + ln likelihood" in told(walker(twice=2.0), "survives its files")
