"""Functions that several processes evaluate at a time."""

from __future__ import annotations

import os
import signal
import time

import numpy as np
import pytest

from streamkit.errors import StreamkitError
from streamkit.sample.calls.spread import Spread

FUNCTIONS = [lambda x, power=power: x**power for power in range(1, 6)]


def _process(x: np.ndarray) -> np.ndarray:
    time.sleep(0.02)
    return np.full(len(x), float(os.getpid()))


@pytest.mark.parametrize("processes", [1, 2, 3, 9])
def test_results_are_those_of_the_functions_in_their_order(processes: int) -> None:
    spread = Spread(FUNCTIONS, processes)
    for seed in range(3):
        parts = [np.random.default_rng([seed, i]).random(4) for i in range(5)]
        for function, part, result in zip(FUNCTIONS, parts, spread(parts), strict=True):
            np.testing.assert_array_equal(result, function(part))


def test_each_process_does_a_part_of_the_work() -> None:
    spread = Spread([_process] * 4, 2)
    assert {float(each[0]) for each in spread([np.zeros(1)] * 4)} == {os.getpid()}  # the first is measured here
    where = [float(each[0]) for each in spread([np.zeros(1)] * 4)]
    assert where.count(os.getpid()) == 2
    assert len(set(where)) == 2


def test_a_fork_that_dies_is_replaced() -> None:
    spread = Spread([_process] * 2, 2)
    spread([np.zeros(1)] * 2)
    other = next(pid for each in spread([np.zeros(1)] * 2) if (pid := int(each[0])) != os.getpid())
    os.kill(other, signal.SIGKILL)
    after = {int(each[0]) for each in spread([np.zeros(1)] * 2)}
    assert os.getpid() in after
    assert other not in after
    assert len(after) == 2


def test_an_error_of_a_function_is_raised() -> None:
    def fails(x: np.ndarray) -> np.ndarray:
        if x[0] > 0:
            raise StreamkitError("no prediction")
        return x

    spread = Spread([fails, fails], 2)
    spread([np.zeros(1)] * 2)
    with pytest.raises(StreamkitError, match="no prediction"):
        spread([np.zeros(1), np.ones(1)])


def test_forks_end_with_the_object() -> None:
    spread = Spread([_process] * 2, 2)
    spread([np.zeros(1)] * 2)
    other = next(pid for each in spread([np.zeros(1)] * 2) if (pid := int(each[0])) != os.getpid())
    del spread
    with pytest.raises(ProcessLookupError):
        os.kill(other, 0)


def test_a_process_that_is_busy_between_evaluations_gives_its_share_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("streamkit.sample.calls.spread.MEASURED", 3)
    spread = Spread([_process] * 4, 2)
    for _ in range(4):
        time.sleep(0.1)  # what another process could evaluate all of them in
        found = spread([np.zeros(1)] * 4)
    assert os.getpid() not in {int(each[0]) for each in found}
    idle = Spread([_process] * 4, 2)
    shares = [[int(each[0]) for each in idle([np.zeros(1)] * 4)] for _ in range(5)][-1]
    assert shares.count(os.getpid()) == 2
