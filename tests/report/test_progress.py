"""Progress where nobody watches: lines of log, and the end that they foretell."""

from __future__ import annotations

import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from streamkit.report import Progress, progress


@pytest.fixture
def clock(monkeypatch):
    """A time that passes only when told."""
    now = SimpleNamespace(value=100.0)
    monkeypatch.setattr(progress.time, "monotonic", lambda: now.value)
    return now


def test_a_long_work_says_a_line_every_minute_and_its_end(clock, capsys):
    with Progress("sampling", 7200, "step", done=100) as bar:
        for _ in range(300):
            clock.value += 1
            bar.update()
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 5
    assert re.fullmatch(
        r"\d\d:\d\d:\d\d streamkit: sampling: 160 of 7200 steps \(2 %\) after 60 s, about 117 min left", lines[0]
    )


def test_a_short_work_says_a_line_for_each_tenth_and_a_shorter_one_nothing(clock, capsys):
    for seconds, most in ((100, 10), (4, 0)):
        with Progress("out", 100, "stream") as bar:
            for _ in range(100):
                clock.value += seconds / 100
                bar.update()
        assert len(capsys.readouterr().err.splitlines()) == most


def test_a_work_with_a_time_limit_ends_there(clock, capsys):
    with Progress("sampling", 10000, "step", deadline=clock.value + 140) as bar:
        for _ in range(70):
            clock.value += 1
            bar.update(2)
    assert bar.total == 280
    assert "of about 280 steps (50 %) after 70 s, about 70 s left" in capsys.readouterr().err


def test_an_estimate_may_change_and_quiet_is_quiet(clock, capsys):
    with Progress("search", 10) as bar:
        clock.value += 61
        bar.expect(200)
        bar.note("3 draws")
        bar.update(50)
    assert capsys.readouterr().err.endswith("search: 25 % after 61 s, about 3.05 min left; 3 draws\n")
    with Progress("search", 10, shown=False) as bar:
        clock.value += 100
        bar.update(5)
    assert capsys.readouterr() == ("", "")


def test_a_work_of_which_nobody_knows_the_end_says_how_much_is_done(clock, capsys):
    with Progress("sampling", np.inf, "call") as bar:
        clock.value += 61
        bar.note("3 draws")
        bar.update(500)
        bar.note("")
        bar.expect(2000)
        clock.value += 61
        bar.update(500)
    first, second = capsys.readouterr().err.splitlines()
    assert first.endswith("sampling: 500 calls after 61 s; 3 draws")
    assert second.endswith("sampling: 1000 of 2000 calls (50 %) after 2.03 min, about 2.03 min left")


def test_on_a_terminal_there_is_a_bar(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with Progress("sampling", 4, "step", keep=True) as bar:
        for _ in range(4):
            bar.update()
    assert "sampling: 100%" in capsys.readouterr().err


@pytest.mark.parametrize("error", [BrokenPipeError(32, "Broken pipe"), OSError(5, "Input/output error"), ValueError])
@pytest.mark.parametrize("terminal", [True, False])
def test_a_terminal_that_goes_away_does_not_end_the_work(clock, monkeypatch, error, terminal):
    """A closed pipe, a terminal that was closed, a descriptor that a plugin closed."""

    class Gone:
        encoding = "utf-8"
        written = 0

        def isatty(self):
            return terminal

        def write(self, _):
            Gone.written += 1
            if Gone.written > 3 or not terminal:
                raise error

        def flush(self):
            pass

    monkeypatch.setattr(sys, "stderr", Gone())
    with Progress("sampling", 100, "step") as bar:
        for _ in range(100):
            clock.value += 61
            bar.update()
    assert bar.done == 100
    assert Gone.written
