"""The reference of the run file: every field of every section, with unit, default, bounds and description."""

import subprocess
import sys

import pytest
from commands import call

from streamkit.components import load_registry
from streamkit.report import columns
from streamkit.runfile import BODY_WAYS, WAYS, Engine, Likelihood, RunFile, Sun

COMPONENTS = [
    pytest.param(role, kind, marks=pytest.mark.slow if i else ())  # one of each role always
    for role, kinds in load_registry().entries.items()
    for i, kind in enumerate(kinds)
]


def text_of(*args: str) -> str:
    result = call("reference", *args)
    assert result.exit_code == 0, result.stderr
    assert max(map(len, result.stdout.splitlines())) <= 100
    return result.stdout


def rows(*args: str) -> list[list[str]]:
    return [line.split() for line in text_of(*args).splitlines()]


def test_without_a_section_it_names_the_keys_and_every_section() -> None:
    text = text_of()
    first = [line.split()[0] for line in text.splitlines() if line.split()]
    assert {f"[{name}]" if f"[{name}]" in first else name for name in RunFile.model_fields} <= set(first)
    assert first.count("[sampler]") == 1
    assert "seed - 0 >= 0 Seed of every random draw." in " ".join(text.split())
    assert "{ log_uniform = [low, high] }" in " ".join(text.split())


@pytest.mark.parametrize(("section", "cls"), [("sun", Sun), ("likelihood", Likelihood), ("engine", Engine)])
def test_a_section_without_a_kind(section: str, cls: type) -> None:
    assert set(cls.model_fields) <= {row[0] for row in rows(section) if row}


def test_unit_default_bounds_and_description() -> None:
    assert "r0 kpc 8 > 0 Distance from the Galactic centre." in " ".join(call("reference", "sun").stdout.split())
    assert ["noise", "-", '"ignore"', '"add"', "or", '"ignore"'] in [row[:6] for row in rows("likelihood")]
    assert ["leading", "kpc", "none", "[value,", "error]"] in [row[:5] for row in rows("observable", "apocentres")]


@pytest.mark.parametrize(("role", "kind"), COMPONENTS)
def test_a_component_as_the_list_of_plugins_has_it(role: str, kind: str) -> None:
    assert call("plugins", role, kind).stdout in text_of(role, kind)


def test_the_progenitor_has_its_potential_three_ways_and_the_lookback() -> None:
    result = [row[0] for row in rows("progenitor", "plummer") if row]
    for name in ("mass", "radius", "lookback", *(name for way in WAYS for name in way.coordinates())):
        assert name in result
    assert "plummer" in call("reference", "progenitor").stdout
    assert " tf" not in call("reference", "progenitor").stdout
    assert "Galactic sky" not in call("reference", "progenitor", "isochrone").stdout  # its b is not the latitude


def test_a_body_has_its_potential_three_ways_friction_and_reflex() -> None:
    result = [row[0] for row in rows("body", "hernquist") if row]
    for name in ("mass", "a", "friction", "reflex", *(name for way in BODY_WAYS for name in way.coordinates())):
        assert name in result
    assert "lookback" not in result
    assert "its force must give a total mass" in call("reference", "body", "tf").stdout


def test_tables_wrap_the_last_column_and_take_brackets_as_they_are() -> None:
    text = columns([("name", "[red]1[/red]", "word " * 40), ("b", "c", "d")]).splitlines()
    assert all(len(line) <= 100 for line in text)
    assert text[0].startswith("  name  [red]1[/red]  word word")
    assert text[1].startswith(" " * 22 + "word")
    assert text[-1] == f"  b     c{' ' * 13}d"
    assert columns([]) == ""


@pytest.mark.parametrize("code", ["import streamkit", "from streamkit.cli.main import main; main(['-h'], 'streamkit')"])
def test_tables_cost_nothing_to_those_who_print_none(code: str) -> None:
    code = f"import atexit, sys\natexit.register(lambda: print('RICH', 'rich' in sys.modules))\n{code}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "RICH False" in done.stdout


@pytest.mark.parametrize("section", ["stream", "stream_defaults"])
def test_sections_of_streams_say_what_they_hold(section: str) -> None:
    result = call("reference", section)
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith(f"[{section}]")
    assert "progenitor, stripping and observable" in result.stdout
