"""The target of a run: what it refuses, and what costs no call."""

import signal
from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest
from toys import Gaussian

import streamkit as sk
from streamkit.sample import PosteriorTarget, Stopped, Storage, Workers, run_sampler


class Wrong(sk.Sampler):
    """A sampler of weighted samples that does one thing wrong."""

    kind = "wrong"
    fault: str = "ensemble"

    def sample(self, target):
        points = np.zeros((4, target.size))
        if self.fault == "compare":
            target.compare(points, points, points, points)
        lnl = target.evaluate(points)
        if self.fault == "ensemble":
            yield sk.Ensemble(points, lnl, np.zeros(4, dtype=bool), None)
        yield sk.Samples(points, lnl)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("ensemble", "sampler wrong: yields Ensemble: a ChainSampler yields an Ensemble after each step"),
        ("compare", "is for samplers with `emulates = True`"),
    ],
)
def test_a_sampler_of_another_kind_than_its_samples_is_told_so(fault, words):
    toy = Gaussian()
    with Workers({"full": toy, "cheap": toy}) as calls:
        target = PosteriorTarget(toy.priors, toy.data, 1, calls, Storage())
        with pytest.raises(sk.ComponentError, match=words):
            deque(run_sampler(Wrong(fault=fault), target), maxlen=0)


def test_each_point_of_weighted_samples_is_evaluated_once():
    """Five rows at two places are two calls, and ln p is the closed form's at every row."""
    toy = Gaussian()
    points = np.repeat([[1.0, -2.0, 0.5], [0.0, 0.0, 0.0]], [3, 2], axis=0)
    with Workers({"full": toy, "cheap": toy}) as calls:
        target = PosteriorTarget(toy.priors, toy.data, 1, calls, Storage())
        found = target.evaluate(points)
        assert calls.calls["full"] == 2
    away = points - [1.0, -2.0, 0.5]
    np.testing.assert_allclose(found, -0.5 * np.einsum("ni,ij,nj->n", away, toy.inverse, away), rtol=1e-12)


def test_a_signal_ends_a_sampler_that_compares_predictions_between_two_calls():
    """A walk over an emulated posterior may take minutes without a call of the model."""
    toy, zero = Gaussian(), np.zeros((1, 3))
    comparison = SimpleNamespace(knows_shapes=True, ln_likelihood=lambda *_: np.zeros(1))
    with Workers({"full": toy, "cheap": toy}) as calls:
        target = PosteriorTarget(toy.priors, toy.data, 1, calls, Storage(), comparison=comparison)
        assert target.compare(zero, zero, zero, zero) == 0
        calls.stop = signal.SIGINT
        with pytest.raises(Stopped):
            target.compare(zero, zero, zero, zero)
