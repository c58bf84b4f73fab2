"""What the studies over a grid share: jobs that are interrupted safely, and files of which one that fails costs one."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from astropy.table import QTable
from matplotlib.figure import Figure
from runfiles import RUN

import streamkit as sk
from streamkit.errors import Interrupted, StreamkitError
from streamkit.study.grid import (
    DIED,
    Products,
    draw_pictures,
    ended_before,
    exit_status,
    run_jobs,
    write_tables,
)

JOBS = {"a": 1, "b": 2, "c": 3}


def square(n: int) -> int:
    return n * n


def die_at_three(n: int) -> int:
    if n == 3:
        os._exit(1)
    return n * n


def signal_at_two(signum: int, n: int) -> int:
    if n == 2:
        os.kill(os.getpid(), signum)
    return n * n


def signal_in_a_fit_at_two(signum: int, n: int) -> int:
    if n == 2:
        raise Interrupted("stopped after 0 steps, which are not saved", signum)
    return n * n


def fail_at_two(n: int) -> int:
    if n == 2:
        raise ValueError("two")
    return n * n


@pytest.mark.parametrize("workers", [1, 2])
def test_every_job_is_done_wherever(workers: int) -> None:
    calls: list[int] = []
    found = run_jobs(square, JOBS, workers, lambda: calls.append(1))
    assert found == ({"a": 1, "b": 4, "c": 9}, "")
    assert len(calls) == 3


def test_an_end_before_a_result_is_an_interruption_only_after_a_signal() -> None:
    stopped, died = (ended_before("a.toml", why, "the first draw was finished") for why in ("interrupted", DIED))
    assert str(stopped) == "a.toml: interrupted before the first draw was finished"
    assert isinstance(stopped, Interrupted)
    assert stopped.exit_status == 130
    assert not isinstance(died, Interrupted)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("work", [signal_at_two, signal_in_a_fit_at_two])
@pytest.mark.parametrize(
    ("signum", "reason", "status"), [(signal.SIGINT, "interrupted", 130), (signal.SIGTERM, "terminated", 143)]
)
def test_a_signal_keeps_what_is_finished_and_leaves_signals_as_they_were(
    work: Callable[[int, int], int], signum: int, reason: str, status: int
) -> None:
    before = signal.getsignal(signal.SIGTERM)
    assert run_jobs(partial(work, signum), JOBS) == ({"a": 1}, reason)
    assert exit_status(reason) == status
    assert signal.getsignal(signal.SIGTERM) is before


def test_an_interruption_of_the_parent_keeps_what_its_workers_have_finished() -> None:
    calls: list[int] = []

    def done() -> None:
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt

    found, stopped = run_jobs(square, JOBS, 2, done)
    assert stopped == "interrupted"
    assert len(found) == 2
    assert all(found[key] == JOBS[key] ** 2 for key in found)


def test_a_worker_that_dies_keeps_what_is_finished() -> None:
    found, stopped = run_jobs(die_at_three, {"first": 1} | {str(n): 3 for n in range(4)}, 2)
    assert stopped == DIED
    assert found in ({}, {"first": 1})  # whichever of the two was faster


@pytest.mark.parametrize("workers", [1, 2])
def test_what_the_work_raises_comes_through(workers: int) -> None:
    with pytest.raises(ValueError, match="two"):
        run_jobs(fail_at_two, JOBS, workers)


@pytest.fixture
def products(tmp_path: Path) -> Products:
    (tmp_path / "small.toml").write_text(RUN)

    def broken() -> Figure:
        raise ValueError("shapes (3,500) and (3,3000)")

    return Products(
        sk.load(tmp_path / "small.toml"), "whole.toml", "text", {"t.ecsv": QTable({"x": [1.0]})},
        {"one.png": Figure, "two.png": broken, "three.pdf": Figure}, {"seeds": 3},
    )  # fmt: skip


def test_a_picture_that_fails_does_not_cost_the_others(products: Products, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "two.png").write_text("of an earlier study")
    assert draw_pictures(products, out) == "two.png (ValueError: shapes (3,500) and (3,3000))"
    assert sorted(path.name for path in out.iterdir()) == ["one.png", "three.pdf"]


def test_a_disk_that_cannot_be_written_is_an_error_all_the_same(products: Products, tmp_path: Path) -> None:
    with pytest.raises(StreamkitError, match="cannot be written"):
        draw_pictures(products, tmp_path / "none")


def test_tables_say_where_they_come_from(products: Products, tmp_path: Path) -> None:
    write_tables(products, tmp_path)
    meta = QTable.read(tmp_path / "t.ecsv").meta
    assert (meta["run_file"], meta["seed"], meta["seeds"]) == ("small.toml", 7, 3)
    assert meta["run_digest"] == products.spec.digest() == sk.load(tmp_path / "whole.toml").digest()
