"""Worker processes that are killed at any time: nothing hangs, no call is lost, no answer changes."""

import json
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress

import numpy as np
import pytest
import threadpoolctl
from toys import Gaussian, Slow, walk

import streamkit as sk
from streamkit.sample import CallTimeout, ChainFile, ChainMemory, Processes, WorkerDied, Workers, one_thread
from streamkit.sample.calls.processes import TRIES
from streamkit.sample.calls.serving import pool
from streamkit.sample.calls.workers import OVERTIME


def square(x):
    return x * x


def die(_):
    os.kill(os.getpid(), signal.SIGKILL)


def leave_a_thread(x):
    threading.Thread(target=time.sleep, args=(1000,)).start()
    return x


def close_everything(_):
    os.closerange(3, 100)


def interrupt(_):
    raise KeyboardInterrupt


class UnpicklableError(Exception):
    def __init__(self, one, two):
        super().__init__(f"{one} and {two}")


def fail(_):
    raise UnpicklableError(1, 2)


@pytest.fixture
def executor():
    with Processes(2) as executor:
        yield executor


def test_calls_are_made_in_any_number_and_order(executor):
    assert list(executor.map(square, range(100))) == [x * x for x in range(100)]
    futures = [executor.submit(square, x) for x in range(10)]
    assert [future.result() for future in reversed(futures)] == [x * x for x in reversed(range(10))]


def blas_threads(_=None):
    return max(each["num_threads"] for each in threadpoolctl.threadpool_info() if each["user_api"] == "blas")


def test_linear_algebra_has_one_thread_in_a_worker_and_in_a_run(executor):
    """A product's last bits depend on the number of threads: those of a plugin in NumPy are the same on all engines."""
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        assert list(executor.map(blas_threads, range(2))) == [1, 1]
        with Processes(1) as later:
            assert later.submit(blas_threads).result() == 1
        before = blas_threads()
        with one_thread():
            assert blas_threads() == 1
        assert blas_threads() == before


def test_a_limit_holds_in_scipy_too_and_on_a_machine_that_asks_for_four_threads():
    """SciPy has linear algebra of its own, which is loaded with its first use."""
    script = (
        "from streamkit.sample import one_thread\none_thread()\nimport threadpoolctl, scipy.linalg\n"
        "print([x['num_threads'] for x in threadpoolctl.threadpool_info() if x['user_api'] == 'blas'])"
    )
    many = os.environ | {"OPENBLAS_NUM_THREADS": "4", "OMP_NUM_THREADS": "4", "MKL_NUM_THREADS": "4"}
    done = subprocess.run([sys.executable, "-c", script], env=many, capture_output=True, text=True, check=True)
    assert set(json.loads(done.stdout)) == {1}


@pytest.mark.parametrize("count", [12, pytest.param(50, marks=pytest.mark.slow)])
def test_kills_at_random_moments_change_nothing(caplog, tmp_path, count):
    """A thread kills workers, idle or busy, while a chain is made: it is that of one process."""
    caplog.set_level(logging.CRITICAL, "streamkit")
    chain, kills, rng, over = ChainFile(tmp_path / "chain.h5"), [], np.random.default_rng(5), threading.Event()
    with Workers({"full": Gaussian(), "cheap": Gaussian()}, 3) as pool:

        def kill():
            while len(kills) < count and not over.is_set():
                time.sleep(rng.uniform(0.0, 0.06))
                with suppress(ProcessLookupError):  # it is just being replaced
                    os.kill(rng.choice(pool._executor._workers).process.pid, signal.SIGKILL)
                    kills.append(1)

        walk(Gaussian(), pool, chain, steps=1)
        killer = threading.Thread(target=kill)
        killer.start()
        try:
            while killer.is_alive():
                walk(Gaussian(), pool, chain, steps=chain.iteration + 10)
        finally:
            over.set()
    alone = ChainMemory()
    with Workers({"full": Gaussian(), "cheap": Gaussian()}) as pool:
        walk(Gaussian(), pool, alone, steps=chain.iteration)
    assert len(kills) == count
    np.testing.assert_array_equal(alone.samples(), chain.samples())


