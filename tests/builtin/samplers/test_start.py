"""The start of the sampler `emulator`: from draws of the prior, of which few may have a prediction."""

import numpy as np
from emulated import OfToy
from posteriors import Curved

from streamkit.builtin.samplers.emulator.at_once import in_turn, side_by_side
from streamkit.builtin.samplers.emulator.learn.of_target import LikelihoodOnly
from streamkit.builtin.samplers.emulator.start import Starter
from streamkit.builtin.samplers.emulator.walk.density import one_factor


class Narrow(OfToy):
    """It has predictions in one part of 750 of the prior."""

    def evaluate(self, points):
        found, gone = super().evaluate(points), (np.abs(points - [0.3, 0.5, 1.0]) > 0.33).any(axis=1)
        return found._replace(ln_likelihood=np.where(gone, -np.inf, found.ln_likelihood))


def test_a_start_is_found_between_the_few_draws_that_have_predictions():
    """The draws that have one are too few to learn from, and draws of the prior alone would add one in 750."""
    factor = one_factor(LikelihoodOnly(Narrow(Curved())), LikelihoodOnly(Narrow(Curved(), 60)))
    (start,) = side_by_side([Starter(False, lambda _: None).one(factor, 0)], in_turn)
    first = start.calls.take(np.arange(len(start.calls)) < start.draws)
    assert 3 <= first.good.sum() < 10  # of 2048
    assert start.calls.good.sum() > 40
    centre = start.calls.space.points(start.places).mean(axis=0)
    np.testing.assert_allclose(centre, [0.3, 0.5, 1.0], atol=0.3)
