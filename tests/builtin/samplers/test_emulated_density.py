"""What the emulator samples: coordinates, slopes, and the search for what it misses."""

from dataclasses import replace

import numpy as np
import pytest
from emulated import OfToy, called
from known import KNOWN, OfKnown
from posteriors import Curved, Wavy
from scipy.stats import norm

from streamkit.builtin.samplers.emulator.judge.extrapolated import extrapolated
from streamkit.builtin.samplers.emulator.judge.recall import recall
from streamkit.builtin.samplers.emulator.known import Known
from streamkit.builtin.samplers.emulator.learn import from_calls
from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.learn.space import Space
from streamkit.builtin.samplers.emulator.walk.density import Emulated, Joint, one_factor
from streamkit.builtin.samplers.monomials import count, differentiated, monomials
from streamkit.runfile import LogUniform, Normal, Uniform


def test_slopes_are_those_of_the_likelihood():
    """By differences of ln L, for a polynomial and a Gaussian process."""
    for toy, count_, worth in ((Curved(), 400, np.inf), (Wavy(), 300, 0.0)):
        problem = OfToy(toy)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(from_calls, "WORTH", worth)
            emulated = Emulated(Space(problem), called(problem, count_).learn(), noise=False)
        z = np.random.default_rng(2).normal(scale=0.4, size=(50, problem.size))
        step = 1e-3 * np.eye(problem.size)

        def at(z, emulated=emulated):
            return emulated.ln_likelihood(z, fit_error=False)

        measured = np.stack([(at(z + each) - at(z - each)) / 2e-3 for each in step], axis=1)
        found = emulated.tangent(z, np.arange(problem.size)).force
        np.testing.assert_allclose(found, measured, rtol=0.02, atol=0.02 * np.abs(measured).max())


@pytest.mark.parametrize("noise", [False, True])
def test_the_own_error_adds_no_more_than_its_limit(noise):
    """Near all calls, where it is small, and far from them, where it is large; with noise of calls and without."""
    problem = OfToy(Curved(), noise=0.5)
    emulated = Emulated(Space(problem), called(problem, 120).learn(), noise)
    z = np.random.default_rng(2).normal(size=(400, problem.size)) * np.repeat([0.3, 2.0], 200)[:, None]
    without, whole = emulated.ln_likelihood(z, fit_error=False), emulated.unlimited().ln_likelihood(z)
    for most in (0.3, 1.0, 5.0):
        limited = Emulated(emulated.space, emulated.emulator, noise, most)
        np.testing.assert_allclose(limited.ln_likelihood(z), np.minimum(whole, without + most), rtol=1e-12)
    assert np.any(whole > without + 1.0)
    assert np.any(whole < without + 0.3)


def test_slopes_of_polynomials_are_polynomials():
    rng = np.random.default_rng(1)
    x = rng.normal(size=(5, 3))
    for degree in (0, 1, 2, 5):
        coefficients = rng.normal(size=(count(3, degree), 2))
        sides = [[monomials(x + sign * 1e-6 * each, degree) @ coefficients for sign in (1, -1)] for each in np.eye(3)]
        measured = np.stack([(after - before) / 2e-6 for after, before in sides], axis=1)
        slopes = np.einsum("nt,tik->nik", monomials(x, max(degree - 1, 0)), differentiated(coefficients, 3, degree))
        np.testing.assert_allclose(slopes, measured, atol=1e-6)


def test_the_coordinates_of_walkers_are_normal_in_the_prior():
    priors = (Uniform(2, 5), Normal(1.0, 0.3), LogUniform(0.1, 10.0))
    problem = OfToy(Curved())
    problem.priors = priors
    space, u = Space(problem), np.random.default_rng(1).random((200, 3))
    theta = problem.from_unit(u)
    np.testing.assert_allclose(space.normal(theta), norm.ppf(u), atol=2e-5)
    np.testing.assert_allclose(space.points(space.normal(theta)), theta, rtol=1e-12)
    np.testing.assert_array_equal(space.learned_of(theta)[:, 1], theta[:, 1])
    np.testing.assert_allclose(space.learned_of(theta)[:, 2], np.log(theta[:, 2]))


def test_calls_find_what_an_emulator_that_knows_one_side_misses(monkeypatch):
    """A linear emulator of calls at positive p0, of a posterior that has the same mass on both sides."""
    monkeypatch.setattr(from_calls, "DEGREES", (1,))
    monkeypatch.setattr(from_calls, "WORTH", np.inf)
    problem = OfToy(Symmetric())
    calls = called(problem, 200)
    one_side = calls.take(calls.theta[:, 0] > 0.3)
    emulated = Emulated(calls.space, one_side.learn(), noise=False)
    factor = one_factor(problem, problem)
    known, joint = Known(factor, one_side, emulated, [], 0.0), Joint([factor], [emulated])
    begin = np.random.default_rng(3).normal(size=(500, 3))
    found = recall([known], joint, begin, [1])
    assert found.share > 0.1
    assert found.calls == len(known.calls) - len(one_side) == 32
    assert found.found > 0.05
    assert "where only the emulator's own error" in found.fault


def test_calls_beyond_all_others_say_whether_the_posterior_goes_on_there():
    """A cubic of a normal number, b = 0.4 a^3 +- 0.4, called at |a| < 1.6: half of its variance is at |a| > 2.5."""
    whole = next(each for each in KNOWN if each.name == "cubic in 4")
    ends = replace(whole, exists=lambda a: np.abs(a[:, 0]) < 1.7)
    places = whole.exact(2000)
    near = places[np.abs(whole.apart(places)[0][:, 0]) < 1.6][:300]
    for known, goes_on in ((whole, True), (ends, False)):
        problem = OfKnown(known)
        calls = Calls.of(problem, Space(problem), near)
        emulated = Emulated(calls.space, calls.learn(), noise=False)
        factor = one_factor(problem, problem)
        each, joint = Known(factor, calls, emulated, [], 0.0), Joint([factor], [emulated])
        faults = extrapolated([each], joint, calls.z, [1])
        assert len(each.calls) == 332
        assert np.abs(known.apart(each.calls.theta[300:])[0][:, 0]).min() > 1.6
        assert len(faults) == goes_on
        assert all("goes on where no calls were" in fault for fault in faults)


class Symmetric(Curved):
    """The same at minus p0."""

    def mean(self, theta):
        x, y, z = theta
        return np.array([np.abs(x) + 0.5 * y**2, z - np.abs(x)])
