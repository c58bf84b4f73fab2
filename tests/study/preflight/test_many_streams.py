"""`check` of many streams: one line for each, and a stream that fails hides no other one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import tomlkit
from commands import call
from runfiles import several

import streamkit as sk
from streamkit.study.preflight import describe_preflight, describe_spec, preflight_record, run_preflight

NAMES = tuple("abcdefgh")


def many(names: tuple[str, ...] = NAMES) -> dict[str, Any]:
    """Streams of one kind, with an emulator; that of ``b`` is too young to have debris."""
    run = several(*names)
    run["sampler"] = {"kind": "emulator"}
    run["stream"]["b"]["progenitor"]["lookback"] = 1e-3
    return run


def lines(text: str, beginning: str) -> list[list[str]]:
    return [line.split() for line in text.splitlines() if line.startswith(beginning)]


def test_each_of_many_streams_has_one_line() -> None:
    spec = sk.load(many())
    result = run_preflight(spec, draws=9)
    text = describe_preflight(spec, result)
    orbit = result.streams["a"].orbit
    (row,) = lines(text, "  a ")
    assert row[:2] == ["a", "1"]  # v_los
    assert [float(each) for each in row[2:4]] == pytest.approx([orbit.pericentres[0], orbit.apocentres[0]], rel=0.01)
    assert row[5] == "4"
    assert row[-3:] == ["9", "of", "9"]
    (young,) = lines(text, "  b ")
    assert young[5:] == ["4", "none", "none", "0", "of", "9"]
    assert preflight_record(spec, result)["prior_draws"]["measured"] == dict.fromkeys(NAMES, 9) | {"b": 0}
    head = describe_spec(spec)
    assert ["stream.*.observable", "track", "streamkit"] in [line[:3] for line in lines(head, "  stream.*")]
    assert "stream.a.progenitor.v_los" not in head
    assert "8 more belong to one stream each" in head


def test_few_streams_are_shown_in_full() -> None:
    spec = sk.load(many(("a", "b")))
    text = describe_preflight(spec, run_preflight(spec, draws=0))
    assert "stream a, at the prior's centre" in text
    assert "stream.a.progenitor.v_los" in describe_spec(spec)


def test_warnings_name_the_streams_that_have_them() -> None:
    run = many()
    table = run["stream"]["c"]["observable"]["radial_velocity"]
    table["radial_velocity"] = [-value for value in table["radial_velocity"]]
    warnings = run_preflight(sk.load(run), draws=10).warnings
    short = [text for text in warnings if "is shorter than the radial period" in text]
    assert [text.partition(":")[0] for text in short] == ["a, c, d, e, f, g, h", "b"]
    (rare,) = [text for text in warnings if "hard to start" in text]
    assert rare.startswith("b: Only 0 of 10 points drawn from the prior have a stream that can be measured")
    assert [text for text in warnings if text.startswith("b: There is no prediction at the prior's centre: too few")]
    (wrong,) = [text for text in warnings if "stream.c.observable.radial_velocity" in text and "none of" in text]
    assert "the opposite sign of radial_velocity" in wrong


def test_one_of_many_streams_is_checked_alone(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text(tomlkit.dumps(many()))
    result = call("check", path, "--stream", "c", "--draws", "0")
    assert result.exit_code == 0, result.output
    assert "stream.c.progenitor.v_los" in result.stdout
    assert "stream.a" not in result.stdout
    wrong = call("check", path, "--stream", "k")
    assert wrong.exit_code == 2
    assert "no stream is called 'k'" in wrong.stderr
