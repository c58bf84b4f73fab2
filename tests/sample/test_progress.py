"""The progress of a sampling: calls with few particles are no part of the calls that are expected."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from streamkit.report import progress as lines
from streamkit.sample import SamplingProgress, Storage, progress


@pytest.fixture(name="now")
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Let the time be ``value``, in seconds."""
    now = SimpleNamespace(value=100.0)
    for module, name in ((lines.time, "monotonic"), (progress, "monotonic")):
        monkeypatch.setattr(module, name, lambda: now.value)
    return now


def test_calls_with_few_particles_are_counted_apart(now: SimpleNamespace, capsys: pytest.CaptureFixture[str]) -> None:
    """One call a second: 100 of a start, then 200 of at most 8000, and between them 50 of another start."""
    display, storage, full = SamplingProgress(shown=True), Storage(), 0
    display.expect(8000)
    for count, small, remark in ((100, True, "644 draws"), (100, False, "round 1"), (50, True, ""), (100, False, "")):
        for _ in range(count):
            now.value += 1
            full += not small
            display.remark(remark)
            display.update(1, full, storage, small)
    start, *sampling = (line.partition("streamkit: ")[2] for line in capsys.readouterr().err.splitlines())
    assert start == "start with few particles: 61 calls after 60 s; 644 draws"
    assert sampling[0] == "sampling: 61 of 8000 calls (1 %) after 60 s, about 2.17 h left; 1.0 calls/s, round 1"
    assert [line.partition(" calls")[0] for line in sampling] == [
        f"sampling: {n} of 8000" for n in (61, 100, 131, 191)
    ]


def test_a_sampler_that_makes_no_call_is_seen_to_work(now: SimpleNamespace, capsys: pytest.CaptureFixture[str]) -> None:
    """After one call it is at work for two minutes and a half: a line for each whole minute."""
    display, storage = SamplingProgress(shown=True), Storage()
    display.update(1, 1, storage)
    display.remark("two populations")
    for _ in range(300):
        now.value += 0.5
        if display.waits:
            display.update(0, 1, storage, display.starts)
    found = [line.partition("streamkit: ")[2] for line in capsys.readouterr().err.splitlines()]
    assert found == [f"sampling: 1 calls after {spent}; 0.0 calls/s, two populations" for spent in ("60 s", "2 min")]