def test_a_call_that_kills_every_worker_is_given_up_and_others_are_not(executor, caplog):
    futures = [executor.submit(die if x == 2 else square, x) for x in range(6)]
    with pytest.raises(WorkerDied, match="died again and again in the same call"):
        futures[2].result()
    assert [future.result() for i, future in enumerate(futures) if i != 2] == [0, 1, 9, 16, 25]
    assert len(caplog.records) == TRIES
    assert "signal 9" in caplog.text


def test_a_call_that_never_ends_is_ended(caplog):
    with Processes(2, limit=0.5) as executor:
        futures = [executor.submit(time.sleep, 1000), executor.submit(square, 3), executor.submit(square, 4)]
        begin = time.monotonic()
        with pytest.raises(CallTimeout, match=r"longer than 0\.5 s"):
            futures[0].result()
        assert time.monotonic() - begin < 5
        assert [future.result() for future in futures[1:]] == [9, 16]
    assert not caplog.records


@pytest.mark.parametrize(("count", "seconds"), [(1, 1000), (2, 1000)])
def test_a_call_over_its_limit_is_rejected_or_stops_the_run(count, seconds):
    points = np.random.default_rng(0).standard_normal((30, 3))
    slow = (np.abs(points[:, 0]) * 1e6).astype(int) % 10 == 0
    assert slow.any()
    assert not slow.all()
    limit = 0.5 if count == 1 else 0.2
    with Workers({"full": Slow(seconds)}, count, limit=limit, reject=True) as pool:
        outcome = pool.evaluate(points)
        assert [result.reason == OVERTIME for result in outcome] == slow.tolist()
        assert pool.reasons["full"] == {OVERTIME: slow.sum()}
    with (
        Workers({"full": Slow(seconds)}, count, limit=limit) as pool,
        pytest.raises(CallTimeout, match=r"sampler\.call_limit = 0\..* s, at the parameters"),
    ):
        pool.evaluate(points)


def test_what_a_plugin_does_to_its_process_hurts_nobody_else(executor):
    assert [executor.submit(leave_a_thread, x).result() for x in range(3)] == [0, 1, 2]
    with pytest.raises(WorkerDied):
        executor.submit(close_everything, 1).result()
    with pytest.raises(sk.StreamkitError, match="raised KeyboardInterrupt"):
        executor.submit(interrupt, 1).result()
    with pytest.raises(sk.StreamkitError, match="UnpicklableError: 1 and 2"):
        executor.submit(fail, 1).result()
    assert executor.submit(square, 5).result() == 25
    begin = time.monotonic()
    executor.shutdown()
    assert time.monotonic() - begin < 5  # the thread would sleep for 1000 s


def test_a_result_is_waited_for_no_longer_than_asked(executor):
    future = executor.submit(time.sleep, 1000)
    with pytest.raises(TimeoutError):
        future.result(0.2)
    executor.shutdown(cancel_futures=True)
    with pytest.raises(RuntimeError, match="shut down"):
        executor.submit(square, 1)


FORGETFUL = """
import os, time
from streamkit.sample import Processes
executor = Processes(2)
executor.submit(time.sleep, 1000)
print(*(worker.process.pid for worker in executor._workers))
"""


def test_workers_that_were_forgotten_end_with_their_parent():
    result = subprocess.run([sys.executable, "-c", FORGETFUL], capture_output=True, text=True, timeout=60, check=True)
    for pid in map(int, result.stdout.split()):
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_far_more_processes_than_processors_are_refused():
    with pytest.raises(sk.StreamkitError, match=r"workers: found 100000, expected at most \d+ on this machine"):
        pool(100_000)
