"""Mutated run files and settings: each is valid, or refused in a sentence, and soon."""

import re
import tempfile
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from runfiles import EXAMPLES

import streamkit as sk
from streamkit.cli.options import read_settings

TEXTS = [path.read_text() for path in EXAMPLES]
LINES = sorted({line for text in TEXTS for line in text.splitlines() if line and not line.startswith("#")})
VALUES = [
    "nan", "inf", "-1", "0", "1e400", "9" * 400, "9" * 5000, "true", "[]", "{}", '""', '"1 furlong"', '"nan kpc"',
    '"8 kpc kpc"', "1979-05-27", "2024-02-30", "[" * 60 + "]" * 60, "[" * 3000, "{ uniform = [1, 0] }", '"/dev/zero"',
    "{ log_uniform = [0, 1] }", "{ log_uniform = [1e-320, 1e308] }", '"8 1e308kpc"', "1e308",
    "{ normal = [1e308, 1e308] }", "{ truncated_normal = [0, 1, 5, 6e300] }", "[1, 2]",
    '["/dev/zero"]', '["/"]', '["\\u0000"]', "{ file = 3 }", '{ file = "/dev/zero", column = "x" }', '"\\u0000"', "x",
]  # fmt: skip
NAMES = ("plugins", "seed", "version", "preset", "kind", "mass")
MORE = ["[body.x]", "[potential]", "[stream.a.progenitor]", "[[potential]]", "a.b.c = 1", "x." * 40 + "y = 1"]
EXTRA = [f"{name} = {value}" for name in NAMES for value in VALUES] + MORE


@st.composite
def run_files(draw):
    """Text of an example with a few lines changed, moved, lost, doubled, or cut within."""
    lines = draw(st.sampled_from(TEXTS)).splitlines()
    for _ in range(draw(st.integers(1, 4))):
        place, how = (
            draw(st.integers(0, len(lines) - 1)),
            draw(st.sampled_from(["value", "lose", "add", "move", "cut"])),
        )
        if how == "value" and "=" in lines[place]:
            lines[place] = f"{lines[place].partition('=')[0]}= {draw(st.sampled_from(VALUES))}"
        elif how == "lose":
            del lines[place]
        elif how == "add":
            lines.insert(place, draw(st.sampled_from(LINES + EXTRA)))
        elif how == "move":
            lines.insert(draw(st.integers(0, len(lines) - 1)), lines.pop(place))
        else:
            lines[place] = lines[place][: draw(st.integers(0, len(lines[place])))]
    return "\n".join(lines)


def refused_or_valid(act):
    begin, result = time.process_time(), "valid run file"
    try:
        act()
    except sk.StreamkitError as error:
        result = str(error)
    assert re.search(r"\w+ \w+", result)
    assert len(result) < 20_000
    assert time.process_time() - begin < 2.0


@pytest.fixture(scope="module", autouse=True)
def warm():
    """The first run file of a process imports what reads it."""
    sk.load(EXAMPLES[0]).bind()


def repeated(count, *strategies):
    """Return a decorator: the function is called with so many examples, the same ones each time."""
    often = settings(
        max_examples=count, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck)
    )
    return lambda test: often(given(*strategies)(test))


@pytest.mark.parametrize("count", [12, pytest.param(150, marks=pytest.mark.slow)])
def test_mutated_run_files(count):
    @repeated(count, run_files())
    def read(text):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "run.toml")
            path.write_text(text)
            refused_or_valid(lambda: sk.load(path).bind())

    read()


PATHS = st.sampled_from(["potential.v0", "potential.kind", "progenitor.mass", "seed", "stripping", "observable.leading",
                         "sun.r0", "plugins", "x", "potential.v0.uniform", "", ".", "potential..v0"])  # fmt: skip


@pytest.mark.parametrize("count", [12, pytest.param(100, marks=pytest.mark.slow)])
def test_settings_of_the_command_line(count):
    spec = sk.load(EXAMPLES[-1])

    @repeated(count, PATHS, st.one_of(st.sampled_from(VALUES), st.text(max_size=30)))
    def replace(path, value):
        def act():
            try:
                spec.with_values(read_settings([f"{path}={value}"])).bind()
            except Exception as error:
                if type(error).__name__ != "UsageError":  # which click turns into a sentence
                    raise

        refused_or_valid(act)

    replace()
