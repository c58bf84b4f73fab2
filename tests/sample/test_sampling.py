"""A sampler with a fault: the error names the sampler, and the steps before the fault are kept."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from toys import Gaussian

from streamkit import ChainSampler, Ensemble, Evaluations, Sampler, Samples, Verdict
from streamkit.errors import ComponentError
from streamkit.sample import ChainMemory, PosteriorTarget, Stopped, Storage, Workers, run_sampler

GOOD = 3  # steps before the fault


def walk_with(fault):
    """Return a sampler of random walks whose fourth step is ``fault`` of the step."""

    class Walk(ChainSampler):
        """Random walks of 8 walkers."""

        kind = "walk"

        def walk(self, target, ensemble):
            """Move all walkers, each on its own."""
            random = ensemble.generator()
            points, lnp = ensemble.points.copy(), ensemble.ln_probability.copy()
            for number in range(GOOD + 2):
                new = points + 0.3 * random.standard_normal(points.shape)
                value = target.ln_prior(new) + target.evaluate(new)
                taken = np.log(random.random(len(points))) < value - lnp
                points[taken], lnp[taken] = new[taken], value[taken]
                step = Ensemble(points.copy(), lnp.copy(), taken, random.bit_generator.state)
                yield fault(step) if number == GOOD else step

    return Walk(walkers=8, steps=20)


def draws_with(fault):
    """Return a sampler of the prior whose second samples are ``fault`` of the first."""

    class Draws(Sampler):
        """Draws from the prior."""

        kind = "draws"

        def sample(self, target):
            """Yield the same samples twice."""
            points = target.from_unit(np.random.default_rng(target.seed).random((50, 3)))
            samples = Samples(points, target.evaluate(points))
            yield samples
            yield fault(samples)

    return Draws()


def error_of(sampler, error=ComponentError):
    """Run a sampler to its error; return the error, and how many results were kept."""
    toy, is_chain = Gaussian(), isinstance(sampler, ChainSampler)
    storage = Storage(chain=ChainMemory(), is_chain=is_chain)
    target = PosteriorTarget(toy.priors, toy.data, 5, Workers({"full": toy, "cheap": toy}), storage)
    kept = []
    with pytest.raises(error) as caught:
        kept.extend(run_sampler(sampler, target))
    return caught.value, storage.chain.iteration if is_chain else len(kept)


def wrong_ln_probability(step):
    """Return a step whose fifth walker has the ln p of another point."""
    lnp = step.ln_probability.copy()
    lnp[4] += 0.01
    return replace(step, ln_probability=lnp)


STEPS = {
    "exit": (lambda _: sys.exit(0), r"failed: SystemExit in .*: 0"),
    "division": (lambda _: 1 / 0, "failed: ZeroDivisionError in .*division by zero"),
    "none": (lambda _: None, "yields NoneType"),
    "samples": (lambda step: Samples(step.points, step.ln_probability), "yields Samples: a ChainSampler yields"),
    "shape": (lambda step: replace(step, points=step.points[:-1]), r"points of shape \(7, 3\), expected \(8, 3\)"),
    "no points": (lambda step: replace(step, points=None), "points: found the type object, expected floats"),
    "complex": (lambda step: replace(step, points=step.points + 0j), "found the type complex128, expected floats"),
    "text": (lambda step: replace(step, points="points"), "expected floats"),
    "elsewhere": (lambda step: replace(step, points=step.points + 1), "points that it never evaluated"),
    "ln p": (wrong_ln_probability, "of walker 4, expected ln prior"),
    "nan": (lambda step: replace(step, ln_probability=step.ln_probability * np.nan), "ln_probability nan of walker 0"),
    "ln p shape": (lambda step: replace(step, ln_probability=step.ln_probability[1:]), r"shape \(7,\), expected"),
    "no ln p": (lambda step: replace(step, ln_probability=None), "ln_probability: found the type object"),
    "accepted": (lambda step: replace(step, accepted=None), "accepted"),
    "state": (lambda step: replace(step, random_state=None), "random_state is neither"),
    "facts": (lambda step: replace(step, facts={"moves": 3}), "facts.*found 3"),
    "no facts": (lambda step: replace(step, facts=["a"]), "facts"),
    "memory": (lambda step: replace(step, memory={"a": np.ones(2) + 1j}), "memory 'a': found the type complex128"),
}


@pytest.mark.parametrize("name", STEPS)
def test_a_step_with_a_fault_names_the_sampler_and_keeps_the_steps_before(name):
    fault, told = STEPS[name]
    error, kept = error_of(walk_with(fault))
    assert re.search(f"^sampler walk.*{told}", str(error))
    assert kept == GOOD


def test_a_walk_that_ends_by_itself_is_an_error():
    error, kept = error_of(walk_with(lambda step: step))
    assert "sampler walk: walk ended after 5 steps" in str(error)
    assert kept == 5


def evaluations(samples, **changes):
    """Return samples with evaluations of their own, whose ln p is that of the prior, some of them changed."""
    n = len(samples.points)
    ln_prior = sum(prior.lnpdf_of_many(x) for prior, x in zip(Gaussian().priors, samples.points.T, strict=True))
    fields = {"ln_probability": ln_prior, "ln_likelihood": np.zeros(n), "mean": np.zeros((n, 2))}
    fields |= {"variance": np.zeros((n, 2)), "reasons": ("",) * n}
    return replace(samples, evaluations=Evaluations(**fields | changes))


SAMPLES = {
    "exit": (lambda _: sys.exit(0), "failed: SystemExit"),
    "none": (lambda _: None, "yields NoneType"),
    "no points": (lambda samples: replace(samples, points=None), "points: found the type object"),
    "complex": (lambda samples: replace(samples, ln_weights=samples.ln_weights + 0j), "ln_weights: .*complex128"),
    "a number": (lambda samples: replace(samples, ln_weights=0.0), r"weights of shape \(\)"),
    "verdict": (lambda samples: replace(samples, verdicts=({"level": "fine"},)), "samples cannot be stored: asdict"),
    "level": (lambda samples: replace(samples, verdicts=(Verdict("a", "good", "1", "b", "c"),)), "level.*'good'"),
    "facts": (lambda samples: replace(samples, facts={"calls": 3}), "facts.*found 3"),
    "missing": (lambda samples: replace(samples, missing=None), "missing"),
    "evidence": (lambda samples: replace(samples, ln_evidence="much"), "ln_evidence"),
    "evaluations": (lambda samples: evaluations(samples, mean=np.zeros((9, 2))), "cannot be stored: boolean index"),
    "variance": (lambda samples: evaluations(samples, variance=-np.ones((50, 2))), "negative variance"),
    "ln p": (lambda samples: evaluations(samples, ln_probability=np.full(50, np.nan)), "NaN"),
}


@pytest.mark.parametrize("name", SAMPLES)
def test_samples_with_a_fault_name_the_sampler_and_keep_the_samples_before(name):
    fault, told = SAMPLES[name]
    error, kept = error_of(draws_with(fault))
    assert re.search(f"^sampler draws.*{told}", str(error))
    assert kept == 1


def test_a_signal_is_no_fault_of_the_sampler():
    def stop(_):
        raise Stopped(2)

    _, kept = error_of(walk_with(stop), Stopped)
    assert kept == GOOD


def test_numbers_of_other_types_are_converted():
    """The steps are those of the walk with 64-bit floats: a sum of integers is exact."""

    def whole(step):
        return replace(step, accepted=step.accepted.astype(int), memory={"steps": np.array([4])}, facts={})

    _, kept = error_of(walk_with(whole))  # the walk ends after its fifth step
    assert kept == 5
