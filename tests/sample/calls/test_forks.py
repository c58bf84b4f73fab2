"""Tasks in forks of this process."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable

import numpy as np
import pytest

from streamkit.errors import StreamkitError
from streamkit.sample.calls.forks import in_forks


def _nothing() -> None:
    """Do nothing meanwhile."""


def _process() -> int:
    time.sleep(0.05)
    return os.getpid()


@pytest.mark.parametrize("processes", [1, 2, 3, 9])
def test_results_are_those_of_the_tasks_in_their_order(processes: int) -> None:
    held = np.random.default_rng(1).random((5, 4))
    found = in_forks([lambda i=i: held[i] ** i for i in range(5)], processes, _nothing)
    for i, result in enumerate(found):
        np.testing.assert_array_equal(result, held[i] ** i)


@pytest.mark.parametrize(("processes", "count", "used"), [(1, 3, 1), (2, 4, 2), (4, 2, 2), (3, 1, 1)])
def test_as_many_processes_work_as_there_are_tasks(processes: int, count: int, used: int) -> None:
    where = in_forks([_process] * count, processes, _nothing)
    assert len(set(where)) == used
    assert (os.getpid() in where) == (used == 1)
    for each in set(where) - {os.getpid()}:
        with pytest.raises(ProcessLookupError):  # it has ended
            os.kill(each, 0)


def test_a_fork_that_dies_is_replaced(tmp_path) -> None:
    def dies_once() -> int:
        mark = tmp_path / "died"
        if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return 7

    assert in_forks([dies_once, lambda: 8], 2, _nothing) == [7, 8]


def test_an_error_of_a_task_is_raised() -> None:
    def fails() -> None:
        raise StreamkitError("no place has a probability")

    with pytest.raises(StreamkitError, match="no place has a probability"):
        in_forks([_process, fails], 2, _nothing)


def test_what_is_raised_meanwhile_ends_the_forks(tmp_path) -> None:
    def long(mark: str) -> Callable[[], None]:
        def works() -> None:
            (tmp_path / mark).write_text(str(os.getpid()))
            time.sleep(60)

        return works

    def stopped() -> None:
        raise KeyboardInterrupt

    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        in_forks([long("one"), long("other")], 2, stopped)
    assert time.monotonic() - begun < 20
    for mark in ("one", "other"):
        with pytest.raises(ProcessLookupError):
            os.kill(int((tmp_path / mark).read_text()), 0)
