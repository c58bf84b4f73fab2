"""Works that several processes do at a time."""

from functools import partial

import pytest

from streamkit import StreamkitError
from streamkit.builtin.samplers.emulator.at_once import in_turn, side_by_side
from streamkit.sample.calls.forks import in_forks


def _collatz(n):
    """A work that takes as many tasks as the sequence of n has steps."""
    steps = 0
    while n != 1:
        n = yield partial(lambda n: n // 2 if n % 2 == 0 else 3 * n + 1, n)
        steps += 1
    return steps


@pytest.mark.parametrize("processes", [1, 2])
def test_works_of_any_length_end_in_their_order(processes):
    rounds = []

    def at_once(tasks):
        rounds.append(len(tasks))
        return in_forks(tasks, processes, lambda: None)

    # https://oeis.org/A006577
    assert side_by_side([_collatz(n) for n in (6, 1, 7, 3)], at_once) == [8, 0, 16, 7]
    assert rounds[:17] == [3] * 7 + [2] + [1] * 8 + [0]


def test_an_error_of_a_work_is_raised():
    def fails():
        yield lambda: 1
        raise StreamkitError("found no place to start")

    with pytest.raises(StreamkitError, match="found no place"):
        side_by_side([_collatz(7), fails()], in_turn)
